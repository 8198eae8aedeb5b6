"""Offset and gain of the current reading."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

BENT, WARM_UP, END_POINT = range(3)

COLD_SHARE = 0.5
"""Offset of a cold sensor over that of a warm one."""

GAIN, OFFSET = size("gain", 0.03, 0.1, signed=True), size("offset", 0.03, 0.1, signed=True)

EFFECT = TrueEffect(
    "current_sensor_error",
    "Offset and gain of the current reading",
    (
        development(
            "bent", "Hall element whose gain changes with the field (Popovic 2004)", OFFSET, GAIN, shape("bend", 0.3, 1.0)
        ),
        development(
            "warm_up",
            "Hall element whose offset grows as it warms up (Popovic 2004)",
            OFFSET,
            GAIN,
            shape("warm_up_time", 30.0, 120.0),
        ),
        evaluation(
            "end_point",
            "calibrated at the end of its range: the gain error fades with the current (Ripka 2001)",
            OFFSET,
            GAIN,
            shape("fading", 0.15, 0.5),
        ),
    ),
)


def current_reading(p: PlantValues, time: Array, current: Array) -> Array:
    """Return what the sensor shows of the current that flows, at times (s) since the start of the session."""
    gain, offset = p.current_sensor_error_gain, p.current_sensor_error_offset
    if p.current_sensor_error_formula == WARM_UP:
        warm = 1.0 - (1.0 - COLD_SHARE) * np.exp(-time / p.current_sensor_error_warm_up_time)
        return np.asarray((1.0 + gain) * current + offset * warm)
    if p.current_sensor_error_formula == END_POINT:
        return np.asarray(offset + current * (1.0 + gain * np.exp(-np.abs(current) / p.current_sensor_error_fading)))
    bend = p.current_sensor_error_bend or 1.0
    return np.asarray(offset + current * (1.0 + gain * (1.0 + np.abs(current) / bend)))
