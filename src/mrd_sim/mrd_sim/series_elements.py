"""A damper in series with something that gives way: a compliance, a play.

The damper's motion is what is left of the rod's after the elongation of what is in series with it. At each vertex the force
F is the root of damper(x - elongation(F)) = F, whose left side never rises with F: unique, and bracketed by any F and the
damper's answer to it. Implicit in F, so stable for any stiffness; of first order in the step.
"""

import warnings
from typing import Any

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from mrd_sim.dual import STEP, clip
from mrd_sim.root import settled

Array = NDArray[np.float64]

# Functions as arguments let one compiled driver, kept in the cache, serve every model; numba says so of them each time.
warnings.filterwarnings("ignore", "First-class function type feature is experimental")

MOST = 4
"""Things in series."""

_ACCURACY = 1e-6  # N, of Newton's last step, whose own error is of the order of its square
_INSTANT = 1e-9  # s; in less nothing gives way, and speeds of elongation would be rounding


def _signatures(number: Any) -> list[Any]:
    """Of the functions below, for every number of things in series."""
    reals, row, rows = types.float64[::1], number[::1], number[:, ::1]
    dual, duals = types.complex128[::1], types.complex128[:, ::1]
    kernel = types.FunctionType(types.none(duals, dual, reals, dual, dual, dual, dual))
    stretch = types.FunctionType(types.complex128(dual, types.complex128, types.float64, types.complex128, types.complex128))
    arguments = duals, row, rows, row, reals, row, row, row, row, types.float64[:, ::1]
    return [types.none(kernel, types.UniTuple(stretch, n), *arguments) for n in range(1, MOST + 1)]


@intrinsic
def _address(context: Any, array: Any) -> Any:
    """Where the elements of an array are."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), code


@njit(inline="always")
def _lent(array: Any) -> Any:
    """View that does not count as a reference to the memory: counting takes longer than a kernel.

    Whoever uses it has to keep ``array``, or use it later on.
    """
    return carray(_address(array), array.shape)


@njit(inline="always")
def _elongation(stretches: Any, p: Any, before: Any, step: float, force: Any, x: Any, after: Any) -> Any:
    """Sum of the elongations after a step to ``x`` under a force; each in ``after``."""
    total = 0.0j
    for i, stretch in enumerate(stretches):
        after[i] = stretch(p[i], before[i], step, force, x)
        total += after[i]
    return total


@njit(_signatures(types.float64), cache=True, nogil=True)
def in_series(
    kernel: Any,
    stretches: Any,
    p: Array,
    stretched: Array,
    q: Array,
    state: Array,
    dt: Array,
    x: Array,
    v: Array,
    a: Array,
    force: Array,
    solved: Array,
) -> None:
    """Force of a damper with things in series.

    By Newton's method: with the derivative over F on the motion, one call gives the damper's answer and its slope.

    Parameters
    ----------
    kernel : compiled function
        Of the damper model.
    stretches : tuple of compiled functions
        See `mrd_sim.effects.effect.Effect`.
    p : ndarray (stretches, parameters) of complex
    stretched : ndarray (stretches + 1,)
        Elongations and the force so far; carried on.
    q : ndarray (quantities, m)
    state, dt, x, v, a, force
        As of the kernel.
    solved : ndarray (m, 2 + states)
        Filled with the F of the last call, next to the root, and derivatives over F there: of the damper's answer and of its
        state.
    """
    count, states, quantities = len(stretches), len(state), len(q)
    row, moved, step = np.zeros((1, quantities), np.complex128), np.zeros(states, np.complex128), np.zeros(1)
    at, speed, acceleration, answer = np.zeros((4, 1), np.complex128)
    before, after = np.zeros(count, np.complex128), np.zeros(count, np.complex128)
    before[:] = stretched[:count]
    lent = _lent(p), _lent(before), _lent(after)
    arguments = _lent(row), _lent(moved), _lent(step), _lent(at), _lent(speed), _lent(acceleration), _lent(answer)
    elongation: Any = np.sum(before)
    found, rate = stretched[count], 0.0
    for k in range(len(x)):
        place, step[0] = complex(x[k], 0.0), dt[k]
        acceleration[0] = a[k]
        for i in range(quantities):
            row[0, i] = q[i, k]
        if 0.0 < dt[k] < _INSTANT:
            force[k] = found
            continue
        sum_before = elongation.real
        guess = found + rate * dt[k]
        low, high, last = 0.0, 0.0, 0.0
        newton, slope = 0.0, 0.0
        for attempt in range(100):
            if dt[k] > 0.0:
                elongation = _elongation(stretches, lent[0], lent[1], dt[k], complex(guess, STEP), place, lent[2])
                speed[0] = complex(v[k] - (elongation.real - sum_before) / dt[k], -elongation.imag / dt[k])
            else:
                elongation = complex(sum_before, 0.0)
                speed[0] = v[k]
            at[0] = complex(x[k] - elongation.real, -elongation.imag)
            for i in range(states):
                moved[i] = state[i]
            kernel(*arguments)
            value = answer[0].real
            slope = min(answer[0].imag / STEP, 0.0)
            newton = (value - guess) / (1.0 - slope)
            if dt[k] == 0.0 or not abs(newton) > _ACCURACY:  # or not a number
                break
            if attempt == 0:
                low, high = min(guess, value), max(guess, value)
                last = 4.0 * (high - low)
            elif value > guess:
                low = guess
            else:
                high = guess
            if high - low <= _ACCURACY:
                newton = clip(newton, low - guess, high - guess)
                break
            if elongation.imag == 0.0:
                at_value = _elongation(stretches, lent[0], lent[1], dt[k], complex(value, 0.0), place, lent[2])
                if at_value.real == elongation.real:  # nothing gives way between the two: the damper's answer is the root
                    break
            guess, last = settled(guess, newton, low, high, last)
            newton = 0.0
        if dt[k] > 0.0:
            rate = (guess + newton - found) / dt[k]
            for i in range(count):
                before[i] = after[i].real + after[i].imag / STEP * newton
            elongation = complex(elongation.real + elongation.imag / STEP * newton, 0.0)
        found = guess + newton
        force[k] = found
        solved[k, 0], solved[k, 1] = guess, slope
        for i in range(states):
            solved[k, 2 + i] = moved[i].imag / STEP
            state[i] = moved[i].real + solved[k, 2 + i] * newton
    stretched[:count] = before.real
    stretched[count] = found


@njit(_signatures(types.complex128), cache=True, nogil=True)
def derivatives_in_series(
    kernel: Any,
    stretches: Any,
    p: Array,
    stretched: Array,
    q: Array,
    state: Array,
    dt: Array,
    x: Array,
    v: Array,
    a: Array,
    force: Array,
    solved: Array,
) -> None:
    """Derivative of that force to whatever the arguments carry one of, by the implicit function theorem.

    Arguments as of `in_series`, which has found ``force`` and ``solved``.
    """
    count, states, quantities = len(stretches), len(state), len(q)
    row, moved, step = np.zeros((1, quantities), np.complex128), np.zeros(states, np.complex128), np.zeros(1)
    at, speed, acceleration, answer = np.zeros((4, 1), np.complex128)
    before, after = stretched[:count].copy(), np.zeros(count, np.complex128)
    lent = _lent(p), _lent(before), _lent(after)
    arguments = _lent(row), _lent(moved), _lent(step), _lent(at), _lent(speed), _lent(acceleration), _lent(answer)
    elongation: Any = np.sum(before)
    found = stretched[count]
    for k in range(len(x)):
        if 0.0 < dt[k] < _INSTANT:
            force[k] = found
            continue
        step[0] = dt[k]
        acceleration[0] = a[k]
        for i in range(quantities):
            row[0, i] = q[i, k]
        for i in range(states):
            moved[i] = state[i]
        speed[0] = v[k]
        sum_before = elongation
        if dt[k] > 0.0:
            elongation = _elongation(stretches, lent[0], lent[1], dt[k], complex(solved[k, 0], 0.0), x[k], lent[2])
            speed[0] -= (elongation - sum_before) * (1.0 / dt[k])
        at[0] = x[k] - elongation
        kernel(*arguments)
        found = complex(force[k].real, answer[0].imag / (1.0 - solved[k, 1]))
        force[k] = found
        change = found - solved[k, 0]
        for i in range(states):
            state[i] = moved[i] + solved[k, 2 + i] * change
        if dt[k] > 0.0:
            elongation = _elongation(stretches, lent[0], lent[1], dt[k], found, x[k], lent[2])
            for i in range(count):
                before[i] = after[i]
    stretched[:count] = before
    stretched[count] = found
