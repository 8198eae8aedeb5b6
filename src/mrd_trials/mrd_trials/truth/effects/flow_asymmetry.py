"""Extension and compression differ."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

BY_FORCE, BY_SPEED, BLOW_OFF = range(3)

TURNING_FORCE = 30.0
"""Force in N over which the asymmetry of the two directions changes its sign."""

ASYMMETRY = size("asymmetry", 0.1, 0.3, signed=True)

EFFECT = TrueEffect(
    "flow_asymmetry",
    "Extension and compression differ",
    (
        development("by_force", "areas of piston and annulus differ; turns with the force (Dixon 2007)", ASYMMETRY),
        development(
            "by_speed",
            "flow passages differ; turns with the speed (Lang 1977)",
            ASYMMETRY,
            shape("turning_speed", 3e-3, 15e-3),
        ),
        evaluation(
            "blow_off",
            "a valve opens beyond its cracking force in one direction (Dixon 2007)",
            ASYMMETRY,
            shape("cracking_force", 60.0, 250.0),
        ),
    ),
)


@njit(cache=True, nogil=True)
def asymmetric_force(p: PlantValues, force: float, v: float) -> float:
    """Return the fluid's force with a different size in each direction."""
    asymmetry = p.flow_asymmetry_asymmetry
    if asymmetry == 0.0:
        return force
    if p.flow_asymmetry_formula == BY_SPEED:
        return force * (1.0 + asymmetry * math.tanh(v / p.flow_asymmetry_turning_speed))
    if p.flow_asymmetry_formula == BLOW_OFF:
        beyond, at_rest = force - p.flow_asymmetry_cracking_force, -p.flow_asymmetry_cracking_force
        opened = 0.5 * (beyond + math.sqrt(beyond * beyond + TURNING_FORCE * TURNING_FORCE))
        closed = 0.5 * (at_rest + math.sqrt(at_rest * at_rest + TURNING_FORCE * TURNING_FORCE))
        return force + 2.0 * asymmetry * (opened - closed)
    return force * (1.0 + asymmetry * force / math.sqrt(force * force + TURNING_FORCE * TURNING_FORCE))
