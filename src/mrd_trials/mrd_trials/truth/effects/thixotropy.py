"""The fluid weakens as it is sheared and recovers at rest."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

FIRST_ORDER, SECOND_ORDER, RELAXING = range(3)

PARAMETERS = (
    size("weakening", 0.2, 0.6),
    shape("recovery", 0.5, 3.0, logarithmic=True),
    shape("travel", 0.02, 0.1, logarithmic=True),
)

EFFECT = TrueEffect(
    "thixotropy",
    "Fluid weakens as it is sheared and recovers at rest",
    (
        development("first_order", "shear breaks the structure in proportion to it (Moore 1959)", *PARAMETERS),
        development("second_order", "in proportion to its square (Denny & Brodkey 1962)", *PARAMETERS),
        evaluation("relaxing", "the structure relaxes to that of the present speed (Mewis & Wagner 2009)", *PARAMETERS),
    ),
    in_catalogue=False,
)


@njit(cache=True, nogil=True)
def structure_factor(p: PlantValues, structure: float) -> float:
    """Return the yield force over that of a fluid at rest."""
    return 1.0 - p.thixotropy_weakening * (1.0 - structure)


@njit(cache=True, nogil=True)
def rebuilt_structure(p: PlantValues, structure: float, dx: float, step: float) -> float:
    """Return the structure (0 to 1) of the fluid after a step: time builds it up, travel breaks it down."""
    if p.thixotropy_weakening == 0.0:
        return structure
    building, breaking = step / p.thixotropy_recovery, abs(dx) / p.thixotropy_travel
    if p.thixotropy_formula == SECOND_ORDER:
        whole = 1.0 + building
        return 2.0 * (structure + building) / (whole + math.sqrt(whole * whole + 4.0 * breaking * (structure + building)))
    if p.thixotropy_formula == RELAXING:
        end = building / (building + breaking)
        return end + (structure - end) * math.exp(-building)
    return (structure + building) / (1.0 + building + breaking)
