"""Lag of the force channel."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.linear_filters import filtered, lagged
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

TWO_STAGES, CREEPING_TAIL, BESSEL = range(3)

FIRST_STAGE = 0.75
"""Time constant of the slower stage over the sum of both."""

TAIL = 6.0
"""Time constant of the creeping part over that of the rest."""

LAG = size("lag", 5e-3, 30e-3)

EFFECT = TrueEffect(
    "force_sensor_lag",
    "Lag of the force channel",
    (
        development("two_stages", "amplifier and filter, one after the other (Butterworth 1930)", LAG),
        development(
            "creeping_tail",
            "a part of the gauge's signal creeps through its glue (Hoffmann 1989)",
            LAG,
            shape("tail_share", 0.06, 0.15),
        ),
        evaluation("bessel", "filter of second order with a flat group delay (Thomson 1949)", LAG),
    ),
)


def lagged_force(p: PlantValues, force: Array, step: float) -> Array:
    """Return the force behind the lag of sensor and amplifier."""
    lag = p.force_sensor_lag_lag
    if lag == 0.0:
        return force
    if p.force_sensor_lag_formula == CREEPING_TAIL:
        share = p.force_sensor_lag_tail_share
        return (1.0 - share) * lagged(lag, force, step) + share * lagged(TAIL * lag, force, step)
    if p.force_sensor_lag_formula == BESSEL:
        return filtered([3.0 / lag**2], [1.0, 3.0 / lag, 3.0 / lag**2], force, step)
    return lagged((1.0 - FIRST_STAGE) * lag, lagged(FIRST_STAGE * lag, force, step), step)
