"""Effects of the coil: from the current that flows to the current that acts on the fluid and to the one that is read."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, shape, size

Array = NDArray[np.float64]

KNEE = 1.5
"""Sharpness of the saturation, between an exponential approach (about 1.2) and a root of squares (2)."""

REVERSAL = 2.0
"""Change of current over which a magnetisation loop is crossed, in half widths; below 2, the loop would bulge backwards."""

EFFECTS = (
    TrueEffect(
        "current_sensor_error",
        "Offset and gain of the current reading",
        (size("offset", 0.03, 0.1, signed=True), size("gain", 0.03, 0.1, signed=True)),
    ),
    TrueEffect("magnetic_hysteresis", "Iron remembers the current", (size("half_width", 0.04, 0.12),)),
    TrueEffect("current_saturation", "Iron saturates", (size("inverse_current", 0.8, 2.0),)),
    TrueEffect(
        "coil_lag",
        "Flux follows the current late, and falls later still",
        (size("lag", 0.015, 0.06), shape("falling", 0.1, 0.6)),
    ),
)


@njit(cache=True, nogil=True)
def acting_current(p: PlantValues, current: Array, step: float, memory: Array) -> Array:
    """Return the current that acts on the fluid, from the current that flows.

    Flux diffusion with two time constants comes first, then a magnetisation that relaxes towards the side of the change as
    the current changes (a Duhem form, as Coleman and Hodgdon's), then the magnetisation curve of the iron.

    Parameters
    ----------
    p : PlantValues
    current : ndarray (samples,)
    step : float
        Sampling period in s.
    memory : ndarray (3,)
        Lagged current, magnetisation (-1 to 1) and whether both are set; updated in place.
    """
    acting = np.empty_like(current)
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2] = current[0], 0.0, 1.0
    rising, falling = 0.0, 0.0
    if p.coil_lag_lag > 0.0:
        rising, falling = np.exp(-step / p.coil_lag_lag), np.exp(-step / (p.coil_lag_lag * (1.0 + p.coil_lag_falling)))
    width, bend = p.magnetic_hysteresis_half_width, p.current_saturation_inverse_current
    for i in range(len(current)):
        before = memory[0]
        keep = rising if abs(current[i]) >= abs(before) else falling
        towards = 0.5 * (current[max(i - 1, 0)] + current[i])
        now = towards + keep * (before - towards) if keep > 0.0 else current[i]
        memory[0] = now
        if width > 0.0:
            change = now - before
            side = 1.0 if change > 0.0 else -1.0
            memory[1] = side + (memory[1] - side) * np.exp(-abs(change) / (REVERSAL * width))
            now = max(now - width * memory[1], 0.0)
        if bend > 0.0:
            now = now / (1.0 + (bend * abs(now)) ** KNEE) ** (1.0 / KNEE)
        acting[i] = now
    return acting
