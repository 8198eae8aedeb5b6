"""Hum on the force channel."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

RECTIFIER, LOADED, GRID = range(3)

MAINS = 50.0
"""Mains frequency in Hz."""

AMPLITUDE = size("amplitude", 2.0, 10.0)

EFFECT = TrueEffect(
    "mains_hum",
    "Hum on the force channel",
    (
        development(
            "rectifier",
            "with the third harmonic of a rectifier (Mohan, Undeland & Robbins 1995)",
            AMPLITUDE,
            shape("third", 0.15, 0.4),
            shared=("amplitude",),
        ),
        development(
            "loaded",
            "its amplitude swings with the load of the mains",
            AMPLITUDE,
            shape("swing", 0.2, 0.5),
            shape("period", 2.0, 6.0),
            shared=("amplitude",),
        ),
        evaluation(
            "grid",
            "its phase wanders with the frequency of the grid (Kundur 1994)",
            AMPLITUDE,
            shape("wandering", 0.3, 0.9),
            shape("period", 5.0, 12.0),
        ),
    ),
)


def hum(p: PlantValues, time: Array, phase: float) -> Array:
    """Return the hum in N at times (s) of a run that begins at a phase (turns) of the mains."""
    if p.mains_hum_amplitude == 0.0:
        return np.zeros_like(time)
    angle = 2 * np.pi * (MAINS * time + phase)
    slow = 2 * np.pi * (time / (p.mains_hum_period or 1.0) + phase)
    if p.mains_hum_formula == LOADED:
        wave = (1.0 + p.mains_hum_swing * np.sin(slow)) * np.sin(angle)
    elif p.mains_hum_formula == GRID:
        wave = np.sin(angle + p.mains_hum_wandering * np.sin(slow))
    else:
        wave = np.sin(angle) + p.mains_hum_third * np.sin(3 * angle)
    return np.asarray(p.mains_hum_amplitude * wave)
