"""Spring beside the damper that hardens with its deflection."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

QUARTIC, SINE, TANGENT = range(3)

DEFLECTION, FORCE = 8e-3, 40.0
"""Deflection in m at which a spring of hardness 1 presses with this force in N."""

SCALE = 3e-3
"""Deflection in m over which the hyperbolic sine grows e-fold."""

LIMIT = 0.035
"""Deflection in m at which the tangent has its pole, beyond any stroke."""

HARDNESS = size("hardness", 1.0, 10.0)

EFFECT = TrueEffect(
    "hardening_spring",
    "Spring that hardens with its deflection",
    (
        development("quartic", "fourth power of the deflection", HARDNESS),
        development("sine", "hyperbolic sine of the deflection", HARDNESS),
        evaluation("tangent", "tangent of the deflection", HARDNESS),
    ),
)


@njit(cache=True, nogil=True)
def hardening_force(p: PlantValues, x: float) -> float:
    """Return the force (N) of the hardening spring."""
    if p.hardening_spring_hardness == 0.0:
        return 0.0
    if p.hardening_spring_formula == QUARTIC:
        share = math.pow(abs(x) / DEFLECTION, 4.0)
    elif p.hardening_spring_formula == SINE:
        share = math.sinh(abs(x) / SCALE) / math.sinh(DEFLECTION / SCALE)
    else:
        deflection = min(abs(x), 0.95 * LIMIT)
        share = math.tan(0.5 * math.pi * deflection / LIMIT) / math.tan(0.5 * math.pi * DEFLECTION / LIMIT)
    return math.copysign(p.hardening_spring_hardness * FORCE * share, x)
