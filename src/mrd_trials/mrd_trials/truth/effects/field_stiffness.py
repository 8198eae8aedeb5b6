"""The current makes the fluid elastic."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

LINEAR, YIELDING, SQUARE = range(3)

CURRENT = 0.3
"""Current in A at which a stiffness that grows with its square is that of the linear formula."""

STIFFNESS = size("stiffness", 4000.0, 24e3)

EFFECT = TrueEffect(
    "field_stiffness",
    "Current makes the fluid elastic",
    (
        development("linear", "in proportion to current and position (Li, Yao, Chen, Yeo & Yap 2000)", STIFFNESS),
        development("yielding", "levels off away from mid-stroke", STIFFNESS, shape("length", 8e-3, 16e-3)),
        evaluation("square", "with the square of the current (Jolly, Carlson & Muñoz 1996)", STIFFNESS),
    ),
    in_catalogue=False,
)


@njit(cache=True, nogil=True)
def elastic_force(p: PlantValues, x: float, current: float) -> float:
    """Return the elastic force (N) of the fluid."""
    stiffness = p.field_stiffness_stiffness * current
    if stiffness == 0.0:
        return 0.0
    if p.field_stiffness_formula == YIELDING:
        return stiffness * p.field_stiffness_length * math.tanh(x / p.field_stiffness_length)
    if p.field_stiffness_formula == SQUARE:
        return stiffness * current / CURRENT * x
    return stiffness * x
