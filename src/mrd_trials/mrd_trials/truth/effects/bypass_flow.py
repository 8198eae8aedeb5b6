"""Flow past the piston beside the controlled gap."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

ORIFICE, VALVE, CLEARANCE = range(3)

CONDUCTANCE = size("conductance", 2e-5, 4e-4)

EFFECT = TrueEffect(
    "bypass_flow",
    "Flow past the piston beside the controlled gap",
    (
        development(
            "orifice",
            "laminar, then as the root of the force (Merritt 1967)",
            CONDUCTANCE,
            shape("turbulent_force", 50.0, 300.0),
        ),
        development(
            "valve",
            "nothing up to a cracking force, then in proportion to the rest",
            CONDUCTANCE,
            shape("cracking_force", 20.0, 120.0),
        ),
        evaluation(
            "clearance",
            "ring gap that the pressure widens (Merritt 1967)",
            CONDUCTANCE,
            shape("widening_force", 400.0, 2000.0),
        ),
    ),
    in_series=True,
)


@njit(cache=True, nogil=True)
def leak_speed(p: PlantValues, fluid: float) -> float:
    """Return the speed (m/s) that flows past the piston under a force (N) of the fluid."""
    conductance = p.bypass_flow_conductance
    if conductance == 0.0:
        return 0.0
    if p.bypass_flow_formula == ORIFICE:
        return conductance * fluid / math.sqrt(1.0 + abs(fluid) / p.bypass_flow_turbulent_force)
    if p.bypass_flow_formula == VALVE:
        cracking = p.bypass_flow_cracking_force
        return conductance * (fluid - max(-cracking, min(cracking, fluid)))
    return conductance * fluid * (1.0 + abs(fluid) / p.bypass_flow_widening_force)
