"""The rod rides over a wavy guide."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

WAVE, TWO_WAVES, RIDGES = range(3)

GOLDEN = 1.618
"""Length of one wave over that of the other."""

SHARPNESS = 3.0
"""How narrow a ridge is: it falls by half over 0.08 of its distance from the next."""

PARAMETERS = (size("amplitude", 12.0, 60.0), shape("length", 2.5e-3, 8e-3), shape("phase", -3.1, 3.1))

EFFECT = TrueEffect(
    "guide_waviness",
    "Rod rides over a wavy guide",
    (
        development("wave", "a wave (Whitehouse 1994)", *PARAMETERS),
        development("two_waves", "two waves of unlike length (Whitehouse 1994)", *PARAMETERS),
        evaluation("ridges", "ridges at even distances (von Mises 1918)", *PARAMETERS),
    ),
    in_catalogue=False,
)


@njit(cache=True, nogil=True)
def waviness_force(p: PlantValues, x: float) -> float:
    """Return the force (N) with which the guide pushes at a position."""
    amplitude = p.guide_waviness_amplitude
    if amplitude == 0.0:
        return 0.0
    angle = 2.0 * math.pi * x / p.guide_waviness_length
    if p.guide_waviness_formula == TWO_WAVES:
        return (
            0.7 * amplitude * (math.sin(angle + p.guide_waviness_phase) + math.sin(GOLDEN * angle - p.guide_waviness_phase))
        )
    if p.guide_waviness_formula == RIDGES:
        return 2.0 * amplitude * math.exp(SHARPNESS * (math.cos(angle + p.guide_waviness_phase) - 1.0))
    return amplitude * math.sin(angle + p.guide_waviness_phase)
