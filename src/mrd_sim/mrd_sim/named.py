"""Names for the entries of arrays in compiled functions.

A kernel is given plain arrays: one signature serves every model and every effect. Inside, it reads a row of coefficients or
a vector of parameters as a named tuple, ``c = named_row(Coefficients, q, k)`` and then ``c.viscous``. The compiler takes the
tuple apart again, so the names cost no time.
"""

from collections import namedtuple
from collections.abc import Sequence
from typing import Any, Protocol

from numba import types
from numba.extending import intrinsic, overload

Row = Any
"""A named tuple of coefficients, as an argument of a compiled function."""


class Named(Protocol):
    """Anything with a name: a coefficient, a parameter."""

    @property
    def name(self) -> str:
        """An identifier."""


def tuple_type(typename: str, module: str, entries: Sequence[Named]) -> Any:
    """Return the named tuple type whose fields are the names of ``entries``, in their order.

    ``typename`` and ``module`` say which global variable holds the type: numba's cache finds it there.
    """
    return namedtuple(typename, [entry.name for entry in entries], module=module)


def named_row(kind: Any, matrix: Any, k: int) -> Any:
    """Return row ``k`` of a matrix as a named tuple of the type ``kind``."""
    return kind(*matrix[k])


def named(kind: Any, vector: Any) -> Any:
    """Return the first entries of a vector as a named tuple of the type ``kind``."""
    return kind(*vector[: len(kind._fields)])


@intrinsic
def _entries(context: Any, kind: Any, array: Any, k: Any) -> Any:
    """Named tuple of the entries in row ``k`` of a matrix, or of a vector (``k`` then counts for nothing)."""
    fields = kind.instance_class
    result = types.NamedUniTuple(array.dtype, len(fields._fields), fields)

    def entry_of_vector(array: Any, k: int, j: int) -> Any:
        return array[j]

    def entry_of_matrix(array: Any, k: int, j: int) -> Any:
        return array[k, j]

    entry = entry_of_matrix if array.ndim == 2 else entry_of_vector
    signature = array.dtype(array, types.intp, types.intp)

    def code(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        _, pointer, row = arguments
        columns = [context.get_constant(types.intp, j) for j in range(len(fields._fields))]
        entries = [context.compile_internal(builder, entry, signature, (pointer, row, column)) for column in columns]
        return context.make_tuple(builder, result, entries)

    return result(kind, array, types.intp), code


@overload(named_row)
def _compiled_named_row(kind: Any, matrix: Any, k: Any) -> Any:
    def entries(kind: Any, matrix: Any, k: Any) -> Any:
        return _entries(kind, matrix, k)

    return entries


@overload(named)
def _compiled_named(kind: Any, vector: Any) -> Any:
    def entries(kind: Any, vector: Any) -> Any:
        return _entries(kind, vector, 0)

    return entries
