"""Elementary functions for numbers that carry derivatives.

A dual number (`mrd_sim.dual_type`) is a value with its derivatives to some parameters. Kernels written with these functions
and with comparisons of ``.real`` compile for floats at full speed, and for dual numbers, with which they give the exact
derivatives to all parameters in one pass (forward-mode differentiation: Wengert, 1964).
"""

import math
from collections.abc import Callable
from typing import Any

from numba import njit
from numba.extending import overload, register_jitable

from mrd_base.kernel_cache import write_one_at_a_time
from mrd_sim.dual_type import DualType, chained

write_one_at_a_time()


def _lift(function: Callable[[float], float], derivative: Callable[[float, float], float]) -> Callable[[Any], Any]:
    """Return ``function`` for floats and for dual numbers, given ``derivative(z, function(z))``."""
    slope = register_jitable(derivative)

    def with_derivatives(z: Any) -> Any:
        value = function(z.real)
        return chained(value, slope(z.real, value), z)

    def of_float(z: Any) -> Any:
        return function(z)

    def lifted(z: Any) -> Any:
        return function(z)

    @overload(lifted)
    def _compiled(z: Any) -> Any:
        return with_derivatives if isinstance(z, DualType) else of_float

    return lifted


exp = _lift(math.exp, lambda z, f: f)
expm1 = _lift(math.expm1, lambda z, f: f + 1.0)
log = _lift(math.log, lambda z, f: 1.0 / z)
log1p = _lift(math.log1p, lambda z, f: 1.0 / (1.0 + z))
sqrt = _lift(math.sqrt, lambda z, f: 0.5 / f)
sin = _lift(math.sin, lambda z, f: math.cos(z))
cos = _lift(math.cos, lambda z, f: -math.sin(z))
tan = _lift(math.tan, lambda z, f: 1.0 + f * f)
atan = _lift(math.atan, lambda z, f: 1.0 / (1.0 + z * z))
tanh = _lift(math.tanh, lambda z, f: 1.0 - f * f)


@njit(cache=True, nogil=True)
def absolute(z: Any) -> Any:
    """Return |z|, with the derivative of the side on which z lies."""
    return z if z.real >= 0.0 else -z


@njit(cache=True, nogil=True)
def power(z: Any, n: Any) -> Any:
    """Return z^n for z > 0, and for z = 0 and n >= 1; 0 for a z so small that 1 / z overflows."""
    return exp(n * log(z)) if z.real > 1e-200 else 0.0 * z


@njit(cache=True, nogil=True)
def clip(z: Any, low: Any, high: Any) -> Any:
    """Return the number between ``low`` and ``high`` that is nearest to z."""
    return low if z.real < low.real else high if z.real > high.real else z


@njit(cache=True, nogil=True)
def at_least(low: float, z: Any) -> Any:
    """Return z, or ``low`` where z is less."""
    return low + 0.0 * z if z.real < low else z
