"""Dual numbers: a value and its derivatives to several parameters, as a number type of compiled functions and of arrays.

In compiled code a dual number is a float and a vector of derivatives, its lanes. The value is computed once, with its
branches and its transcendental functions, and the chain rule acts on all lanes at once, in the vector registers of the
processor. Functions compiled by numba take these numbers like floats: mixed with them in sums, products and quotients, and
in arrays. They compare values by ``.real``. Two numbers are equal (``==``) only if their derivatives are, too.
"""

import operator
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.datamodel import models, register_default
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, make_attribute_wrapper, typeof_impl
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rule = Callable[..., tuple[Any, Any]]

LANES = 16
"""Derivatives that one evaluation carries. A power of two; more than a model of the catalogue usually has free."""

_FLOAT, _INDEX = ir.DoubleType(), ir.IntType(32)
_CONTRACT = ("contract",)
"""Products and sums of derivatives may be fused; values are those of floats, digit by digit."""


class Duals(np.ndarray[Any, Any]):
    """Array of dual numbers; see `as_duals`."""

    __numba_array_subtype_dispatch__ = True

    @property  # type: ignore[misc]
    def real(self) -> Array:
        """Values, as a view."""
        return np.asarray(self["real"])

    @property
    def derivatives(self) -> Array:
        """Derivatives (..., lanes), as a view."""
        return np.asarray(self["derivatives"])

    @property
    def columns(self) -> Array:
        """Values and derivatives side by side, (..., 1 + lanes), as a view of a contiguous array."""
        return self.view(np.ndarray).view(np.float64).reshape(*self.shape, self.itemsize // 8)


def empty_duals(shape: int | tuple[int, ...], lanes: int = LANES) -> Duals:
    """Return an array of dual numbers that is not filled."""
    return np.empty(shape, np.dtype([("real", "f8"), ("derivatives", "f8", (lanes,))])).view(Duals)


def as_duals(values: Array, lanes: int = LANES) -> Duals:
    """Return values as dual numbers without derivatives; dual numbers as they are."""
    if isinstance(values, Duals):
        return values
    duals = empty_duals(np.shape(values), lanes)
    duals.columns[...] = 0.0
    duals.real[...] = values
    return duals


def like(theta: Array, values: Array) -> Array:
    """Return values as numbers of the type of ``theta``, floats or dual ones."""
    return as_duals(values) if isinstance(theta, Duals) else values


def columns_of(numbers: Array) -> Array:
    """Return dual numbers (n,) as floats, values and derivatives side by side (n, 1 + lanes); floats as they are."""
    return numbers.columns if isinstance(numbers, Duals) else numbers


def along(theta: Array, direction: Array) -> Duals:
    """Return a parameter vector (parameters,) whose first derivative is that along a direction (parameters,)."""
    duals = as_duals(theta)
    duals.derivatives[:, 0] = direction
    return duals


class DualType(types.Type):
    """Type of a dual number in compiled code."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(f"Dual({lanes})")

    def unify(self, context: Any, other: Any) -> Any:
        """Return the type of what is either of this type or a float."""
        return self if isinstance(other, types.Number) else None

    def can_convert_from(self, context: Any, other: Any) -> Any:
        """Return how a float becomes a dual number: safely."""
        return Conversion.safe if isinstance(other, types.Number) else None


class _LanesType(types.Type):
    """Type of the derivatives of a dual number."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(f"Lanes({lanes})")


@register_default(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: _LanesType) -> None:
        super().__init__(manager, kind, ir.VectorType(_FLOAT, kind.lanes))


@register_default(DualType)
class _DualModel(models.StructModel):
    def __init__(self, manager: Any, kind: DualType) -> None:
        super().__init__(manager, kind, [("real", types.float64), ("derivatives", _LanesType(kind.lanes))])

    def get_data_type(self) -> Any:
        """Return the type in memory: packed, so that arrays are aligned like those of floats."""
        return ir.LiteralStructType([model.get_data_type() for model in self._models], packed=True)

    def load_from_data_pointer(self, builder: Any, pointer: Any, align: int | None = None) -> Any:
        """Load a number; the processor must not expect vectors at multiples of their size."""
        return super().load_from_data_pointer(builder, pointer, 8)


make_attribute_wrapper(DualType, "real", "real")


@cache
def _array_type(lanes: int, dimensions: int, layout: str) -> types.Array:
    return types.Array(DualType(lanes), dimensions, layout)


@typeof_impl.register(Duals)
def _type_of(array: Duals, _context: Any) -> types.Array:
    layout = "C" if array.flags.c_contiguous else "F" if array.flags.f_contiguous else "A"
    return _array_type(array.dtype["derivatives"].shape[0], array.ndim, layout)


def _vector(lanes: int) -> ir.VectorType:
    return ir.VectorType(_FLOAT, lanes)


def _every_lane(builder: Any, value: Any, lanes: int) -> Any:
    undefined = ir.Constant(_vector(lanes), ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(_INDEX, lanes), None))


def _scaled(builder: Any, derivatives: Any, factor: Any) -> Any:
    return builder.fmul(derivatives, _every_lane(builder, factor, derivatives.type.count), _CONTRACT)


def _number(builder: Any, value: Any, derivatives: Any) -> Any:
    number = ir.Constant(ir.LiteralStructType([_FLOAT, derivatives.type]), ir.Undefined)
    return builder.insert_value(builder.insert_value(number, value, 0), derivatives, 1)


def _operands(builder: Any, kinds: Any, arguments: Any) -> tuple[int, list[Any]]:
    """Return the number of lanes, and of each argument its value and its derivatives, None of a float."""
    lanes = next(kind.lanes for kind in kinds if isinstance(kind, DualType))
    operands: list[Any] = []
    for kind, argument in zip(kinds, arguments, strict=True):
        is_dual = isinstance(kind, DualType)
        operands += [builder.extract_value(argument, i) for i in range(2)] if is_dual else [argument, None]
    return lanes, operands


def _sum(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    return builder.fadd(x, y), dx if dy is None else dy if dx is None else builder.fadd(dx, dy, _CONTRACT)


def _difference(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    return builder.fsub(x, y), dx if dy is None else builder.fneg(dy) if dx is None else builder.fsub(dx, dy, _CONTRACT)


def _product(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    parts = [_scaled(builder, d, factor) for d, factor in ((dx, y), (dy, x)) if d is not None]
    return builder.fmul(x, y), parts[0] if len(parts) == 1 else builder.fadd(*parts, _CONTRACT)


def _quotient(builder: Any, x: Any, dx: Any, y: Any, dy: Any) -> tuple[Any, Any]:
    value, inverse = builder.fdiv(x, y), builder.fdiv(ir.Constant(_FLOAT, 1.0), y)
    if dy is None:
        return value, _scaled(builder, dx, inverse)
    less = _scaled(builder, dy, value)
    return value, _scaled(builder, builder.fneg(less) if dx is None else builder.fsub(dx, less, _CONTRACT), inverse)


def _declare(operation: Any, result: Any, arity: int, code: Callable[..., Any]) -> None:
    """Make an operator known for dual numbers, mixed with floats or not."""

    class Template(AbstractTemplate):
        key = operation

        def generic(self, arguments: Any, _keywords: Any) -> Any:
            duals = [kind for kind in arguments if isinstance(kind, DualType)]
            if not duals or not all(kind == duals[0] or isinstance(kind, types.Number) for kind in arguments):
                return None
            kinds = [kind if isinstance(kind, DualType) else types.float64 for kind in arguments]
            return signature(result or duals[0], *kinds)

    infer_global(operation)(Template)
    pairs = ((DualType, DualType), (DualType, types.Float), (types.Float, DualType))
    for kinds in pairs if arity == 2 else ((DualType,),):
        lower_builtin(operation, *kinds)(code)


def _arithmetic(rule: Rule) -> Callable[..., Any]:
    def code(_context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _, operands = _operands(builder, signature.args, arguments)
        return _number(builder, *rule(builder, *operands))

    return code


def _equal(_context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    lanes, (x, dx, y, dy) = _operands(builder, signature.args, arguments)
    zero = ir.Constant(_vector(lanes), None)
    differ = builder.fcmp_unordered("!=", zero if dx is None else dx, zero if dy is None else dy)
    none_differs = builder.icmp_unsigned("==", builder.bitcast(differ, ir.IntType(lanes)), ir.Constant(ir.IntType(lanes), 0))
    return builder.and_(builder.fcmp_ordered("==", x, y), none_differs)


def _unequal(*arguments: Any) -> Any:
    return arguments[1].not_(_equal(*arguments))


for _operations, _rule in (
    ((operator.add, operator.iadd), _sum),
    ((operator.sub, operator.isub), _difference),
    ((operator.mul, operator.imul), _product),
    ((operator.truediv, operator.itruediv), _quotient),
    ((operator.neg,), lambda builder, x, dx: (builder.fneg(x), builder.fneg(dx))),
):
    for _operation in _operations:
        _declare(_operation, None, 1 if _operation is operator.neg else 2, _arithmetic(_rule))
_declare(operator.eq, types.boolean, 2, _equal)
_declare(operator.ne, types.boolean, 2, _unequal)


@lower_cast(types.Float, DualType)
@lower_cast(types.Integer, DualType)
def _constant(context: Any, builder: Any, given: Any, kind: DualType, value: Any) -> Any:
    return _number(builder, context.cast(builder, value, given, types.float64), ir.Constant(_vector(kind.lanes), None))


@intrinsic
def chained(_context: Any, value: Any, slope: Any, z: Any) -> Any:
    """Number with this value whose derivatives are ``slope`` times those of ``z``."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        value, slope, number = arguments
        return _number(builder, value, _scaled(builder, builder.extract_value(number, 1), slope))

    return z(types.float64, types.float64, z), code


@intrinsic
def moving(_context: Any, value: Any, slope: Any) -> Any:
    """Number of one lane with this value and this derivative."""
    kind = DualType(1)

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _number(builder, arguments[0], _every_lane(builder, arguments[1], 1))

    return kind(types.float64, types.float64), code


@intrinsic
def slope_of(_context: Any, z: Any) -> Any:
    """Derivative in the first lane of a number."""

    def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.extract_element(builder.extract_value(arguments[0], 1), ir.Constant(_INDEX, 0))

    return types.float64(z), code
