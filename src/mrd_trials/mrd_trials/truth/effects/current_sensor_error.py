"""Offset and gain of the current reading."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

BENT, REMANENT, END_POINT = range(3)

LOOP = 0.1
"""Change of current in A over which the remanence of the sensor's core turns."""

REMANENCE = 0.5
"""Remanent offset over the constant one."""

GAIN, OFFSET = size("gain", 0.03, 0.1, signed=True), size("offset", 0.03, 0.1, signed=True)

EFFECT = TrueEffect(
    "current_sensor_error",
    "Offset and gain of the current reading",
    (
        development(
            "bent", "Hall element whose gain changes with the field (Popovic 2004)", OFFSET, GAIN, shape("bend", 0.3, 1.0)
        ),
        development("remanent", "core that keeps a part of its offset (Ripka 2001)", OFFSET, GAIN),
        evaluation(
            "end_point",
            "calibrated at the end of its range: the gain error fades with the current",
            OFFSET,
            GAIN,
            shape("fading", 0.15, 0.5),
        ),
    ),
)


def current_reading(p: PlantValues, current: Array) -> Array:
    """Return what the sensor shows of the current that flows."""
    gain, offset = p.current_sensor_error_gain, p.current_sensor_error_offset
    if p.current_sensor_error_formula == REMANENT:
        return np.asarray((1.0 + gain) * current + offset * (1.0 + REMANENCE * _remanence(current)))
    if p.current_sensor_error_formula == END_POINT:
        fading = p.current_sensor_error_fading or 1.0
        return np.asarray(offset + current * (1.0 + gain * np.exp(-np.abs(current) / fading)))
    bend = p.current_sensor_error_bend or 1.0
    return np.asarray(offset + current * (1.0 + gain * (1.0 + np.abs(current) / bend)))


@njit(cache=True, nogil=True)
def _remanence(current: Array) -> Array:
    """Return the magnetisation (-1 to 1) of a core, which turns as the current changes; it begins demagnetised."""
    remanence = np.zeros_like(current)
    for i in range(1, len(current)):
        change = current[i] - current[i - 1]
        side = 1.0 if change > 0.0 else -1.0
        remanence[i] = side + (remanence[i - 1] - side) * np.exp(-abs(change) / LOOP)
    return remanence
