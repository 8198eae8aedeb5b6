"""Bristles, by which dry friction builds up over a travel (Dahl 1968)."""

import math

from numba import njit


@njit(cache=True, nogil=True)
def bristle_deflection(deflection: float, dx: float, travel: float, level: float) -> float:
    """Return the deflection of bristles (1 at Coulomb friction), which tends to ``level`` in the direction of ``dx``."""
    end = level if dx > 0.0 else -level
    return end + (deflection - end) * math.exp(-abs(dx) / (travel * level))
