"""A first-order lag, y' = (u - y) / lag, stepped exactly for u linear over the step; and a lag over travel."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_sim.dual import absolute, exp

Array = NDArray[np.float64]

SHORTEST_LAG = 1e-9
"""s. A shorter lag only delays a ramp; its exponential would divide by almost nothing."""
LONG_LAG = 1e4
"""Steps. Of a longer lag, 1 - exp(-1/lag) has lost its digits and gives way to its series."""


@njit(cache=True, nogil=True)
def decay(step: float, lag: Any) -> Any:
    """Return what is left of a deviation after a step in s."""
    return exp(-step / lag) if lag.real >= SHORTEST_LAG else 0.0 * lag


@njit(cache=True, nogil=True)
def ramp_share(steps: Any, left: Any) -> Any:
    """Return by what share of the change of u over a step y stays behind, for a lag in steps and its `decay`."""
    return steps * (1.0 - left) if steps.real < LONG_LAG else 1.0 - 0.5 / steps


@njit(cache=True, nogil=True)
def follow(lagged: Any, before: Any, now: Any, steps: Any, left: Any) -> Any:
    """Return y after a step over which u went from ``before`` to ``now``, from y = ``lagged``.

    ``steps`` is the lag in steps, ``left`` the `decay` over one step.
    """
    return now - (now - before) * ramp_share(steps, left) + (lagged - before) * left


@njit(cache=True, nogil=True)
def lagged_direction(state: Array, step: float, x: Any, travel_lag: Any, level: Any = 1.0) -> Any:
    """Return a direction of motion (-1 to 1) that lags in travel, not in time, after a step in s to position ``x``.

    ``state`` holds the direction and the position before, and is updated. ``travel_lag`` is in m. With a ``level`` other
    than 1 the direction tends to that value, at the same initial slope: dw / d|x| = (sgn x' - w / level) / travel_lag.
    """
    travel = x - state[1]
    if step > 0.0 and travel.real != 0.0:
        end = level if travel.real > 0.0 else -level
        state[0] = end + (state[0] - end) * exp(-absolute(travel) / (travel_lag * level))
    state[1] = x
    return state[0]
