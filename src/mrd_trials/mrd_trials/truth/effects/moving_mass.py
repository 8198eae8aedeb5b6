"""Mass between load cell and damper."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.linear_filters import lagged, second_order
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

SOFT_MOUNT, LIQUID_COLUMN, HISTORY = range(3)

MEMORY = ((2e-3, 0.5), (8e-3, 0.3), (32e-3, 0.2))
"""Time constants in s of the boundary layer's memory, and their shares."""

MASS = size("mass", 1.5, 5.0)

EFFECT = TrueEffect(
    "moving_mass",
    "Mass between load cell and damper",
    (
        development(
            "soft_mount",
            "mass on a mount that resonates (Den Hartog 1934)",
            MASS,
            shape("frequency", 60.0, 150.0),
            shape("damping", 0.1, 0.4),
            shared=("mass",),
        ),
        development(
            "liquid_column",
            "column of fluid that grows with the extension (unsteady Bernoulli; Smith 2002)",
            MASS,
            shape("length", 0.05, 0.15),
            shared=("mass",),
        ),
        evaluation(
            "history",
            "added mass, part of which acts with a boundary layer's memory (Basset 1888)",
            MASS,
            shape("memory_share", 0.15, 0.4),
        ),
    ),
)


def inertia_force(p: PlantValues, position: Array, velocity: Array, acceleration: Array, step: float) -> Array:
    """Return the force (N) of the mass along the rod's motion."""
    mass = p.moving_mass_mass
    if mass == 0.0:
        return np.zeros_like(position)
    if p.moving_mass_formula == SOFT_MOUNT:
        return mass * second_order(p.moving_mass_frequency, p.moving_mass_damping, acceleration, step)
    if p.moving_mass_formula == HISTORY:
        share = p.moving_mass_memory_share
        late = sum(part * lagged(time, acceleration, step) for time, part in MEMORY)
        return np.asarray(mass * ((1.0 - share) * acceleration + share * late))
    length = p.moving_mass_length
    return np.asarray(mass * ((1.0 + position / length) * acceleration + 0.5 * velocity**2 / length))
