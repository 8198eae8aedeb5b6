"""Friction that grows away from a centre, as of a bent or misaligned rod."""

import math

from numba import njit

from mrd_trials.truth.effects.bristles import bristle_deflection
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

BLUNT, BENT, JAMMING = range(3)

TRAVEL = 40e-6
"""Travel in m over which the friction of the guide changes its direction."""

CLEARANCE, REACH = 3e-3, 12e-3
"""Distance in m from the centre within which clearance keeps the rod free, and over which bending and jamming develop."""

SLOPE, CENTRE = size("slope", 1500.0, 3000.0), shape("centre", -5e-3, 5e-3)

EFFECT = TrueEffect(
    "side_load_friction",
    "Friction that grows away from a centre",
    (
        development(
            "blunt", "linear beyond the clearance of the guide (Coulomb 1785)", SLOPE, CENTRE, shared=("slope", "centre")
        ),
        development(
            "bent", "a bent rod presses with the square of the distance (Euler-Bernoulli)", SLOPE, CENTRE, shared=("centre",)
        ),
        evaluation(
            "jamming",
            "friction increases the pressure that causes it: exponential (Euler 1769)",
            SLOPE,
            CENTRE,
            shared=("centre",),
        ),
    ),
)


@njit(cache=True, nogil=True)
def guide_friction(p: PlantValues, x: float) -> float:
    """Return the magnitude of the guide's friction in N."""
    distance = abs(x - p.side_load_friction_centre)
    if p.side_load_friction_formula == BENT:
        return p.side_load_friction_slope * distance * distance / REACH
    if p.side_load_friction_formula == JAMMING:
        return 0.6 * p.side_load_friction_slope * REACH * math.expm1(distance / REACH)
    return p.side_load_friction_slope * (math.sqrt(distance * distance + CLEARANCE * CLEARANCE) - CLEARANCE)


@njit(cache=True, nogil=True)
def guide_deflection(deflection: float, dx: float) -> float:
    """Return the deflection (-1 to 1) of the guide's bristles after a motion."""
    return float(bristle_deflection(deflection, dx, TRAVEL, 1.0))
