"""The current ripples faster than its sensor shows."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

SINE, TWO_POINT, SAWTOOTH = range(3)

EDGE, SKEWNESS = 3.0, 0.9
"""Steepness of the edges of a two-point controller, and how much of a sawtooth it is (0 to 1)."""

SHARE, FREQUENCY = size("share", 0.03, 0.2), shape("frequency", 12.0, 38.0)

EFFECT = TrueEffect(
    "supply_ripple",
    "Current ripples faster than its sensor shows",
    (
        development("sine", "filtered ripple (Mohan, Undeland & Robbins 1995)", SHARE, FREQUENCY),
        development("two_point", "a two-point controller (Tsypkin 1984)", SHARE, FREQUENCY),
        evaluation(
            "sawtooth", "an inductor that charges slowly and empties fast (Erickson & Maksimović 2001)", SHARE, FREQUENCY
        ),
    ),
    in_catalogue=False,
)


def rippling_current(p: PlantValues, current: Array, step: float, phase: float) -> Array:
    """Return the current of a run with its ripple, which begins at a phase (turns)."""
    if p.supply_ripple_share == 0.0:
        return current
    angle = 2 * np.pi * (p.supply_ripple_frequency * step * np.arange(len(current)) + phase)
    wave = np.sin(angle)
    if p.supply_ripple_formula == TWO_POINT:
        wave = np.tanh(EDGE * wave) / np.tanh(EDGE)
    elif p.supply_ripple_formula == SAWTOOTH:
        wave = np.arctan2(SKEWNESS * wave, 1.0 + SKEWNESS * np.cos(angle)) / np.arcsin(SKEWNESS)
    return np.asarray(current * (1.0 + p.supply_ripple_share * wave))
