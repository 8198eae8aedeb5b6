"""Effects of the drive: what the rod does besides what its encoder shows."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import TrueEffect, shape, size

Array = NDArray[np.float64]

TOOTH = 2e-3 * np.pi
"""Pitch in m of a rack of module 2 mm."""

SECOND = 0.2
"""Second harmonic of a tooth's error over its first harmonic."""

EFFECTS = (
    TrueEffect(
        "servo_ripple",
        "Periodic error of the drive's teeth",
        (size("amplitude", 15e-6, 60e-6), shape("phase", -3.1, 3.1)),
        ("amplitude",),
    ),
    TrueEffect(
        "backlash",
        "Free travel between drive and damper",
        (size("play", 2e-4, 6e-4), shape("drag", 5.0, 15.0)),
        ("play",),
        in_series=True,
    ),
)


def rippled_motion(
    amplitude: float, phase: float, position: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of the rod from those that the encoder shows."""
    turn = 2 * np.pi / TOOTH
    angle = turn * position + phase
    error = amplitude * (np.sin(angle) + SECOND * np.sin(2 * angle))
    slope = amplitude * turn * (np.cos(angle) + 2 * SECOND * np.cos(2 * angle))
    bend = -amplitude * turn**2 * (np.sin(angle) + 4 * SECOND * np.sin(2 * angle))
    return position + error, velocity * (1 + slope), acceleration * (1 + slope) + bend * velocity**2
