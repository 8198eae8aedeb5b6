"""The frame of the load cell rings with the force."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.linear_filters import filtered, second_order
from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

ONE_MODE, TWO_MODES, RUNG = range(3)

OVERTONE = 1.6
"""Frequency of the second mode over that of the first."""

SHARE, SHAPES = size("share", 0.3, 1.0), (shape("frequency", 60.0, 120.0), shape("damping", 0.02, 0.06))

EFFECT = TrueEffect(
    "frame_resonance",
    "Frame of the load cell rings with the force",
    (
        development("one_mode", "a share of the force passes through a mode (Den Hartog 1934)", SHARE, *SHAPES),
        development("two_modes", "through two modes", SHARE, *SHAPES),
        evaluation("rung", "changes of the force ring a mode that carries none of it (Ewins 1984)", SHARE, *SHAPES),
    ),
    in_catalogue=False,
)


def ringing_force(p: PlantValues, force: Array, step: float) -> Array:
    """Return the force when a ringing frame carries a share of it; a steady force passes unchanged."""
    share, frequency, damping = p.frame_resonance_share, p.frame_resonance_frequency, p.frame_resonance_damping
    if share == 0.0:
        return force
    if p.frame_resonance_formula == RUNG:
        w = 2 * np.pi * frequency
        return force + share * filtered([2 * damping * w, 0.0], [1.0, 2 * damping * w, w * w], force, step)
    carried = second_order(frequency, damping, force, step)
    if p.frame_resonance_formula == TWO_MODES:
        carried = 0.5 * (carried + second_order(OVERTONE * frequency, damping, force, step))
    return np.asarray(force + share * (carried - force))
