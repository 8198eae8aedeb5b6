"""Gain and curve of the position transducer."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

Array = NDArray[np.float64]

QUINTIC, ROUNDED, SQUARE = range(3)

RATED = 0.025
"""Position in m at which the curve of the transducer is given."""

FIFTH = 0.2
"""Share of a transducer's curve that grows with the fifth power of its reading; the rest grows with the third."""

CURVE, GAIN = size("curve", 0.02, 0.05, signed=True), size("gain", 0.02, 0.1, signed=True)

EFFECT = TrueEffect(
    "lvdt_nonlinearity",
    "Gain and curve of the position transducer",
    (
        development("quintic", "third and fifth power of the reading (Herceg 1976)", CURVE, GAIN),
        development("rounded", "curve that levels off at the end of the coils, a squared sine (Herceg 1976)", CURVE, GAIN),
        evaluation(
            "square", "square of the reading on each side, as of two unlike secondary coils (Nyce 2016)", CURVE, GAIN
        ),
    ),
)


def transducer_reading(p: PlantValues, position: Array) -> Array:
    """Return the reading of a transducer at a position; its error grows with the reading."""
    reading = position.copy()
    for _ in range(30):  # the iteration contracts: the error is below a fifth of the reading
        reading = position / (1.0 + p.lvdt_nonlinearity_gain + p.lvdt_nonlinearity_curve * _curve(p, reading / RATED))
    return reading


def _curve(p: PlantValues, share: Array) -> Array:
    """Return the relative error of a reading, given over the rated one, over that at the rated one."""
    if p.lvdt_nonlinearity_formula == ROUNDED:
        return np.asarray(np.sin(0.5 * np.pi * share) ** 2)
    if p.lvdt_nonlinearity_formula == SQUARE:
        return np.abs(share)
    return np.asarray(share**2 * (1.0 - FIFTH + FIFTH * share**2))
