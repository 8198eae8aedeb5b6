"""Other channels leak into the force."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.linear_filters import lagged
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

GHOST, VOLTAGE, RECTIFIED = range(3)

FULL_POSITION, FULL_CURRENT = 0.05, 0.3
"""Position in m at which a rectifying input leaks twice as much, and current in A at which it leaks as much, as given."""

FROM_POSITION, FROM_CURRENT = (
    size("from_position", 1000.0, 5000.0, signed=True),
    size("from_current", 20.0, 100.0, signed=True),
)

EFFECT = TrueEffect(
    "channel_crosstalk",
    "Other channels leak into the force",
    (
        development(
            "ghost",
            "charge of the channel before, which settles (Kester 2005)",
            FROM_POSITION,
            FROM_CURRENT,
            shape("settling_time", 5e-4, 3e-3),
        ),
        development(
            "voltage",
            "the coil's voltage leaks, its inductive part too (Ott 1988)",
            FROM_POSITION,
            FROM_CURRENT,
            shape("inductive_time", 2e-3, 8e-3),
        ),
        evaluation("rectified", "leak that grows with the signal (Ott 1988)", FROM_POSITION, FROM_CURRENT),
    ),
)


def leaking_force(p: PlantValues, position: Array, current: Array, step: float) -> Array:
    """Return what leaks from position and current into the force (N)."""
    from_position, from_current = p.channel_crosstalk_from_position, p.channel_crosstalk_from_current
    if p.channel_crosstalk_formula == VOLTAGE:
        voltage = current + p.channel_crosstalk_inductive_time * np.gradient(current, step)
        return np.asarray(from_position * position + from_current * voltage)
    if p.channel_crosstalk_formula == RECTIFIED:
        leak = from_position * position * (1.0 + np.abs(position) / FULL_POSITION)
        return np.asarray(leak + from_current * current * np.abs(current) / FULL_CURRENT)
    settling = p.channel_crosstalk_settling_time
    return from_position * lagged(settling, position, step) + from_current * lagged(settling, current, step)
