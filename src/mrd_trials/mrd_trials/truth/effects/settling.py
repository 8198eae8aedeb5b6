"""Sediment stiffens the first travel."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

STRETCHED, TWO_LAYERS, PLUG = range(3)

STRETCH = 0.6
"""Exponent of the stretched exponential: fast at first, slow later."""

STEEPNESS = 4.0
"""How suddenly a plug breaks up: 4 over the travel at which half of it has gone."""

EXCESS, TRAVEL = size("excess", 0.15, 0.4), shape("travel", 0.1, 0.8, logarithmic=True)

EFFECT = TrueEffect(
    "settling",
    "Sediment stiffens the first travel",
    (
        development("stretched", "stretched exponential of the travel (Kohlrausch 1854)", EXCESS, TRAVEL),
        development("two_layers", "a loose and a dense layer break up one after the other", EXCESS, TRAVEL),
        evaluation("plug", "a plug holds until it breaks up: logistic (Verhulst 1838)", EXCESS, TRAVEL),
    ),
)


@njit(cache=True, nogil=True)
def settling_factor(p: PlantValues, travelled: float) -> float:
    """Return the fluid's force over that of a shaken damper after a travel (m) since it stood still for long."""
    if p.settling_excess == 0.0:
        return 1.0
    over = travelled / p.settling_travel
    if p.settling_formula == TWO_LAYERS:
        left = 0.5 * math.exp(-2.5 * over) + 0.5 * math.exp(-0.4 * over)
    elif p.settling_formula == PLUG:
        left = (1.0 + math.exp(-STEEPNESS)) / (1.0 + math.exp(min(STEEPNESS * (over - 1.0), 50.0)))
    else:
        left = math.exp(-math.pow(over, STRETCH))
    return 1.0 + p.settling_excess * left
