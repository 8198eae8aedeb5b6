"""A bubble of air in the fluid, in series with it."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

ISOTHERMAL, ADIABATIC, ENTRAINED = range(3)

VOLUME, PRESSURE = size("volume", 2e-4, 1.2e-3), shape("pressure", 100.0, 300.0, logarithmic=True)
"""The volume is divided by the piston's area (m), and the pressure is a force (N)."""

EFFECT = TrueEffect(
    "air_bubble",
    "Bubble that gives way, ever stiffer",
    (
        development("isothermal", "only compression meets it (Boyle 1662)", VOLUME, PRESSURE),
        development("adiabatic", "only compression meets it, too fast for heat to pass (Poisson 1823)", VOLUME, PRESSURE),
        evaluation("entrained", "both directions meet it (Nykänen, Esqué & Ellman 2000)", VOLUME, PRESSURE),
    ),
    in_catalogue=False,
    in_series=True,
)


@njit(cache=True, nogil=True)
def bubble_compression(p: PlantValues, force: float) -> float:
    """Return the travel (m) by which the bubble gives way to a force."""
    volume, pressure = p.air_bubble_volume, p.air_bubble_pressure
    if volume == 0.0:
        return 0.0
    if p.air_bubble_formula == ENTRAINED:
        return volume * force / (pressure + abs(force))
    if force >= 0.0:
        return 0.0
    if p.air_bubble_formula == ADIABATIC:
        return -volume * (1.0 - math.pow(pressure / (pressure - force), 1.0 / 1.4))
    return volume * force / (pressure - force)
