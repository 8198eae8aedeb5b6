"""A damper in series with something that gives way: a compliance, a play."""

import warnings
from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from mrd_sim.root import settled

Array = NDArray[np.float64]

# Functions as arguments let one compiled driver, kept in the cache, serve every model; numba says so of them each time.
warnings.filterwarnings("ignore", "First-class function type feature is experimental")

MOST = 3
"""Things in series."""

_ACCURACY = 1e-7  # N
_NUDGE = 1e-4  # N, for the slope of the damper's force over the elongation


def _signatures(number: Any) -> list[Any]:
    step, row, rows = types.Array(types.float64, 1, "C"), types.Array(number, 1, "C"), types.Array(number, 2, "C")
    kernel = types.FunctionType(types.none(rows, row, step, row, row, row, row))
    stretch = types.FunctionType(number(row, number, types.float64, number))
    return [
        types.none(kernel, types.UniTuple(stretch, count), rows, row, rows, row, step, row, row, row, row)
        for count in range(1, MOST + 1)
    ]


@njit([*_signatures(types.float64), *_signatures(types.complex128)], cache=True, nogil=True)
def in_series(
    kernel: Any, stretches: Any, p: Array, stretched: Array, q: Array, state: Array, dt: Array, x: Array, v: Array, a: Array,
    force: Array,
) -> None:
    """Force of a damper whose motion is what is left of the rod's after the elongation of things in series with it.

    At each vertex the force F is the root of damper(x - elongation(F)) = F, whose left side never rises with F: unique, and
    bracketed by any F and the damper's answer to it. Implicit in F, so stable for any stiffness; of first order in the step.

    Parameters
    ----------
    kernel : compiled function
        Of the damper model.
    stretches : tuple of compiled functions
        See `mrd_sim.effects.effect.Effect`.
    p : ndarray (stretches, parameters)
    stretched : ndarray (stretches + 1,)
        Elongations and the force so far; carried on.
    q, state, dt, x, v, a, force
        As of the kernel.
    """
    count = len(stretches)
    trial = np.empty_like(state)
    at, speed, answer = np.empty_like(x[:1]), np.empty_like(x[:1]), np.empty_like(x[:1])
    before = 0.0 * stretched[0]
    for i in range(count):
        before += stretched[i]
    for k in range(len(x)):
        step = dt[k]
        guess = stretched[count]
        low, high, last = 0.0, 0.0, 0.0
        for attempt in range(100):
            elongation = 0.0 * before
            for i, stretch in enumerate(stretches):
                elongation += stretch(p[i], stretched[i], step, guess)
            trial[:] = state
            at[0] = x[k] - elongation
            speed[0] = v[k] - ((elongation - before) / step if step > 0.0 else 0.0 * before)
            kernel(q[k : k + 1], trial, dt[k : k + 1], at, speed, a[k : k + 1], answer)
            excess = answer[0] - guess
            if step == 0.0:
                break
            # The slope of the damper's force over F, by what a nudge of F changes.
            nudged = 0.0 * before
            for i, stretch in enumerate(stretches):
                nudged += stretch(p[i], stretched[i], step, guess + _NUDGE)
            slope = 0.0
            if nudged.real != elongation.real:
                trial[:] = state
                at[0] = x[k] - nudged
                speed[0] = v[k] - (nudged - before) / step
                moved = answer[0]
                kernel(q[k : k + 1], trial, dt[k : k + 1], at, speed, a[k : k + 1], answer)
                slope = min((answer[0] - moved).real / _NUDGE, 0.0)
                answer[0] = moved
            else:
                again = 0.0 * before
                for i, stretch in enumerate(stretches):
                    again += stretch(p[i], stretched[i], step, answer[0])
                if again.real == elongation.real:
                    # Nothing gives way between the two: the damper's answer is the root.
                    guess = answer[0]
                    break
            if attempt == 0:
                low, high = min(guess.real, answer[0].real), max(guess.real, answer[0].real)
                last = 4.0 * (high - low)
            elif excess.real > 0.0:
                low = guess.real
            else:
                high = guess.real
            newton = excess / (1.0 - slope)
            if abs(newton.real) <= _ACCURACY or high - low <= _ACCURACY:
                guess = guess + newton
                break
            guess, last = settled(guess, newton, low, high, last)
        if step > 0.0:
            elongation = 0.0 * before
            for i, stretch in enumerate(stretches):
                stretched[i] = stretch(p[i], stretched[i], step, guess)
                elongation += stretched[i]
            at[0] = x[k] - elongation
            speed[0] = v[k] - (elongation - before) / step
            before = elongation
        else:
            at[0], speed[0] = x[k] - before, v[k]
        kernel(q[k : k + 1], state, dt[k : k + 1], at, speed, a[k : k + 1], answer)
        force[k] = answer[0]
        stretched[count] = answer[0]
