"""Periodic error of the drive's teeth: what the rod does besides what its encoder shows."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

HARMONICS, TRIANGLE, TWO_PITCHES = range(3)

TOOTH = 2e-3 * np.pi
"""Pitch in m of a rack of module 2 mm."""

SECOND = 0.2
"""Second harmonic of a tooth's error over its first harmonic."""

ROUNDING = 0.95
"""How sharp the corners of the triangle are: 1 would leave them sharp."""

MOTOR_TURNS = 1.25
"""Turns of the motor in a pitch: 40 turns move the rack by one turn of its pinion, 201.06 mm."""

AMPLITUDE = size("amplitude", 15e-6, 60e-6)
PHASE = shape("phase", -3.1, 3.1)

EFFECT = TrueEffect(
    "servo_ripple",
    "Periodic error of the drive's teeth",
    (
        development("harmonics", "pitch error with a second harmonic (Smith 1999)", AMPLITUDE, PHASE, shared=("amplitude",)),
        development("triangle", "rounded triangle over a pitch, as of a wrong profile (Smith 1999)", AMPLITUDE, PHASE),
        evaluation(
            "two_pitches",
            "tooth and turn of the motor beat with each other (Smith 1999)",
            AMPLITUDE,
            PHASE,
            shape("motor_share", 0.3, 0.8),
            shape("motor_phase", -3.1, 3.1),
            shared=("amplitude",),
        ),
    ),
)


def rippled_motion(p: PlantValues, position: Array, velocity: Array, acceleration: Array) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of the rod from those that the encoder shows."""
    error, slope, bend = tooth_error(p, position)
    return position + error, velocity * (1 + slope), acceleration * (1 + slope) + bend * velocity**2


def tooth_error(p: PlantValues, position: Array) -> tuple[Array, Array, Array]:
    """Return the error in m at positions, and its first and second derivative over the position."""
    turn = 2 * np.pi / TOOTH
    angle = turn * position + p.servo_ripple_phase
    sine, cosine = np.sin(angle), np.cos(angle)
    if p.servo_ripple_formula == TRIANGLE:
        flat = 1.0 - (ROUNDING * sine) ** 2
        wave, wave_slope = np.arcsin(ROUNDING * sine), ROUNDING * cosine / np.sqrt(flat)
        wave_bend = -ROUNDING * sine * (1.0 - ROUNDING**2) / flat**1.5
        peak = np.arcsin(ROUNDING)
        wave, wave_slope, wave_bend = wave / peak, wave_slope / peak, wave_bend / peak
    elif p.servo_ripple_formula == TWO_PITCHES:
        slow = MOTOR_TURNS * turn * position + p.servo_ripple_motor_phase
        share = p.servo_ripple_motor_share
        wave = sine + share * np.sin(slow)
        wave_slope = cosine + share * MOTOR_TURNS * np.cos(slow)
        wave_bend = -sine - share * MOTOR_TURNS**2 * np.sin(slow)
    else:
        wave = sine + SECOND * np.sin(2 * angle)
        wave_slope = cosine + 2 * SECOND * np.cos(2 * angle)
        wave_bend = -sine - 4 * SECOND * np.sin(2 * angle)
    amplitude = p.servo_ripple_amplitude
    return amplitude * wave, amplitude * turn * wave_slope, amplitude * turn**2 * wave_bend
