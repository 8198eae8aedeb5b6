"""Force fades with the heat that the damper has dissipated."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

FLUIDITY, TWO_NODES, MIXING = range(3)

SMALL_CAPACITY = 3.0
"""Heat capacity of the damper's body over that of its fluid."""

FADE, COOLING = size("fade", 6e-5, 2e-4), shape("cooling_time", 150.0, 1200.0, logarithmic=True)

EFFECT = TrueEffect(
    "thermal_fade",
    "Force fades with the heat",
    (
        development("fluidity", "fluidity grows with the temperature (Batschinski 1913)", FADE, COOLING),
        development(
            "two_nodes",
            "the fluid is hotter than its body (Gordaninejad & Breese 1999)",
            FADE,
            COOLING,
            shape("passing_time", 10.0, 40.0),
        ),
        evaluation(
            "mixing",
            "viscosity falls exponentially with a heat that has to mix first (Reynolds 1886, Danckwerts 1952)",
            FADE,
            COOLING,
            shape("passing_time", 15.0, 60.0),
        ),
    ),
)


@njit(cache=True, nogil=True)
def thermal_factor(p: PlantValues, heat: float, in_fluid: float) -> float:
    """Return the fluid's force over that of a cold damper, from the heat (J) of its body and what has not reached it."""
    exponent = p.thermal_fade_fade * heat
    if exponent == 0.0 and in_fluid == 0.0:
        return 1.0
    if p.thermal_fade_formula == TWO_NODES:
        return math.exp(-exponent - p.thermal_fade_fade * SMALL_CAPACITY * in_fluid)
    if p.thermal_fade_formula == MIXING:
        return math.exp(-exponent)
    return 1.0 / (1.0 + exponent)


@njit(cache=True, nogil=True)
def store_heat(p: PlantValues, heat: NDArray[np.float64], work: float, step: float) -> None:
    """Add the work (J) of a step to the heat (2,) of body and fluid, in place, and let both cool."""
    if p.thermal_fade_fade == 0.0:
        return
    passed = work
    if p.thermal_fade_formula != FLUIDITY:
        keep = math.exp(-step / p.thermal_fade_passing_time)
        passed = (1.0 - keep) * (heat[1] + work)
        heat[1] = max(keep * (heat[1] + work), 0.0)
    heat[0] = max(heat[0] * math.exp(-step / p.thermal_fade_cooling_time) + passed, 0.0)
