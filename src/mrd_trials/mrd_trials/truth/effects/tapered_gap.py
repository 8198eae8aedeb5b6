"""The yield force varies along the stroke."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

TAPER, BARREL, STEP = range(3)

RATED = 0.025
"""Position in m at which the taper is given."""

STEP_LENGTH = 4e-3
"""Distance in m over which a step of the bore extends."""

SIZE = size("taper", 0.2, 0.8, signed=True)

EFFECT = TrueEffect(
    "tapered_gap",
    "Yield force varies along the stroke",
    (
        development("taper", "in proportion to the position", SIZE),
        development("barrel", "with the square of the position: a worn bore", SIZE),
        evaluation("step", "between two bores", SIZE, shape("centre", -6e-3, 6e-3)),
    ),
    in_catalogue=False,
)


@njit(cache=True, nogil=True)
def taper_factor(p: PlantValues, x: float) -> float:
    """Return the yield force over the nominal one; it is never negative."""
    if p.tapered_gap_taper == 0.0:
        return 1.0
    if p.tapered_gap_formula == BARREL:
        change = 1.5 * (x / RATED) ** 2
    elif p.tapered_gap_formula == STEP:
        change = 0.5 * math.tanh((x - p.tapered_gap_centre) / STEP_LENGTH)
    else:
        change = x / RATED
    return max(1.0 + p.tapered_gap_taper * change, 0.05)
