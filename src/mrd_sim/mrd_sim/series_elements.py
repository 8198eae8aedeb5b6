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

from mrd_sim.dual_type import LANES, DualType, Duals, as_duals, chained, empty_duals, moving, slope_of
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


_REALS, _MATRIX = types.float64[::1], types.float64[:, ::1]


def _vector(number: Any) -> Any:
    """Type of a contiguous array of numbers of a type."""
    return types.Array(number, 1, "C")


def _kernel(number: Any) -> Any:
    """Signature of a kernel for numbers of a type."""
    vector = _vector(number)
    return types.none(types.Array(number, 2, "C"), vector, _REALS, vector, vector, vector, vector)


def _elongation(number: Any) -> Any:
    """Signature of an elongation for numbers of a type."""
    return number(_vector(number), number, types.float64, number, number)


def first_class(kernel: Any, elongations: Sequence[Any], lanes: int) -> tuple[Any, ...]:
    """Return a kernel and the elongations of the elements as the first arguments of the functions below.

    They take the compiled functions themselves, too; but numba would then look up the address of each at every call, which
    takes longer than a path of a thousand vertices. ``lanes`` is that of the function that they are for.
    """
    functions = [*elongations] + [elongations[0]] * (MOST_IN_SERIES - len(elongations))
    number = DualType(lanes)
    signatures = [_kernel(number)] + [_elongation(number)] * MOST_IN_SERIES
    for function, signature in zip([kernel, *functions], signatures, strict=True):
        function.compile(signature)
    pairs = zip([kernel, *functions], signatures, strict=True)
    return tuple(types.CompileResultWAP(function.get_compile_result(signature)) for function, signature in pairs)


def _compiled(lanes: int, *arguments: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles a function of a kernel, five elongations, and ``arguments`` of these types.

    The kernel and the elongations come as first-class functions, so that one compiled function serves all models. Numba
    warns where such functions are put into a tuple.
    """
    number = DualType(lanes)
    functions = [types.FunctionType(_kernel(number))] + [types.FunctionType(_elongation(number))] * MOST_IN_SERIES
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
def _vertex(row: Any, work: Any, states: int, step: Any) -> Any:
    """Return views of a row of coefficients, of the parts of ``work``, (states + 4,), and of a step; the caller keeps these."""
    motion_and_force = (
        _unowned(work[states : states + 1]),
        _unowned(work[states + 1 : states + 2]),
        _unowned(work[states + 2 : states + 3]),
        _unowned(work[states + 3 : states + 4]),
    )
    return _Vertex(_unowned(row), _unowned(work[:states]), _unowned(step), *motion_and_force)


class _Elements(NamedTuple):
    """Parameters of the elements in series, their elongations before the step and after it; `_unowned`."""

    parameters: Any
    before: Any
    after: Any


@njit(inline="always")
def _elongate(functions: Any, elements: Any, step: float, force: Any, x: Any) -> Any:
    """Return the sum of the elongations after a step to ``x`` under a force, and leave each in ``elements.after``."""
    total = 0.0 * force
    for i in range(len(elements.before)):
        elements.after[i] = functions[i](elements.parameters[i], elements.before[i], step, force, x)
        total += elements.after[i]
    return total


def _length_of_work(elements: int, states: int) -> int:
    """Numbers that the functions below work with: states, motion and force of a vertex, and the elements' elongations."""
    return states + 4 + 2 * elements


@_compiled(1, *[types.Array(DualType(1), 2, "C")] * 2, _vector(DualType(1)), _REALS, _MATRIX, *[_REALS] * 6, _MATRIX)
def _force_in_series(
    kernel: Any,
    first: Any,
    second: Any,
    third: Any,
    fourth: Any,
    fifth: Any,
    parameters: Any,
    row: Any,
    work: Any,
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
    functions = first, second, third, fourth, fifth
    count, states = len(elongations) - 1, len(state)
    step = np.zeros(1)
    vertex = _vertex(row, work, states, step)
    before, after = _unowned(work[states + 4 : states + 4 + count]), _unowned(work[states + 4 + count :])
    elements = _Elements(_unowned(parameters), before, after)
    total, root, rate = 0.0, elongations[count], 0.0
    for i in range(count):
        before[i] = elongations[i]
        total += elongations[i]
    for k in range(len(x)):
        if 0.0 < dt[k] < SHORTEST_STEP:
            force[k] = root
            continue
        step[0] = dt[k]
        vertex.a[0] = a[k]
        for i in range(len(q)):
            row[0, i] = q[i, k]
        elongation = moving(total, 0.0)
        guess = root + rate * dt[k]
        low, high, last = 0.0, 0.0, 0.0
        newton, slope = 0.0, 0.0
        for attempt in range(100):
            if dt[k] > 0.0:
                elongation = _elongate(functions, elements, dt[k], moving(guess, 1.0), moving(x[k], 0.0))
            vertex.x[0] = x[k] - elongation
            vertex.v[0] = v[k] - (elongation - total) / dt[k] if dt[k] > 0.0 else moving(v[k], 0.0)
            for i in range(states):
                vertex.state[i] = state[i]
            kernel(*vertex)
            value = vertex.force[0].real
            slope = min(slope_of(vertex.force[0]), 0.0)
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
                newton = min(max(newton, low - guess), high - guess)
                break
            if slope_of(elongation) == 0.0:
                at_value = _elongate(functions, elements, dt[k], moving(value, 0.0), moving(x[k], 0.0))
                if at_value.real == elongation.real:  # nothing gives way between the two, so the damper's answer is the root
                    break
            guess, last = next_iterate(guess, newton, low, high, last)
            newton = 0.0
        if dt[k] > 0.0:
            rate = (guess + newton - root) / dt[k]
            for i in range(count):
                before[i] = after[i].real + slope_of(after[i]) * newton
            total = elongation.real + slope_of(elongation) * newton
        root = guess + newton
        force[k] = root
        solved[k, 0], solved[k, 1] = guess, slope
        for i in range(states):
            solved[k, 2 + i] = slope_of(vertex.state[i])
            state[i] = vertex.state[i].real + solved[k, 2 + i] * newton
    for i in range(count):
        elongations[i] = before[i].real
    elongations[count] = root


def force_in_series(functions: tuple[Any, ...], parameters: Array, elongations: Array, *arguments: Array) -> None:
    """Fill in the force of a damper with elements in series.

    By Newton's method: with the derivative over F on the motion, one call gives the damper's answer and its slope.

    Parameters
    ----------
    functions : tuple
        Kernel of the damper model, and elongation of each element (`mrd_sim.effects.effect.Effect`), as `first_class` gives
        them for one lane.
    parameters : ndarray (elements, parameters)
    elongations : ndarray (elements + 1,)
        Elongations, and after them the force; carried on.
    *arguments : ndarray
        ``q`` (coefficients, m); state, dt, x, v, a, force as of the kernel; and ``solved`` (m, 2 + states). This is filled
        with the F of the last call, next to the root, and with derivatives over F there: that of the damper's answer and
        those of its state.
    """
    row = empty_duals((1, len(arguments[0])), 1)
    work = empty_duals(_length_of_work(len(parameters), len(arguments[1])), 1)
    _force_in_series(*functions, as_duals(parameters, 1), row, work, elongations, *arguments)


_NUMBER = DualType(LANES)
_ROWS = types.Array(_NUMBER, 2, "C")


@_compiled(LANES, _ROWS, _ROWS, *[_vector(_NUMBER)] * 2, _ROWS, _vector(_NUMBER), _REALS, *[_vector(_NUMBER)] * 4, _MATRIX)
def _derivatives_in_series(
    kernel: Any,
    first: Any,
    second: Any,
    third: Any,
    fourth: Any,
    fifth: Any,
    parameters: Any,
    row: Any,
    work: Any,
    elongations: Any,
    q: Any,
    state: Any,
    dt: Array,
    x: Any,
    v: Any,
    a: Any,
    force: Any,
    solved: Array,
) -> None:
    functions = first, second, third, fourth, fifth
    count, states = len(elongations) - 1, len(state)
    step = np.zeros(1)
    vertex = _vertex(row, work, states, step)
    before, after = _unowned(work[states + 4 : states + 4 + count]), _unowned(work[states + 4 + count :])
    elements = _Elements(_unowned(parameters), before, after)
    root = elongations[count]
    elongation = 0.0 * root
    for i in range(count):
        before[i] = elongations[i]
        elongation += elongations[i]
    for k in range(len(x)):
        if 0.0 < dt[k] < SHORTEST_STEP:
            force[k] = root
            continue
        step[0] = dt[k]
        vertex.a[0] = a[k]
        for i in range(q.shape[1]):
            row[0, i] = q[k, i]
        for i in range(states):
            vertex.state[i] = state[i]
        vertex.v[0] = v[k]
        if dt[k] > 0.0:
            sum_before = elongation
            elongation = _elongate(functions, elements, dt[k], solved[k, 0] + 0.0 * root, x[k])
            vertex.v[0] = v[k] - (elongation - sum_before) * (1.0 / dt[k])
        vertex.x[0] = x[k] - elongation
        kernel(*vertex)
        root = chained(force[k].real, 1.0 / (1.0 - solved[k, 1]), vertex.force[0])
        force[k] = root
        change = root - solved[k, 0]
        for i in range(states):
            state[i] = vertex.state[i] + solved[k, 2 + i] * change
        if dt[k] > 0.0:
            elongation = _elongate(functions, elements, dt[k], root, x[k])
            for i in range(count):
                before[i] = after[i]
    for i in range(count):
        elongations[i] = before[i]
    elongations[count] = root


def derivatives_in_series(functions: tuple[Any, ...], parameters: Duals, elongations: Duals, *arguments: Array) -> None:
    """Add to that force its derivatives, by the implicit function theorem.

    The arguments are those of `force_in_series`, which has filled ``force`` and ``solved``; but ``q`` is (m, coefficients).
    """
    row = empty_duals((1, arguments[0].shape[1]))
    work = empty_duals(_length_of_work(len(parameters), len(arguments[1])))
    _derivatives_in_series(*functions, parameters, row, work, elongations, *arguments)
