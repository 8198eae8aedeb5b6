"""Iron saturates."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

Array = NDArray[np.float64]

ROOT, ARCTANGENT, EXPONENTIAL, LANGEVIN = range(4)

KNEE = 1.5
"""Sharpness of the root, between an exponential approach (about 1.2) and a root of squares (2)."""

INVERSE = size("inverse_current", 0.8, 2.0)

EFFECT = TrueEffect(
    "current_saturation",
    "Iron saturates",
    (
        development("root", "root of powers with exponent 1.5, a sharper knee than that of Fröhlich (1881)", INVERSE),
        development("arctangent", "arc tangent (Trutt, Erdélyi & Hopkins 1968)", INVERSE),
        evaluation("exponential", "exponential approach (Macfadyen, Simpson, Slater & Wood 1973)", INVERSE),
        evaluation("langevin", "Langevin function of the moments (Langevin 1905)", INVERSE),
    ),
)


def saturated_current(p: PlantValues, current: Array) -> Array:
    """Return the current that would have the same effect without saturation; the slope at 0 is 1."""
    bend = p.current_saturation_inverse_current
    if bend == 0.0:
        return current
    over = np.abs(bend * current)
    if p.current_saturation_formula == ARCTANGENT:
        reached = 2 / np.pi * np.arctan(np.pi / 2 * over)
    elif p.current_saturation_formula == EXPONENTIAL:
        reached = -np.expm1(-over)
    elif p.current_saturation_formula == LANGEVIN:
        moment = np.maximum(3.0 * over, 1e-3)
        reached = np.where(over > 1e-3 / 3.0, 1.0 / np.tanh(moment) - 1.0 / moment, over)
    else:
        reached = over / (1.0 + over**KNEE) ** (1.0 / KNEE)
    return np.asarray(np.sign(current) * reached / bend)
