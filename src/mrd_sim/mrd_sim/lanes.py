"""Candidates in lanes: several parameter vectors evaluated along one path at a time.

A number in lanes is a vector of floats, one for each candidate, that the processor adds, multiplies and divides at once. A
function in scalar form is compiled for such numbers as it stands, unless it decides something by a value. What decides is
replaced by a version in lanes (`VERSIONS`), which selects; so models that leave their decisions to these functions run in
lanes, and the file of a model stays the only place of its equation.
"""

import operator
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core.datamodel import models, register_default
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, typeof_impl
from numpy.typing import NDArray

from mrd_sim import current, dual, hysteresis, lag
from mrd_sim.addresses import address_of, call
from mrd_sim.named import named_row
from mrd_sim.path import Path

Array = NDArray[np.float64]

CANDIDATES = 8
"""Candidates in lanes: as many floats as the largest vector registers hold."""

BLOCK = 128
"""Vertices of which the coefficients are kept at a time: as many as the processor's first cache holds."""

_FLOAT, _INTEGER, _INDEX = ir.DoubleType(), ir.IntType(64), ir.IntType(32)
_ROUNDS = 1.5 * 2.0**52
"""Added and subtracted, it rounds a number to the nearest whole one."""

_VECTOR, _INTEGERS = ir.VectorType(_FLOAT, CANDIDATES), ir.VectorType(_INTEGER, CANDIDATES)


class InLanes(np.ndarray[Any, Any]):
    """Array of numbers in lanes."""

    __numba_array_subtype_dispatch__ = True


def in_lanes(candidates: Array) -> InLanes:
    """Return vectors (`CANDIDATES`, n) as one vector (n,) of numbers in lanes."""
    numbers = empty_in_lanes(candidates.shape[1])
    numbers["lanes"] = candidates.T
    return numbers


def empty_in_lanes(shape: int | tuple[int, ...]) -> InLanes:
    """Return an array of numbers in lanes that is not filled."""
    return np.empty(shape, np.dtype([("lanes", "f8", (CANDIDATES,))])).view(InLanes)


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__(f"InLanes({CANDIDATES})")

    def unify(self, context: Any, other: Any) -> Any:
        """Return the type of what is either of this type or a float."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, context: Any, other: Any) -> Any:
        """Return how a float becomes a number in lanes: safely."""
        return Conversion.safe if isinstance(other, types.Number) else None


_NUMBER = _LanesType()


@register_default(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _LanesType) -> None:
        super().__init__(manager, kind, _VECTOR)

    def get_data_type(self) -> Any:
        """Return the type in memory: packed, so that arrays are aligned like those of floats."""
        return ir.LiteralStructType([_VECTOR], packed=True)

    def as_data(self, builder: Any, value: Any) -> Any:
        """Return a number as it is stored."""
        return builder.insert_value(ir.Constant(self.get_data_type(), ir.Undefined), value, 0)

    def from_data(self, builder: Any, value: Any) -> Any:
        """Return a number from what is stored."""
        return builder.extract_value(value, 0)

    def load_from_data_pointer(self, builder: Any, pointer: Any, align: int | None = None) -> Any:
        """Load a number; the processor must not expect vectors at multiples of their size."""
        return builder.load(builder.bitcast(pointer, _VECTOR.as_pointer()), align=8)


@cache
def _array_type(dimensions: int, layout: str) -> types.Array:
    return types.Array(_NUMBER, dimensions, layout)


@typeof_impl.register(InLanes)
def _type_of(array: InLanes, _context: Any) -> types.Array:
    layout = "C" if array.flags.c_contiguous else "F" if array.flags.f_contiguous else "A"
    return _array_type(array.ndim, layout)


def _every_lane(builder: Any, value: Any) -> Any:
    if value.type == _VECTOR:
        return value
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(_INDEX, CANDIDATES), None))


def _declare(operation: Any, code: Callable[..., Any]) -> None:
    class Template(AbstractTemplate):
        key = operation

        def generic(self, arguments: Any, _keywords: Any) -> Any:
            known = all(kind == _NUMBER or isinstance(kind, types.Number) for kind in arguments)
            if _NUMBER not in arguments or not known:
                return None
            return signature(_NUMBER, *[_NUMBER if kind == _NUMBER else types.float64 for kind in arguments])

    def lowered(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return code(builder, *(_every_lane(builder, argument) for argument in arguments))

    infer_global(operation)(Template)
    for kinds in ((_LanesType, _LanesType), (_LanesType, types.Float), (types.Float, _LanesType), (_LanesType,)):
        lower_builtin(operation, *kinds)(lowered)


for _operations, _name in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
    ((operator.neg,), "fneg"),
):
    for _operation in _operations:
        _declare(_operation, lambda builder, *arguments, name=_name: getattr(builder, name)(*arguments))


@lower_cast(types.Float, _LanesType)
@lower_cast(types.Integer, _LanesType)
def _constant(context: Any, builder: Any, given: Any, _kind: Any, value: Any) -> Any:
    return _every_lane(builder, context.cast(builder, value, given, types.float64))


def _vectors(context: Any, builder: Any, kinds: Any, arguments: Any) -> list[Any]:
    pairs = zip(kinds, arguments, strict=True)
    cast = [value if kind == _NUMBER else context.cast(builder, value, kind, types.float64) for kind, value in pairs]
    return [_every_lane(builder, value) for value in cast]


@intrinsic
def choose(_context: Any, a: Any, b: Any, where_not_less: Any, where_less: Any) -> Any:
    """In each lane ``where_not_less`` if a >= b, else ``where_less``."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, b, x, y = _vectors(context, builder, signature.args, arguments)
        return builder.select(builder.fcmp_ordered(">=", a, b), x, y)

    return _NUMBER(a, b, where_not_less, where_less), code


@intrinsic
def every(_context: Any, a: Any, b: Any) -> Any:
    """Whether a >= b in all lanes."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        holds = builder.fcmp_ordered(">=", *_vectors(context, builder, signature.args, arguments))
        bits = builder.bitcast(holds, ir.IntType(CANDIDATES))
        return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, 2**CANDIDATES - 1))

    return types.boolean(a, b), code


@intrinsic
def _lane(_context: Any, z: Any, i: Any) -> Any:
    """Value in one lane."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.extract_element(*arguments)

    return types.float64(z, types.intp), code


@intrinsic
def _with_lane(_context: Any, z: Any, i: Any, value: Any) -> Any:
    """Number with another value in one lane."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.insert_element(arguments[0], arguments[2], arguments[1])

    return z(z, types.intp, types.float64), code


@intrinsic
def _power_of_two(_context: Any, z: Any) -> Any:
    """2 to the power of a whole number between -1022 and 1023."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        def whole(value: int) -> Any:
            return ir.Constant(_INTEGERS, [value] * CANDIDATES)

        exponent = builder.add(builder.fptosi(arguments[0], _INTEGERS), whole(1023))
        return builder.bitcast(builder.shl(exponent, whole(52)), _VECTOR)

    return z(z), code


@njit(cache=True, nogil=True, fastmath={"contract"})
def decayed(h: Any) -> Any:
    """Return e^-h, h >= 0, to the last digits: 2^k e^r with |r| <= ln 2 / 2, and the Taylor series of e^r."""
    z = choose(h, 700.0, -700.0, -h)
    k = (z * 1.4426950408889634 + _ROUNDS) - _ROUNDS
    r = z - k * 0.693147180369123816490 - k * 1.90821492927058770002e-10
    s = r * r
    low = (1.0 + r) + s * (0.5 + r * (1.0 / 6))
    middle = (1.0 / 24 + r * (1.0 / 120)) + s * (1.0 / 720 + r * (1.0 / 5040))
    high = (1.0 / 40320 + r * (1.0 / 362880)) + s * (1.0 / 3628800 + r * (1.0 / 39916800))
    q = s * s
    return (low + q * (middle + q * high)) * _power_of_two(k)


@njit(cache=True, nogil=True, fastmath={"contract"})
def advance(w: Any, travel: Any, sigma: Any, n: Any) -> Any:
    """Return `mrd_sim.hysteresis.advance` in lanes.

    For n = 2 the loading is the same formula. Unloading over up to half a yield travel takes the tangent by its continued
    fraction (Lambert, 1768), which there has all digits. Where a lane is another case, all take their turns one by one.
    """
    direction = choose(travel, 0.0, 1.0, -1.0)
    h, v = direction * travel, direction * w
    if every(0.0, (n - 2.0) * (n - 2.0)):
        rest = (1.0 - v) * decayed(2.0 * h)
        above, below = 1.0 + v - rest, 1.0 + v + rest
        if every(v, 0.0):
            return direction * above / below
        b = 2.0 * sigma - 1.0
        z = b * h * h
        sine = h * (10395.0 - z * (1260.0 - 21.0 * z))
        cosine = 10395.0 - z * (4725.0 - z * (210.0 - z))
        unloaded = sine + v * cosine
        if every(choose(v, 0.0, 0.25, 0.25 - z), 0.0) and every(choose(v, 0.0, 0.0, -unloaded), 0.0):
            return direction * choose(v, 0.0, above, unloaded) / choose(v, 0.0, below, cosine - b * v * sine)
    after = w
    for i in range(CANDIDATES):
        after = _with_lane(after, i, hysteresis.advance(_lane(w, i), _lane(travel, i), _lane(sigma, i), _lane(n, i)))
    return after


@njit(cache=True, nogil=True, fastmath={"contract"})
def tanh(z: Any) -> Any:
    """Return the hyperbolic tangent in lanes, with an error of the last digit of one."""
    rest = decayed(2.0 * choose(z, 0.0, z, -z))
    size = (1.0 - rest) / (1.0 + rest)
    return choose(z, 0.0, size, -size)


@njit(cache=True, nogil=True)
def at_least(low: float, z: Any) -> Any:
    """Return `mrd_sim.dual.at_least` in lanes."""
    return choose(low, z, low, z)


@njit(cache=True, nogil=True)
def decay(step: float, lags: Any) -> Any:
    """Return `mrd_sim.lag.decay` in lanes."""
    shortest = lag.SHORTEST_LAG
    return choose(lags, shortest, decayed(step / choose(lags, shortest, lags, shortest)), 0.0)


@njit(cache=True, nogil=True)
def ramp_share(steps: Any, left: Any) -> Any:
    """Return `mrd_sim.lag.ramp_share` in lanes."""
    return choose(steps, lag.LONG_LAG, 1.0 - 0.5 / choose(steps, 1.0, steps, 1.0), steps * (1.0 - left))


@njit(cache=True, nogil=True)
def slope_factor(code: int, third: Any, u: Any) -> Any:
    """Return `mrd_sim.current.slope_factor` in lanes."""
    if code < 3:
        return u + 0.0 * third
    factor = 0.0 * third + 0.0 * u
    for i in range(CANDIDATES):
        factor = _with_lane(factor, i, current.slope_factor(code, _lane(third, i), _lane(u, i)))
    return factor


VERSIONS: dict[Any, Any] = {
    dual.at_least: at_least,
    dual.tanh: tanh,
    hysteresis.advance: advance,
    lag.decay: decay,
    lag.ramp_share: ramp_share,
    current.slope_factor: slope_factor,
}
"""Version in lanes of each function that decides by a value."""


def runs_in_lanes(kernel: Any) -> bool:
    """Whether a kernel decides nothing by a value, but in functions that have a version in lanes."""
    code, names = kernel.py_func.__code__, kernel.py_func.__globals__
    called = [f for f in map(names.get, code.co_names) if callable(f) and not isinstance(f, type) and f is not named_row]
    return "real" not in code.co_names and all(f in VERSIONS for f in called)


@cache
def version_in_lanes(function: Any) -> Any:
    """Return a compiled function in lanes: the same code, with the functions that decide replaced."""
    original = function.py_func
    names = {name: VERSIONS.get(f, f) if callable(f) else f for name, f in original.__globals__.items()}
    replaced = FunctionType(original.__code__, names, original.__name__, original.__defaults__)
    replaced.__module__, replaced.__qualname__ = original.__module__, original.__qualname__
    return njit(cache=True, nogil=True, fastmath={"contract"})(replaced)


_NUMBERS, _ROWS = types.Array(_NUMBER, 1, "C"), types.Array(_NUMBER, 2, "C")
_FLOATS, _PLACES, _TABLE = types.float64[::1], types.intp[::1], types.intp[:, ::1]


@cache
def _addresses(kernel: Any) -> NDArray[np.intp]:
    """Return the addresses of the coil lag, of the coefficients and of a kernel in lanes."""
    of_lag = types.none(_NUMBERS, _NUMBERS, _FLOATS, _FLOATS, _NUMBERS)
    of_laws = types.none(_NUMBERS, _PLACES, _TABLE, _FLOATS, _NUMBERS, _ROWS)
    of_kernel = types.none(_ROWS, _NUMBERS, *[_FLOATS] * 4, _NUMBERS)
    functions = (current.lagged_current, of_lag), (current.evaluate_coefficients, of_laws), (kernel, of_kernel)
    return np.array([address_of(version_in_lanes(function), of) for function, of in functions], np.intp)


@njit(
    types.none(
        *(_PLACES, _NUMBERS, _PLACES, _TABLE, _FLOATS, _NUMBERS),
        *[_FLOATS] * 5,
        *(_PLACES, _NUMBERS, _NUMBERS, _ROWS, _NUMBERS),
    ),
    cache=True,
    nogil=True,
)
def _force(
    functions: Any,
    theta: Any,
    codes: Any,
    columns: Any,
    floors: Any,
    state: Any,
    dt: Array,
    measured: Array,
    x: Array,
    v: Array,
    a: Array,
    samples: Any,
    force: Any,
    effective: Any,
    rows: Any,
    forces: Any,
) -> None:
    last, sample = 0, 0
    while last < len(dt):
        first, last = last, min(last + len(effective), len(dt))
        while last < len(dt) and last > first + 1 and dt[last] == 0.0:  # it would begin a path
            last -= 1
        u, q, step = effective[: last - first], rows[: last - first], dt[first:last]
        call(functions[0], (theta[len(theta) - 1 :], state[:2], step, measured[first:last], u))
        call(functions[1], (theta, codes, columns, floors, u, q))
        call(functions[2], (q, state[2:], step, x[first:last], v[first:last], a[first:last], force[: last - first]))
        while sample < len(samples) and samples[sample] < last:
            forces[sample] = force[samples[sample] - first]
            sample += 1


def force_in_lanes(
    kernel: Any, states: int, thetas: Array, laws: tuple[NDArray[Any], ...], path: Path, samples: NDArray[np.intp]
) -> Array:
    """Return the force (`CANDIDATES`, samples) in N of candidates ``thetas`` (`CANDIDATES`, parameters) from rest.

    ``laws`` are codes, columns and floors of the coefficients as of `mrd_sim.current.evaluate_coefficients`, ``samples`` the
    vertices of the path that are wanted, in their order.
    """
    theta, state, forces = in_lanes(thetas), empty_in_lanes(2 + states), empty_in_lanes(len(samples))
    state["lanes"] = 0.0
    state["lanes"][:2] = path.current[0]
    series = path.dt, path.current, path.position, path.velocity, path.acceleration, np.ascontiguousarray(samples)
    scratch = empty_in_lanes(BLOCK), empty_in_lanes(BLOCK), empty_in_lanes((BLOCK, len(laws[0])))
    _force(_addresses(kernel), theta, *laws, state, *series, *scratch, forces)
    return np.asarray(forces["lanes"]).T
