"""The gain of the load cell's amplifier drifts."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

STEADY, WARM_UP, SWING = range(3)

RATED = 100.0
"""Time in s after which the drift of the gain is given."""

DRIFT = size("drift", 0.03, 0.2, signed=True)

EFFECT = TrueEffect(
    "gain_drift",
    "Gain of the load cell's amplifier drifts",
    (
        development("steady", "in proportion to the time", DRIFT),
        development(
            "warm_up", "exponential approach while the amplifier warms up", DRIFT, shape("warm_up_time", 15.0, 60.0)
        ),
        evaluation(
            "swing", "the temperature of the room swings", DRIFT, shape("period", 40.0, 200.0), shape("phase", -3.1, 3.1)
        ),
    ),
    in_catalogue=False,
)


def drifting_gain(p: PlantValues, time: Array) -> Array:
    """Return the gain of the force channel at times (s) since the start of the session."""
    if p.gain_drift_formula == WARM_UP:
        drifted = -np.expm1(-time / (p.gain_drift_warm_up_time or 1.0))
    elif p.gain_drift_formula == SWING:
        drifted = np.sin(2 * np.pi * time / (p.gain_drift_period or 1.0) + p.gain_drift_phase)
    else:
        drifted = np.minimum(time / RATED, 3.0)
    return np.asarray(1.0 + p.gain_drift_drift * drifted)
