"""A damper in series with elements that give way: a compliance, a play.

The damper's motion is what is left of the rod's motion after the elongation of the elements in series with it. At each
vertex the force F is the root of damper(x - elongation(F)) = F. The left side never rises with F, so there is one root, and
any F and the damper's answer to it bracket the root. The scheme is implicit in F, hence stable for any stiffness, and of
first order in the step.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import carray, njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from mrd_sim.addresses import address_of, call, call_address
from mrd_sim.dual_type import LANES, DualType, as_duals, chained, empty_duals, moving, slope_of
from mrd_sim.root import next_iterate

Array = NDArray[np.float64]

MOST_IN_SERIES = 5
"""Elements in series: as many as the catalogue has."""
MOST_PARAMETERS = 5
"""Parameters of such an element."""
TOLERANCE = 1e-5
"""Largest last step of Newton's method, as a share of the force. The change of the damper's speed that goes with it has to
be as small a share of that speed. Where the force is smooth, the error that is left is of the order of the step's square."""
LEAST_FORCE, LEAST_SPEED = 1e-6, 1e-9
"""N and m/s, below which a step has converged whatever its share."""
SHORTEST_STEP = 1e-9
"""s. In less nothing gives way, and speeds of elongation would be rounding."""

AGAINST_ROD = 0.1
"""Share of the rod's largest speed by which elements under a known force may move the damper against the rod."""


_REALS, _MATRIX, _ADDRESSES = types.float64[::1], types.float64[:, ::1], types.intp[::1]


def _vector(number: Any) -> Any:
    """Type of a contiguous array of numbers of a type."""
    return types.Array(number, 1, "C")


def _matrix(number: Any) -> Any:
    """Type of a contiguous matrix of numbers of a type."""
    return types.Array(number, 2, "C")


def addresses(kernel: Any, elongations: Sequence[Any], lanes: int) -> NDArray[np.intp]:
    """Return the addresses of a kernel and of the elongations of the elements, compiled for numbers of some lanes.

    The functions below call what is at these addresses, so that one compiled function serves all models; numba would look
    up an address at every call, which takes longer than a path of a thousand vertices.
    """
    number = DualType(lanes)
    vector = _vector(number)
    of_kernel = types.none(_matrix(number), vector, _REALS, vector, vector, vector, vector)
    of_elongation = number(vector, number, types.float64, number, number)
    return np.array([address_of(kernel, of_kernel), *(address_of(e, of_elongation) for e in elongations)], np.intp)


@intrinsic
def _call_elongation(_context: Any, address: Any, parameters: Any, before: Any, step: Any, force: Any, x: Any) -> Any:
    """Elongation by the function at an address."""
    kinds = parameters, before, step, force, x

    def code(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return call_address(context, builder, force, kinds, arguments[0], arguments[1:])

    return force(address, *kinds), code


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
    """Return views of a row of coefficients, of parts of ``work`` and of a step; the caller keeps these."""
    x, v = _unowned(work[states : states + 1]), _unowned(work[states + 1 : states + 2])
    a, force = _unowned(work[states + 2 : states + 3]), _unowned(work[states + 3 : states + 4])
    return _Vertex(_unowned(row), _unowned(work[:states]), _unowned(step), x, v, a, force)


@njit(inline="always")
def _with_row(vertex: Any, q: Any, k: int) -> Any:
    """Return the arrays of a vertex with row ``k`` of a matrix of coefficients."""
    row = _unowned(q[k : k + 1])
    return _Vertex(row, vertex.state, vertex.step, vertex.x, vertex.v, vertex.a, vertex.force)


class _Elements(NamedTuple):
    """Addresses of the elongations, parameters of the elements, elongations before the step and after it; `_unowned`."""

    addresses: Any
    parameters: Any
    before: Any
    after: Any


@njit(inline="always")
def _elements(functions: Any, parameters: Any, work: Any, count: int) -> Any:
    """Return views of the addresses, of the parameters and of the last parts of ``work``; the caller keeps these."""
    end = len(work)
    before, after = _unowned(work[end - 2 * count : end - count]), _unowned(work[end - count :])
    return _Elements(_unowned(functions), _unowned(parameters), before, after)


@njit(inline="always")
def _elongate(elements: Any, step: float, force: Any, x: Any) -> Any:
    """Return the sum of the elongations after a step to ``x`` under a force, and leave each in ``elements.after``."""
    total = 0.0 * force
    for i in range(len(elements.before)):
        address = elements.addresses[1 + i]
        after = _call_elongation(address, elements.parameters[i], elements.before[i], step, force, x)
        elements.after[i] = after
        total += after
    return total


def _length_of_work(elements: int, states: int) -> int:
    """Numbers that the functions below work with: states, motion and force of a vertex, and the elements' elongations."""
    return states + 4 + 2 * elements


def _compiled(*arguments: Any) -> Callable[[Any], Any]:
    """Return a decorator that compiles a function of addresses and of arguments of these types."""
    return njit(types.none(_ADDRESSES, *arguments), cache=True, nogil=True)  # type: ignore[no-any-return]


_ONE = DualType(1)


@_compiled(*[_matrix(_ONE)] * 2, _vector(_ONE), _REALS, _MATRIX, *[_REALS] * 6, _MATRIX)
def _force_in_series(
    functions: NDArray[np.intp],
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
    count, states = len(elongations) - 1, len(state)
    step = np.zeros(1)
    vertex = _vertex(row, work, states, step)
    elements = _elements(functions, parameters, work, count)
    before, after = elements.before, elements.after
    total, root, rate = 0.0, elongations[count], 0.0
    for i in range(count):
        before[i] = elongations[i]
        total += elongations[i]
    for k in range(len(x)):
        if 0.0 < dt[k] < SHORTEST_STEP:
            force[k] = root
            continue
        step[0], added = dt[k], force[k]
        vertex.a[0] = a[k]
        for i in range(len(q)):
            row[0, i] = q[i, k]
        elongation = moving(total, 0.0)
        guess = root + rate * dt[k]
        low, high, last = 0.0, 0.0, 0.0
        newton, slope = 0.0, 0.0
        for attempt in range(100):
            if dt[k] > 0.0:
                elongation = _elongate(elements, dt[k], moving(guess, 1.0), moving(x[k], 0.0))
            vertex.x[0] = x[k] - elongation
            vertex.v[0] = v[k] - (elongation - total) / dt[k] if dt[k] > 0.0 else moving(v[k], 0.0)
            for i in range(states):
                vertex.state[i] = state[i]
            call(functions[0], vertex)
            value = vertex.force[0].real + added
            slope = min(slope_of(vertex.force[0]), 0.0)
            newton = (value - guess) / (1.0 - slope)
            if dt[k] == 0.0:
                break
            enough = TOLERANCE * abs(value) + LEAST_FORCE
            enough_speed = (TOLERANCE * abs(vertex.v[0].real) + LEAST_SPEED) * dt[k]
            # "not" also ends the search where newton is no number
            if not (abs(newton) > enough or abs(newton * slope_of(elongation)) > enough_speed):
                break
            if attempt == 0:
                low, high = min(guess, value), max(guess, value)
                last = 4.0 * (high - low)
            elif value > guess:
                low = guess
            else:
                high = guess
            if high - low <= LEAST_FORCE:
                newton = min(max(newton, low - guess), high - guess)
                break
            if slope_of(elongation) == 0.0:
                at_value = _elongate(elements, dt[k], moving(value, 0.0), moving(x[k], 0.0))
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


def force_in_series(functions: NDArray[np.intp], parameters: Array, elongations: Array, *arguments: Array) -> None:
    """Fill in the force of a damper with elements in series.

    By Newton's method: with the derivative over F on the motion, one call gives the damper's answer and its slope.

    Parameters
    ----------
    functions : ndarray (1 + elements,) of int
        `addresses` of the kernel of the damper model, and of the elongation of each element
        (`mrd_sim.effects.effect.Effect`), for one lane.
    parameters : ndarray (elements, parameters)
    elongations : ndarray (elements + 1,)
        Elongations, and after them the force; carried on.
    *arguments : ndarray
        ``q`` (coefficients, m); state, dt, x, v, a as of the kernel; ``force`` (m,), which holds what is added to the
        damper's force and is filled with the sum; and ``solved`` (m, 2 + states). This is filled with the F of the last
        call, next to the root, and with derivatives over F there: that of the damper's answer and those of its state.
    """
    row = empty_duals((1, len(arguments[0])), 1)
    work = empty_duals(_length_of_work(len(parameters), len(arguments[1])), 1)
    _force_in_series(functions, as_duals(parameters, 1), row, work, elongations, *arguments)


@_compiled(_matrix(_ONE), _vector(_ONE), *[_REALS] * 6)
def _elongations_under(
    functions: NDArray[np.intp],
    parameters: Any,
    work: Any,
    elongations: Array,
    dt: Array,
    x: Array,
    v: Array,
    force: Array,
    total: Array,
) -> None:
    count, against = len(elongations), AGAINST_ROD * np.abs(v).max()
    elements = _elements(functions, parameters, work, count)
    for i in range(count):
        elements.before[i] = moving(elongations[i], 0.0)
    for k in range(len(x)):
        if dt[k] >= SHORTEST_STEP:
            before = 0.0
            for i in range(count):
                before += elements.before[i].real
            change = _elongate(elements, dt[k], moving(force[k], 0.0), moving(x[k], 0.0)).real - before
            most = (max(v[k], 0.0) + against if change > 0.0 else against - min(v[k], 0.0)) * dt[k]
            share = most / abs(change) if abs(change) > most else 1.0
            for i in range(count):
                elements.before[i] += share * (elements.after[i] - elements.before[i])
        for i in range(count):
            total[k] += elements.before[i].real
    for i in range(count):
        elongations[i] = elements.before[i].real


def elongations_under(
    functions: NDArray[np.intp], parameters: Array, elongations: Array, dt: Array, x: Array, v: Array, force: Array
) -> Array:
    """Return the elongation (m,) in m of all elements together under a force (m,) that is known.

    The other arguments are those of `force_in_series`; ``elongations`` (elements,) is carried on. A force that does not go
    with the elements would cross a play faster than the rod moves. It is crossed so fast at most that the damper moves
    against the rod by `AGAINST_ROD`.
    """
    total = np.zeros(len(x))
    work = empty_duals(_length_of_work(len(parameters), 0), 1)
    _elongations_under(functions, as_duals(parameters, 1), work, elongations, dt, x, v, force, total)
    return total


_ALL = DualType(LANES)


@_compiled(_matrix(_ALL), *[_vector(_ALL)] * 2, _matrix(_ALL), _vector(_ALL), _REALS, *[_vector(_ALL)] * 4, _MATRIX)
def _derivatives_in_series(
    functions: NDArray[np.intp],
    parameters: Any,
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
    count, states = len(elongations) - 1, len(state)
    step = np.zeros(1)
    vertex = _vertex(q, work, states, step)
    elements = _elements(functions, parameters, work, count)
    before, after = elements.before, elements.after
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
        for i in range(states):
            vertex.state[i] = state[i]
        vertex.v[0] = v[k]
        if dt[k] > 0.0:
            sum_before = elongation
            elongation = _elongate(elements, dt[k], solved[k, 0] + 0.0 * root, x[k])
            vertex.v[0] = v[k] - (elongation - sum_before) * (1.0 / dt[k])
        vertex.x[0] = x[k] - elongation
        call(functions[0], _with_row(vertex, q, k))
        root = chained(force[k].real, 1.0 / (1.0 - solved[k, 1]), vertex.force[0] + force[k])
        force[k] = root
        change = root - solved[k, 0]
        for i in range(states):
            state[i] = vertex.state[i] + solved[k, 2 + i] * change
        if dt[k] > 0.0:
            elongation = _elongate(elements, dt[k], root, x[k])
            for i in range(count):
                before[i] = after[i]
    for i in range(count):
        elongations[i] = before[i]
    elongations[count] = root


def derivatives_in_series(functions: NDArray[np.intp], parameters: Array, elongations: Array, *arguments: Array) -> None:
    """Add to that force its derivatives, by the implicit function theorem.

    The arguments are those of `force_in_series`, which has filled the values of ``force`` and ``solved``; but ``q`` is
    (m, coefficients), and the derivatives of ``force`` are still those of what is added to the damper's force.
    """
    work = empty_duals(_length_of_work(len(parameters), len(arguments[1])))
    _derivatives_in_series(functions, parameters, work, elongations, *arguments)
