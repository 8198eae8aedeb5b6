"""Viscosity falls with shear."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

CARREAU, CROSS, SECOND_NEWTONIAN = range(3)

CROSS_EXPONENT = 2 / 3
"""Exponent that Cross found for many dispersions."""

THINNING, CRITICAL = size("thinning", 0.3, 0.7), shape("critical_speed", 0.01, 0.04, logarithmic=True)

EFFECT = TrueEffect(
    "shear_thinning",
    "Viscosity falls with shear",
    (
        development("carreau", "power of 1 + (v / v_c)² (Carreau 1972)", THINNING, CRITICAL),
        development("cross", "from one viscosity to a lower one (Cross 1965)", THINNING, CRITICAL),
        evaluation(
            "second_newtonian",
            "two viscosities, the lower one beyond a speed (Ostwald 1925)",
            THINNING,
            shape("critical_speed", 0.03, 0.09, logarithmic=True),
        ),
    ),
)


@njit(cache=True, nogil=True)
def thinning_factor(p: PlantValues, v: float) -> float:
    """Return the viscosity over that at rest."""
    thinning = p.shear_thinning_thinning
    if thinning == 0.0:
        return 1.0
    over = abs(v) / p.shear_thinning_critical_speed
    if p.shear_thinning_formula == CROSS:
        sheared = math.pow(over, CROSS_EXPONENT)
        return 1.0 - thinning * sheared / (1.0 + sheared)
    if p.shear_thinning_formula == SECOND_NEWTONIAN:
        return 1.0 - thinning * (1.0 - 1.0 / over) if over > 1.0 else 1.0
    return math.pow(1.0 + over * over, -0.5 * thinning)
