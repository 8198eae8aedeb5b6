"""A damper in series with elements that give way: a compliance, a play.

The damper's motion is what is left of the rod's motion after the elongation of the elements in series with it. At each
vertex the force F is the root of damper(x - elongation(F)) = F. The left side never rises with F, so there is one root, and
any F and the damper's answer to it bracket the root. The scheme is implicit in F, hence stable for any stiffness, and of
first order in the step.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from mrd_sim.dual import STEP, clip
from mrd_sim.root import next_iterate

Array = NDArray[np.float64]

MOST_IN_SERIES = 5
"""Elements in series: as many as the catalogue has."""
MOST_PARAMETERS = 5
"""Parameters of such an element."""
FORCE_TOLERANCE = 1e-6
"""N, of Newton's last step. The error that it leaves is of the order of its square."""
SHORTEST_STEP = 1e-9
"""s. In less nothing gives way, and speeds of elongation would be rounding."""


_VECTOR, _REALS = types.complex128[::1], types.float64[::1]
_KERNEL = types.none(types.complex128[:, ::1], _VECTOR, _REALS, _VECTOR, _VECTOR, _VECTOR, _VECTOR)
_ELONGATION = types.complex128(_VECTOR, types.complex128, types.float64, types.complex128, types.complex128)


def first_class(kernel: Any, elongations: Sequence[Any]) -> tuple[Any, ...]:
    """Return a kernel and the elongations of the elements as the first arguments of the functions below.

    They take the compiled functions themselves, too; but numba would then look up the address of each at every call, which
    takes longer than a path of a thousand vertices.
    """
    functions = [*elongations] + [elongations[0]] * (MOST_IN_SERIES - len(elongations))
    signatures = [_KERNEL] + [_ELONGATION] * MOST_IN_SERIES
    pairs = zip([kernel, *functions], signatures, strict=True)
    return tuple(types.CompileResultWAP(function.get_compile_result(signature)) for function, signature in pairs)


def _compiled(number: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles a function for ``number``, real or with derivatives.

    The kernel and the elongations come as first-class functions, so that one compiled function serves all models. Numba
    warns where such functions are put into a tuple.
    """
    row, rows = number[::1], number[:, ::1]
    functions = [types.FunctionType(_KERNEL)] + [types.FunctionType(_ELONGATION)] * MOST_IN_SERIES
    arguments = types.complex128[:, ::1], row, rows, row, _REALS, row, row, row, row, types.float64[:, ::1]
    signature = types.none(*functions, *arguments)

    def decorate(function: Any) -> Any:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "First-class function type feature is experimental")
            return njit(signature, cache=True, nogil=True)(function)

    return decorate


@intrinsic
def _address(context: Any, array: Any) -> Any:
    """Address of the elements of an array."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), code


@njit(inline="always")
def _unowned(array: Any) -> Any:
    """Return a view that does not count as a reference to the memory, because counting takes longer than a kernel.

    Its user has to keep ``array``, or to use it later on.
    """
    return carray(_address(array), array.shape)


class _Vertex(NamedTuple):
    """Arrays of one vertex, as a kernel is called with them; `_unowned`."""

    coefficients: Any
    state: Any
    step: Any
    x: Any
    v: Any
    a: Any
    force: Any


@njit(inline="always")
def _vertex(coefficients: Any, state: Any, step: Any, x: Any, v: Any, a: Any, force: Any) -> Any:
    """Return views of the arrays; the caller keeps these."""
    motion = _unowned(x), _unowned(v), _unowned(a)
    return _Vertex(_unowned(coefficients), _unowned(state), _unowned(step), *motion, _unowned(force))


class _Elements(NamedTuple):
    """Parameters of the elements in series, their elongations before the step and after it; `_unowned`."""

    parameters: Any
    before: Any
    after: Any


@njit(inline="always")
def _elongate(functions: Any, elements: Any, step: float, force: Any, x: Any) -> Any:
    """Return the sum of the elongations after a step to ``x`` under a force, and leave each in ``elements.after``."""
    total = 0.0j
    for i in range(len(elements.before)):
        elements.after[i] = functions[i](elements.parameters[i], elements.before[i], step, force, x)
        total += elements.after[i]
    return total


@njit(inline="always")
def _enter_vertex(k: int, q: Any, dt: Any, a: Any, row: Any, step: Any, acceleration: Any) -> None:
    """Write coefficients, step and acceleration of vertex ``k`` to where the kernel reads them.

    It writes to the arrays themselves, which so stay alive as long as the loop over the vertices needs their views.
    """
    step[0] = dt[k]
    acceleration[0] = a[k]
    for i in range(len(q)):
        row[0, i] = q[i, k]


@_compiled(types.float64)
def force_in_series(
    kernel: Any,
    first: Any,
    second: Any,
    third: Any,
    fourth: Any,
    fifth: Any,
    parameters: Array,
    elongations: Array,
    q: Array,
    state: Array,
    dt: Array,
    x: Array,
    v: Array,
    a: Array,
    force: Array,
    solved: Array,
) -> None:
    """Fill in the force of a damper with elements in series.

    By Newton's method: with the derivative over F on the motion, one call gives the damper's answer and its slope.

    Parameters
    ----------
    kernel : compiled function
        That of the damper model.
    first, second, third, fourth, fifth : compiled functions
        Elongation of each element, see `mrd_sim.effects.effect.Effect`. Those beyond the number of elements are not called.
    parameters : ndarray (elements, parameters) of complex
    elongations : ndarray (elements + 1,)
        Elongations, and after them the force; carried on.
    q : ndarray (coefficients, m)
    state, dt, x, v, a, force
        As of the kernel.
    solved : ndarray (m, 2 + states)
        Filled with the F of the last call, next to the root, and with derivatives over F there: that of the damper's answer
        and those of its state.
    """
    functions = first, second, third, fourth, fifth
    count, states = len(elongations) - 1, len(state)
    row, inner, step = np.zeros((1, len(q)), np.complex128), np.zeros(states, np.complex128), np.zeros(1)
    at, speed, acceleration, answer = np.zeros((4, 1), np.complex128)
    before, after = np.zeros(count, np.complex128), np.zeros(count, np.complex128)
    before[:] = elongations[:count]
    elements = _Elements(_unowned(parameters), _unowned(before), _unowned(after))
    vertex = _vertex(row, inner, step, at, speed, acceleration, answer)
    elongation: Any = np.sum(before)
    root, rate = elongations[count], 0.0
    for k in range(len(x)):
        place = complex(x[k], 0.0)
        if 0.0 < dt[k] < SHORTEST_STEP:
            force[k] = root
            continue
        _enter_vertex(k, q, dt, a, row, step, acceleration)
        sum_before = elongation.real
        guess = root + rate * dt[k]
        low, high, last = 0.0, 0.0, 0.0
        newton, slope = 0.0, 0.0
        for attempt in range(100):
            if dt[k] > 0.0:
                elongation = _elongate(functions, elements, dt[k], complex(guess, STEP), place)
                speed[0] = complex(v[k] - (elongation.real - sum_before) / dt[k], -elongation.imag / dt[k])
            else:
                elongation = complex(sum_before, 0.0)
                speed[0] = v[k]
            at[0] = complex(x[k] - elongation.real, -elongation.imag)
            for i in range(states):
                inner[i] = state[i]
            kernel(*vertex)
            value = answer[0].real
            slope = min(answer[0].imag / STEP, 0.0)
            newton = (value - guess) / (1.0 - slope)
            if dt[k] == 0.0 or not abs(newton) > FORCE_TOLERANCE:  # "not" also ends the search where newton is no number
                break
            if attempt == 0:
                low, high = min(guess, value), max(guess, value)
                last = 4.0 * (high - low)
            elif value > guess:
                low = guess
            else:
                high = guess
            if high - low <= FORCE_TOLERANCE:
                newton = clip(newton, low - guess, high - guess)
                break
            if elongation.imag == 0.0:
                at_value = _elongate(functions, elements, dt[k], complex(value, 0.0), place)
                if at_value.real == elongation.real:  # nothing gives way between the two, so the damper's answer is the root
                    break
            guess, last = next_iterate(guess, newton, low, high, last)
            newton = 0.0
        if dt[k] > 0.0:
            rate = (guess + newton - root) / dt[k]
            for i in range(count):
                before[i] = after[i].real + after[i].imag / STEP * newton
            elongation = complex(elongation.real + elongation.imag / STEP * newton, 0.0)
        root = guess + newton
        force[k] = root
        solved[k, 0], solved[k, 1] = guess, slope
        for i in range(states):
            solved[k, 2 + i] = inner[i].imag / STEP
            state[i] = inner[i].real + solved[k, 2 + i] * newton
    elongations[:count] = before.real
    elongations[count] = root


@_compiled(types.complex128)
def derivatives_in_series(
    kernel: Any,
    first: Any,
    second: Any,
    third: Any,
    fourth: Any,
    fifth: Any,
    parameters: Array,
    elongations: Array,
    q: Array,
    state: Array,
    dt: Array,
    x: Array,
    v: Array,
    a: Array,
    force: Array,
    solved: Array,
) -> None:
    """Add to that force its derivative to whatever the arguments carry one of, by the implicit function theorem.

    The arguments are those of `force_in_series`, which has filled ``force`` and ``solved``.
    """
    functions = first, second, third, fourth, fifth
    count, states = len(elongations) - 1, len(state)
    row, inner, step = np.zeros((1, len(q)), np.complex128), np.zeros(states, np.complex128), np.zeros(1)
    at, speed, acceleration, answer = np.zeros((4, 1), np.complex128)
    before, after = elongations[:count].copy(), np.zeros(count, np.complex128)
    elements = _Elements(_unowned(parameters), _unowned(before), _unowned(after))
    vertex = _vertex(row, inner, step, at, speed, acceleration, answer)
    elongation: Any = np.sum(before)
    root = elongations[count]
    for k in range(len(x)):
        if 0.0 < dt[k] < SHORTEST_STEP:
            force[k] = root
            continue
        _enter_vertex(k, q, dt, a, row, step, acceleration)
        for i in range(states):
            inner[i] = state[i]
        speed[0] = v[k]
        sum_before = elongation
        if dt[k] > 0.0:
            elongation = _elongate(functions, elements, dt[k], complex(solved[k, 0], 0.0), x[k])
            speed[0] -= (elongation - sum_before) * (1.0 / dt[k])
        at[0] = x[k] - elongation
        kernel(*vertex)
        root = complex(force[k].real, answer[0].imag / (1.0 - solved[k, 1]))
        force[k] = root
        change = root - solved[k, 0]
        for i in range(states):
            state[i] = inner[i] + solved[k, 2 + i] * change
        if dt[k] > 0.0:
            elongation = _elongate(functions, elements, dt[k], root, x[k])
            for i in range(count):
                before[i] = after[i]
    elongations[:count] = before
    elongations[count] = root
