"""The core of the position transducer sticks to its housing."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

Array = NDArray[np.float64]

PLAY, BRISTLES, STICK_SLIP = range(3)

SLACK = size("slack", 5e-5, 4e-4)

EFFECT = TrueEffect(
    "sensor_stiction",
    "Core of the position transducer sticks to its housing",
    (
        development("play", "moves once its slack is taken up (Krasnosel'skii & Pokrovskii 1989)", SLACK),
        development("bristles", "follows ever better over its slack (Dahl 1968)", SLACK),
        evaluation("stick_slip", "sticks until it jumps (Bowden & Leben 1939)", SLACK),
    ),
    in_catalogue=False,
)


def sticking_reading(p: PlantValues, position: Array) -> Array:
    """Return the reading of a transducer whose core sticks."""
    return (
        position if p.sensor_stiction_slack == 0.0 else _core(p.sensor_stiction_formula, p.sensor_stiction_slack, position)
    )


@njit(cache=True, nogil=True)
def _core(formula: float, slack: float, position: Array) -> Array:
    reading = np.empty_like(position)
    core, lag = position[0], 0.0
    for i in range(len(position)):
        if formula == BRISTLES:
            dx = position[i] - position[max(i - 1, 0)]
            side = 1.0 if dx > 0.0 else -1.0
            lag = side + (lag - side) * math.exp(-abs(dx) / slack)
            core = position[i] - 0.5 * slack * lag
        elif formula == STICK_SLIP:
            core = position[i] if abs(position[i] - core) > 0.5 * slack else core
        else:
            core = min(max(core, position[i] - 0.5 * slack), position[i] + 0.5 * slack)
        reading[i] = core
    return reading
