"""Effects that change the force of the piston in its fluid, and that of the gas behind it."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, shape, size

POLYTROPIC = 1.2
"""Polytropic exponent of the gas, between isothermal (1) and adiabatic (1.4)."""

TURNING_FORCE = 30.0
"""Force in N over which the asymmetry of the two directions changes its sign."""

OPENING, CLOSING = 3000.0, 300.0
"""Viscous resistance in N s/m against the opening of a void beyond the cap, and against its closing."""

ONSET = 0.1
"""Share of the cap over which a void begins to open."""

EFFECTS = (
    TrueEffect(
        "gas_spring",
        "Gas of finite volume",
        (size("stiffness", 2000.0, 6000.0), shape("curvature", 5.0, 25.0, logarithmic=True)),
    ),
    TrueEffect("cavitation", "Void behind the piston in compression", (size("inverse_cap", 0.0015, 0.005),), in_series=True),
    TrueEffect("flow_asymmetry", "Extension and compression differ", (size("asymmetry", 0.1, 0.3, signed=True),)),
    TrueEffect(
        "shear_thinning",
        "Viscosity falls with shear",
        (size("thinning", 0.3, 0.7), shape("critical_speed", 0.01, 0.04, logarithmic=True)),
    ),
    TrueEffect(
        "rate_dependent_hysteresis",
        "A viscous branch that relaxes",
        (size("viscous", 1000.0, 3000.0), shape("growth", 1.0, 3.0), shape("relaxation", 0.006, 0.04, logarithmic=True)),
        ("relaxation",),
    ),
    TrueEffect(
        "thermal_fade",
        "Force fades with the heat",
        (size("fade", 6e-5, 2e-4), shape("cooling_time", 150.0, 1200.0, logarithmic=True)),
        ("fade",),
    ),
    TrueEffect(
        "settling",
        "Sediment stiffens the first travel",
        (size("excess", 0.15, 0.4), shape("travel", 0.1, 0.8, logarithmic=True)),
    ),
)


@njit(cache=True, nogil=True)
def gas_force(p: PlantValues, x: float) -> float:
    """Return the force (N) of the gas, a polytrope, beyond that at mid-stroke, where stiffness and curvature are given."""
    if p.gas_spring_stiffness == 0.0:
        return 0.0
    length = (POLYTROPIC + 1.0) / p.gas_spring_curvature
    volume = max(1.0 + x / length, 0.05)
    return p.gas_spring_stiffness * length / POLYTROPIC * (1.0 - math.pow(volume, -POLYTROPIC))


@njit(cache=True, nogil=True)
def thinning_factor(p: PlantValues, v: float) -> float:
    """Return the viscosity over that at rest by Carreau's law."""
    if p.shear_thinning_thinning == 0.0:
        return 1.0
    return math.pow(1.0 + (v / p.shear_thinning_critical_speed) ** 2, -0.5 * p.shear_thinning_thinning)


@njit(cache=True, nogil=True)
def branch_elongation(p: PlantValues, e: float, dx: float, step: float) -> float:
    """Return the elongation of the relaxing branch's spring after a motion at constant speed, exactly."""
    if p.rate_dependent_hysteresis_viscous == 0.0:
        return 0.0
    relaxation = p.rate_dependent_hysteresis_relaxation
    steady = dx / step * relaxation
    return steady + (e - steady) * math.exp(-step / relaxation)


@njit(cache=True, nogil=True)
def branch_force(p: PlantValues, e: float, current: float) -> float:
    """Return the force (N) of the relaxing branch, whose spring stiffens with the current."""
    if p.rate_dependent_hysteresis_viscous == 0.0:
        return 0.0
    viscous = p.rate_dependent_hysteresis_viscous * (1.0 + p.rate_dependent_hysteresis_growth * current)
    return viscous * e / p.rate_dependent_hysteresis_relaxation


@njit(cache=True, nogil=True)
def asymmetric_force(p: PlantValues, force: float) -> float:
    """Return the fluid's force with a different size in each direction."""
    if p.flow_asymmetry_asymmetry == 0.0:
        return force
    return force * (1.0 + p.flow_asymmetry_asymmetry * force / math.sqrt(force * force + TURNING_FORCE * TURNING_FORCE))


@njit(cache=True, nogil=True)
def void_after_step(p: PlantValues, void: float, force: float, step: float) -> float:
    """Return the void (m, at most 0) after a step: the gas carries compression up to its cap, and more opens the void."""
    if p.cavitation_inverse_cap == 0.0:
        return 0.0
    onset = ONSET / p.cavitation_inverse_cap
    over = max((-force - 1.0 / p.cavitation_inverse_cap) / onset, 0.0)
    void -= step / OPENING * onset * over * over / (1.0 + over)  # exactly 0 below the cap: a leak would add up
    return min(void + step / CLOSING * max(force, 0.0), 0.0)


@njit(cache=True, nogil=True)
def fluid_strength(p: PlantValues, heat: float, travelled: float) -> float:
    """Return the fluid's force over that of a cold, shaken damper; sediment breaks up by kinetics of second order."""
    factor = math.exp(-p.thermal_fade_fade * heat)
    if p.settling_excess > 0.0:
        factor *= 1.0 + p.settling_excess / (1.0 + 0.5 * travelled / p.settling_travel) ** 2
    return factor
