"""Calls of compiled functions by their addresses.

One compiled loop so serves all models. numba can pass compiled functions as arguments, too, but looks up the address of each
at every call, which takes longer than a path of a thousand vertices.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def address_of(function: Any, signature: Any) -> int:
    """Return the address of a function compiled for a signature; it holds as long as the function exists."""
    compiled = function.get_compile_result(signature)
    return int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))


def call_address(context: Any, builder: Any, result: Any, kinds: Any, address: Any, arguments: Any) -> Any:
    """Write the call of what is at an address; what it raises is raised."""
    pointer = builder.inttoptr(address, context.call_conv.get_function_type(result, kinds).as_pointer())
    status, value = context.call_conv.call_function(builder, pointer, result, kinds, arguments)
    with cgutils.if_unlikely(builder, status.is_error):
        context.call_conv.return_status_propagate(builder, status)
    return value


@intrinsic
def call(_context: Any, address: Any, arguments: Any) -> Any:
    """Call a function that returns nothing, at an address, with a tuple of arguments of exactly its types."""
    kinds = arguments.types

    def code(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return call_address(context, builder, types.none, kinds, values[0], cgutils.unpack_tuple(builder, values[1]))

    return types.none(address, arguments), code
