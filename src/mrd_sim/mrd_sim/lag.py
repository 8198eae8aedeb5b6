"""A first-order lag, y' = (u - y) / lag, stepped exactly for u linear over the step."""

from typing import Any

from numba import njit

from mrd_sim.dual import absolute, exp


@njit(cache=True, nogil=True)
def decay(step: float, lag: Any) -> Any:
    """What is left of a deviation after a step in s; nothing for so short a lag that it only delays a ramp."""
    return exp(-step / lag) if lag.real >= 1e-9 else 0.0 * lag


@njit(cache=True, nogil=True)
def follow(lagged: Any, before: Any, now: Any, steps: Any, left: Any) -> Any:
    """y after a step over which u went from ``before`` to ``now``, from y = ``lagged``.

    ``steps`` is the lag in steps, ``left`` their `decay`.
    """
    # Over a step that is short against the lag, 1 - left has lost its digits.
    share = steps * (1.0 - left) if steps.real < 1e4 else 1.0 - 0.5 / steps
    return now - (now - before) * share + (lagged - before) * left


@njit(cache=True, nogil=True)
def turned(state: Any, step: float, here: Any, over: Any, level: Any = 1.0) -> Any:
    """A direction of motion (-1 to 1) that lags in travel, not in time, after a step in s to ``here``; its lag is ``over``.

    ``state`` holds this direction and the place that was come from, and is brought up to date. With a ``level`` other than 1
    it tends to that in the direction of motion, at the same initial slope: dw / d|x| = (sgn x' - w / level) / over.
    """
    travel = here - state[1]
    if step > 0.0 and travel.real != 0.0:
        end = level if travel.real > 0.0 else -level
        state[0] = end + (state[0] - end) * exp(-absolute(travel) / (over * level))
    state[1] = here
    return state[0]
