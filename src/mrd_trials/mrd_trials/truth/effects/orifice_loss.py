"""Turbulent loss in the gap."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

SQUARE, BLASIUS, TRANSITION = range(3)

REFERENCE = 0.1
"""Speed in m/s at which the loss of a smooth gap is that of an orifice."""

LOSS = size("loss", 2500.0, 15e3)

EFFECT = TrueEffect(
    "orifice_loss",
    "Turbulent loss in the gap",
    (
        development("square", "with the square of the speed (Bernoulli)", LOSS),
        development("blasius", "with the power 1.75 of the speed (Blasius 1913)", LOSS),
        evaluation("transition", "turbulent only beyond a speed (Reynolds 1883)", LOSS, shape("critical_speed", 0.02, 0.05)),
    ),
    in_catalogue=False,
)


@njit(cache=True, nogil=True)
def turbulent_force(p: PlantValues, v: float) -> float:
    """Return the loss (N) at a speed."""
    loss = p.orifice_loss_loss
    if loss == 0.0:
        return 0.0
    if p.orifice_loss_formula == BLASIUS:
        return loss * math.pow(REFERENCE, 0.25) * math.copysign(math.pow(abs(v), 1.75), v)
    if p.orifice_loss_formula == TRANSITION:
        beyond = max(abs(v) - p.orifice_loss_critical_speed, 0.0)
        return loss * math.copysign(2.0 * beyond * beyond, v)
    return loss * abs(v) * v
