"""The steps of a co-simulation FMU along a run, in one compiled loop that calls the FMU's C functions at their addresses."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

Array = NDArray[np.float64]

WARNING = 1
"""Largest status of a call that has not failed; the same number in FMI 2 and FMI 3."""


@intrinsic
def _call_c(_context: Any, address: Any, arguments: Any) -> Any:
    """Call a C function at an address, which returns an int; whole numbers and pointers as 64 bits, others as double."""
    kinds = arguments.types

    def code(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        passed = cgutils.unpack_tuple(builder, values[1])
        function = ir.FunctionType(ir.IntType(32), [value.type for value in passed])
        status = builder.call(builder.inttoptr(values[0], function.as_pointer()), passed)
        return builder.sext(status, ir.IntType(64))

    return types.int64(address, types.BaseTuple.from_types(kinds)), code


@njit(cache=True, nogil=True)
def run_steps(
    functions: NDArray[np.int64],
    instance: int,
    version: int,
    feedthrough: bool,
    references: NDArray[np.uint32],
    output: NDArray[np.uint32],
    step: float,
    inputs: Array,
    factors: Array,
    divisions: int,
    force: Array,
) -> int:
    """Step an FMU from sample to sample, and fill ``force`` (n,) in its own unit.

    Parameters
    ----------
    functions : ndarray (3,)
        Addresses of the functions that set, step and get.
    instance : int
        Address of the instance, which is initialised with the inputs of the first sample.
    version : int
        2 or 3, of the standard.
    feedthrough : bool
        Whether the force follows inputs that are set at the same communication point. Where it does not, a step gets the
        inputs at its end, so that the force is not late by a step; the first sample is the end of a step, too.
    references, output : ndarray
        Value references of the inputs and of the force.
    step : float
        s from sample to sample.
    inputs : ndarray (inputs, n)
        In SI.
    factors : ndarray (inputs,)
        From SI to the units of the FMU.
    divisions : int
        Steps from sample to sample, with inputs on straight lines between these.

    Returns
    -------
    int
        -1, or the number of the sample at which a call failed.
    """
    count = references.shape[0]
    values, answer = np.empty(count), np.empty(1)
    flags, reached = np.zeros(8, np.uint8), np.zeros(1)
    p_values, p_answer = values.ctypes.data, answer.ctypes.data
    p_in, p_out, p_flags, p_reached = references.ctypes.data, output.ctypes.data, flags.ctypes.data, reached.ctypes.data
    length = step / divisions
    steps = 0
    for k in range(inputs.shape[1]):
        failed = 0
        if k > 0 or not feedthrough:
            for part in range(divisions):
                begin = steps * length
                steps += 1
                if not feedthrough or part > 0:
                    share = (part + (0.0 if feedthrough else 1.0)) / divisions
                    for i in range(count):
                        values[i] = factors[i] * ((1.0 - share) * inputs[i, max(k - 1, 0)] + share * inputs[i, k])
                    failed = max(failed, _set(functions[0], instance, version, p_in, count, p_values))
                if version == 2:
                    status = _call_c(functions[1], (instance, begin, length, 1))
                else:
                    status = _call_c(
                        functions[1], (instance, begin, length, 1, p_flags, p_flags + 1, p_flags + 2, p_reached)
                    )
                failed = max(failed, status)
        if feedthrough:
            for i in range(count):
                values[i] = factors[i] * inputs[i, k]
            failed = max(failed, _set(functions[0], instance, version, p_in, count, p_values))
        if version == 2:
            status = _call_c(functions[2], (instance, p_out, 1, p_answer))
        else:
            status = _call_c(functions[2], (instance, p_out, 1, p_answer, 1))
        if max(failed, status) > WARNING or flags[1]:
            return k
        force[k] = answer[0]
    # What the pointers above point to has to live until here.
    return -1 if values.size + references.size + output.size + flags.size + reached.size > 0 else 0


@njit(inline="always")
def _set(function: int, instance: int, version: int, references: int, count: int, values: int) -> int:
    """Set the inputs of an FMU; return the status."""
    if version == 2:
        return _call_c(function, (instance, references, count, values))  # type: ignore[no-any-return]
    return _call_c(function, (instance, references, count, values, count))  # type: ignore[no-any-return]
