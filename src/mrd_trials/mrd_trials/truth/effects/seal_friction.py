"""Dry friction of the seal."""

import math

from numba import njit

from mrd_trials.truth.effects.bristles import bristle_deflection
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

HUMP, FALLING, SMOOTH = range(3)

TRAVEL = 25e-6
"""Travel in m over which the friction of bristles changes its direction."""

SLIDING_SPEED = 3e-3
"""Speed in m/s over which smooth friction changes its direction."""

SIZES = (size("coulomb", 40.0, 120.0), shape("stiction", 0.2, 1.0), shape("stribeck_speed", 1e-3, 1e-2, logarithmic=True))

EFFECT = TrueEffect(
    "seal_friction",
    "Dry friction of the seal",
    (
        development("hump", "bristles with a hump 1 / (1 + (v / v_s)²) (Dahl 1968; Hess & Soom 1990)", *SIZES),
        development("falling", "bristles with a hump that falls exponentially (Tustin 1947)", *SIZES),
        evaluation("smooth", "hyperbolic tangent of the speed, no presliding (Makkar et al. 2005)", *SIZES),
    ),
)


@njit(cache=True, nogil=True)
def stribeck_factor(p: PlantValues, v: float) -> float:
    """Return the friction at a steady speed over the Coulomb friction."""
    if p.seal_friction_stiction == 0.0:
        return 1.0
    over = abs(v) / p.seal_friction_stribeck_speed
    if p.seal_friction_formula == FALLING:
        return 1.0 + p.seal_friction_stiction * math.exp(-over)
    if p.seal_friction_formula == SMOOTH:
        return 1.0 + p.seal_friction_stiction / math.cosh(min(over, 100.0))
    return 1.0 + p.seal_friction_stiction / (1.0 + over * over)


@njit(cache=True, nogil=True)
def seal_deflection(p: PlantValues, deflection: float, dx: float, v: float, level: float) -> float:
    """Return the friction over the Coulomb friction after a motion by ``dx`` that ends at ``v``; it tends to ``level``."""
    if p.seal_friction_formula == SMOOTH:
        return level * math.tanh(v / SLIDING_SPEED)
    return float(bristle_deflection(deflection, dx, TRAVEL, level))
