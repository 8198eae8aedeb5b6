"""Gas of finite volume behind the piston."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

ISOTHERMAL, BLADDER, THERMAL_LAG = range(3)

LEAST_VOLUME = 0.05
"""Smallest relative volume, which no stroke reaches."""

ADIABATIC_EXCESS = 0.4
"""Adiabatic over isothermal stiffness of nitrogen, less 1."""

STIFFNESS, CURVATURE = size("stiffness", 2000.0, 6000.0), shape("curvature", 5.0, 25.0, logarithmic=True)

EFFECT = TrueEffect(
    "gas_spring",
    "Gas of finite volume",
    (
        development("isothermal", "Boyle (1662)", STIFFNESS, CURVATURE),
        development("bladder", "neo-Hookean rubber of the bladder (Treloar 1975)", STIFFNESS, CURVATURE),
        evaluation(
            "thermal_lag",
            "gas that loses the heat of compression in time (Pourmovahed & Otis 1990)",
            STIFFNESS,
            CURVATURE,
            shape("heat_loss_time", 2.0, 12.0, logarithmic=True),
        ),
    ),
)


@njit(cache=True, nogil=True)
def gas_force(p: PlantValues, x: float) -> float:
    """Return the force (N) of the gas at rest, beyond that at mid-stroke, where stiffness and curvature are given."""
    if p.gas_spring_stiffness == 0.0:
        return 0.0
    length = 2.0 / p.gas_spring_curvature
    stretch = max(1.0 + x / length, LEAST_VOLUME)
    if p.gas_spring_formula == BLADDER:
        return p.gas_spring_stiffness * length / 3.0 * (stretch - 1.0 / (stretch * stretch))
    return p.gas_spring_stiffness * length * (1.0 - 1.0 / stretch)


@njit(cache=True, nogil=True)
def heated_force(p: PlantValues, excess: float, before: float, after: float, step: float) -> float:
    """Return what the heat of compression adds to the force (N) after a step from one position to another."""
    if p.gas_spring_stiffness == 0.0 or p.gas_spring_formula != THERMAL_LAG:
        return 0.0
    fresh = ADIABATIC_EXCESS * (gas_force(p, after) - gas_force(p, before))
    return float((excess + fresh) * math.exp(-step / p.gas_spring_heat_loss_time))
