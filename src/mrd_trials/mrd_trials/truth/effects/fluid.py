"""Fluid: what changes the force of the piston in its fluid, and of the gas behind it."""

import math

from numba import njit

from mrd_trials.truth.effects.declare import TrueEffect, Values, size, within

POLYTROPIC = 1.2
"""Exponent of the gas: between isothermal and adiabatic."""

EVEN = 30.0
"""N, of force over which an asymmetry of the two directions turns."""

OPENING, CLOSING = 3000.0, 300.0
"""N s/m, what resists a void that opens beyond the cap, and that closes."""

SOFT = 0.1
"""Share of the cap over which a void begins to open."""

EFFECTS = (
    TrueEffect(
        "gas_spring",
        "Gas of finite volume",
        (size("stiffness", 2000.0, 6000.0), within("curvature", 5.0, 25.0, logarithmic=True)),
    ),
    TrueEffect("cavitation", "Void behind the piston in compression", (size("inverse_cap", 0.0015, 0.005),), in_series=True),
    TrueEffect("flow_asymmetry", "Extension and compression differ", (size("asymmetry", 0.1, 0.3, signed=True),)),
    TrueEffect(
        "shear_thinning",
        "Viscosity falls with shear",
        (size("thinning", 0.3, 0.7), within("critical_speed", 0.01, 0.04, logarithmic=True)),
    ),
    TrueEffect(
        "rate_dependent_hysteresis",
        "A viscous branch that relaxes",
        (size("viscous", 1000.0, 3000.0), within("growth", 1.0, 3.0), within("relaxation", 0.006, 0.04, logarithmic=True)),
        ("relaxation",),
    ),
    TrueEffect(
        "thermal_fade",
        "Force fades with the heat",
        (size("fade", 6e-5, 2e-4), within("cooling_time", 150.0, 1200.0, logarithmic=True)),
        ("fade",),
    ),
    TrueEffect(
        "settling",
        "Sediment stiffens the first travel",
        (size("excess", 0.15, 0.4), within("travel", 0.1, 0.8, logarithmic=True)),
    ),
)


@njit(cache=True, nogil=True)
def gas(p: Values, x: float) -> float:
    """N beyond that at mid-stroke, of a polytrope with the slope and the relative loss of slope that are given there."""
    if p.gas_spring_stiffness == 0.0:
        return 0.0
    length = (POLYTROPIC + 1.0) / p.gas_spring_curvature
    room = max(1.0 + x / length, 0.05)
    return p.gas_spring_stiffness * length / POLYTROPIC * (1.0 - math.pow(room, -POLYTROPIC))


@njit(cache=True, nogil=True)
def thinned(p: Values, v: float) -> float:
    """Viscosity over that at rest; Carreau's law."""
    if p.shear_thinning_thinning == 0.0:
        return 1.0
    return math.pow(1.0 + (v / p.shear_thinning_critical_speed) ** 2, -0.5 * p.shear_thinning_thinning)


@njit(cache=True, nogil=True)
def stretched(p: Values, e: float, dx: float, step: float) -> float:
    """Stretch of the relaxing branch's spring after a motion at constant speed; exact."""
    if p.rate_dependent_hysteresis_viscous == 0.0:
        return 0.0
    relaxation = p.rate_dependent_hysteresis_relaxation
    steady = dx / step * relaxation
    return steady + (e - steady) * math.exp(-step / relaxation)


@njit(cache=True, nogil=True)
def branch(p: Values, e: float, current: float) -> float:
    """N, of the relaxing branch; its spring is as stiff as the field makes it."""
    if p.rate_dependent_hysteresis_viscous == 0.0:
        return 0.0
    viscous = p.rate_dependent_hysteresis_viscous * (1.0 + p.rate_dependent_hysteresis_growth * current)
    return viscous * e / p.rate_dependent_hysteresis_relaxation


@njit(cache=True, nogil=True)
def uneven(p: Values, force: float) -> float:
    """The fluid's force with its two directions apart."""
    if p.flow_asymmetry_asymmetry == 0.0:
        return force
    return force * (1.0 + p.flow_asymmetry_asymmetry * force / math.sqrt(force * force + EVEN * EVEN))


@njit(cache=True, nogil=True)
def void(p: Values, n: float, force: float, step: float) -> float:
    """Void (m, at most 0) after a step: the gas holds compression at its cap, what is more draws the column apart."""
    if p.cavitation_inverse_cap == 0.0:
        return 0.0
    soft = SOFT / p.cavitation_inverse_cap
    over = max((-force - 1.0 / p.cavitation_inverse_cap) / soft, 0.0)
    n -= step / OPENING * soft * over * over / (1.0 + over)  # nothing below the cap: a leak would add up
    return min(n + step / CLOSING * max(force, 0.0), 0.0)


@njit(cache=True, nogil=True)
def weakened(p: Values, heat: float, travelled: float) -> float:
    """Force of the fluid over that of a cold damper that has been shaken; sediment breaks up by kinetics of second order."""
    factor = math.exp(-p.thermal_fade_fade * heat)
    if p.settling_excess > 0.0:
        factor *= 1.0 + p.settling_excess / (1.0 + 0.5 * travelled / p.settling_travel) ** 2
    return factor
