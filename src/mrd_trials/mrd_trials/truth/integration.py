"""Integration of a damper along a motion: one compiled function for all damper forms and effects.

Without a series element, the piston moves as the drive does. With one, the piston's speed is the root of a scalar equation
at each of a few sub-steps (backward Euler): piston, joints and springs together must move as the drive does, under the force
that this speed gives. A series element gives way more under a larger force, and the force grows with the speed, so there is
exactly one root.

Every process compiles these functions again: a cache on disk would not notice that the file of an effect has changed.
"""

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth import damper_forms
from mrd_trials.truth.effects import EFFECTS
from mrd_trials.truth.effects.air_bubble import bubble_compression
from mrd_trials.truth.effects.backlash import backlash_offset
from mrd_trials.truth.effects.bypass_flow import leak_speed
from mrd_trials.truth.effects.cavitation import void_after_step
from mrd_trials.truth.effects.end_stop import stop_force
from mrd_trials.truth.effects.field_stiffness import elastic_force
from mrd_trials.truth.effects.flow_asymmetry import asymmetric_force
from mrd_trials.truth.effects.gas_spring import gas_force, heated_force
from mrd_trials.truth.effects.guide_waviness import waviness_force
from mrd_trials.truth.effects.hardening_spring import hardening_force
from mrd_trials.truth.effects.joint_play import joint_offset
from mrd_trials.truth.effects.orifice_loss import turbulent_force
from mrd_trials.truth.effects.rate_dependent_hysteresis import BRANCHES, branch_elongation, branch_force
from mrd_trials.truth.effects.seal_friction import seal_deflection, stribeck_factor
from mrd_trials.truth.effects.series_compliance import AT_REST, series_elongation
from mrd_trials.truth.effects.settling import settling_factor
from mrd_trials.truth.effects.shear_thinning import thinning_factor
from mrd_trials.truth.effects.side_load_friction import guide_deflection, guide_friction
from mrd_trials.truth.effects.tapered_gap import taper_factor
from mrd_trials.truth.effects.thermal_fade import store_heat, thermal_factor
from mrd_trials.truth.effects.thixotropy import rebuilt_structure, structure_factor
from mrd_trials.truth.effects.true_effect import PlantValues

Array = NDArray[np.float64]

NAMES = (
    "form",
    *damper_forms.PARAMETERS,
    *(f"{effect}_formula" for effect in EFFECTS),
    *dict.fromkeys(
        f"{effect.id}_{parameter.name}"
        for effect in EFFECTS.values()
        for formula in effect.formulas
        for parameter in formula.parameters
    ),
)
VALUES = np.dtype([(name, float) for name in NAMES])
"""`PlantValues` as a record, which compiled functions get by reference: a tuple of as many numbers compiles slowly."""

SUBSTEP = 1 / 32000
"""Longest sub-step in s with a series element."""

TOLERANCE = 3e-11
"""Tolerance in m of the equation for series elements: well below a millinewton against the stiffest fluid."""

HEAT, FLUID_HEAT, TRAVELLED, STRUCTURE = range(4)
"""Places in the slow state: heat above ambient in J of body and fluid, travel in m since the fluid settled, its structure (0
to 1)."""

HYSTERESIS, CREEP, SEAL, SEAL_LEVEL, GUIDE, GAS_HEAT, DASHPOT, VOID, MOUNT, DRIVE, JOINT, PISTON, ROD, BRANCH = range(14)
"""Places in the fast state: hysteretic state and creep of the form, bristles of the seal and the level they tend to,
bristles of the guide, force in N of the gas's heat; then in m: dashpot in series, void, spring in series, joints of drive
and damper, piston, rod, and elongation of each relaxing branch."""


def rested_state() -> Array:
    """Return the slow state of a cold damper that has stood still for long."""
    return np.array([0.0, 0.0, 0.0, 1.0])


def plant_values(
    form: str,
    parameters: Mapping[str, float],
    effects: Mapping[str, Mapping[str, float]],
    formulas: Mapping[str, str] | None = None,
) -> PlantValues:
    """Return the parameters of a plant in one object; those of its damper form are nominal where they are not given.

    ``formulas`` says which formula an effect has, the first one by default; it may name further effects.

    Raises
    ------
    ValueError
        When a form, effect, formula or parameter is unknown, or an effect lacks a parameter.
    """
    damper = damper_forms.find_form(form)
    given = {**damper.nominal, **parameters}
    if unknown := given.keys() - damper.nominal.keys():
        raise ValueError(f"damper form {form}: unknown parameter {min(unknown)}, expected {', '.join(damper.nominal)}")
    for name, effect_values in effects.items():
        if name not in EFFECTS:
            raise ValueError(f"effect {name}: unknown, expected one of {', '.join(EFFECTS)}")
        formula = EFFECTS[name].formula((formulas or {}).get(name, ""))
        expected = {parameter.name for parameter in formula.parameters}
        if effect_values.keys() != expected:
            raise ValueError(
                f"effect {name}: has parameters {', '.join(effect_values) or 'none'}, "
                f"expected {', '.join(sorted(expected))} of the formula {formula.id}"
            )
        given |= {f"{name}_{key}": value for key, value in effect_values.items()}
        given[f"{name}_formula"] = float(EFFECTS[name].formulas.index(formula))
    given["form"] = float(damper.code)
    values: PlantValues = np.rec.array([tuple(given.get(name, 0.0) for name in NAMES)], dtype=VALUES)[0]
    return values


def has_series_element(form: str, effects: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether something gives way between the drive and the fluid."""
    sizes = {name: {p.name for formula in EFFECTS[name].formulas for p in formula.parameters if p.grows} for name in effects}
    return damper_forms.find_form(form).code == damper_forms.SPENCER or any(
        EFFECTS[name].in_series and any(values.get(size) for size in sizes[name]) for name, values in effects.items()
    )


@njit(nogil=True)
def damper_force(
    p: PlantValues, position: Array, velocity: Array, current: Array, step: float, gain: float, series: bool, slow: Array
) -> Array:
    """Integrate a damper along a motion and return its force on the load cell.

    Parameters
    ----------
    p : PlantValues
    position, velocity : ndarray (samples,)
        Motion in m and m/s of the drive at its rod.
    current : ndarray (samples,)
        Current in A that acts on the fluid.
    step : float
        Sampling period in s.
    gain : float
        Factor of the damper's force in this run.
    series : bool
        Whether there is a series element (`has_series_element`).
    slow : ndarray (4,)
        Slow state; updated in place.

    Returns
    -------
    ndarray (samples,)
        Force in N.
    """
    fast = np.zeros(BRANCH + BRANCHES)
    fast[SEAL_LEVEL] = stribeck_factor(p, 0.0)
    force = np.empty_like(position)
    fast[PISTON] = fast[ROD] = position[0]
    force[0] = gain * (p.offset + p.stiffness * position[0] + gas_force(p, position[0]))
    if series:  # the force that holds the rod at rest presses the joints to one side
        side = 1.0 if force[0] > 0.0 else -1.0
        fast[DRIVE], fast[JOINT] = 0.5 * side * p.backlash_play, 0.5 * side * p.joint_play_play
        fast[MOUNT] = series_elongation(p, 0.0, force[0], AT_REST)
        fast[PISTON] -= fast[DRIVE] + fast[JOINT] + fast[MOUNT]
        fast[ROD] = fast[PISTON]
    pieces = max(int(np.ceil(step / SUBSTEP - 1e-6)), 1) if series else 1
    h = step / pieces
    w, slope = velocity[0], h
    for i in range(1, len(position)):
        before = fast[ROD]
        strength = gain * thermal_factor(p, slow[HEAT], slow[FLUID_HEAT]) * settling_factor(p, slow[TRAVELLED])
        if series:
            for k in range(1, pieces + 1):
                x, now = (
                    _interpolated_position(position, velocity, i, k / pieces, step),
                    current[i - 1] + k / pieces * (current[i] - current[i - 1]),
                )
                w, slope = _solve_piston_speed(p, fast, x, w, slope, h, now, gain, strength, slow[STRUCTURE])
                force[i] = _advance(p, fast, w * h, w, h, now, gain, strength, slow[STRUCTURE])
        else:
            dx = position[i] - fast[PISTON]
            force[i] = _advance(p, fast, dx, velocity[i], h, current[i], gain, strength, slow[STRUCTURE])
        travel = fast[ROD] - before
        slow[TRAVELLED] += abs(travel)
        store_heat(p, slow[: FLUID_HEAT + 1], force[i] * travel, step)
        slow[STRUCTURE] = rebuilt_structure(p, slow[STRUCTURE], travel, step)
    return force


@njit(nogil=True)
def _interpolated_position(position: Array, velocity: Array, i: int, part: float, step: float) -> float:
    """Return the position of the drive within the step that ends at sample ``i``, by cubic Hermite interpolation."""
    u = 1.0 - part
    return float(
        u * u * (1.0 + 2.0 * part) * position[i - 1]
        + part * part * (1.0 + 2.0 * u) * position[i]
        + part * u * step * (u * velocity[i - 1] - part * velocity[i])
    )


@njit(nogil=True)
def _forces(
    p: PlantValues, s: Array, dx: float, v: float, h: float, current: float, gain: float, strength: float, structure: float
) -> tuple[float, float, float, float]:
    """Return the damper's force and the places of rod, dashpot and void after the piston has moved by ``dx`` at ``v``."""
    z = damper_forms.hysteretic_state(p, s[HYSTERESIS], s[CREEP], dx, h, current)
    yielding = damper_forms.yield_force(p, current) * taper_factor(p, s[PISTON] + dx) * structure_factor(p, structure)
    fluid = yielding * damper_forms.hysteretic_force(p, z, (z - s[HYSTERESIS]) / h, v, current)
    fluid += damper_forms.viscous_force(p, v, current) * thinning_factor(p, v) + turbulent_force(p, v)
    for k in range(BRANCHES):
        fluid += branch_force(p, k, branch_elongation(p, k, s[BRANCH + k], dx, h), current)
    fluid = strength * asymmetric_force(p, fluid, v)
    dashpot, void = s[DASHPOT], void_after_step(p, s[VOID], fluid, h)
    series = damper_forms.series_viscosity(p, current)
    if series > 0.0:
        dashpot += h * fluid / (gain * series)
    dashpot += h * leak_speed(p, fluid)
    rod = s[PISTON] + dx + dashpot + void + bubble_compression(p, fluid)
    travel = rod - s[ROD]
    force = p.offset + p.stiffness * rod + gas_force(p, rod) + heated_force(p, s[GAS_HEAT], s[ROD], rod, h)
    force += (
        hardening_force(p, rod) + stop_force(p, rod, travel / h) + elastic_force(p, rod, current) + waviness_force(p, rod)
    )
    if p.seal_friction_coulomb > 0.0:
        force += p.seal_friction_coulomb * seal_deflection(p, s[SEAL], travel, v, s[SEAL_LEVEL])
    if p.side_load_friction_slope > 0.0:
        force += guide_friction(p, rod) * guide_deflection(s[GUIDE], travel)
    return fluid + gain * force, rod, dashpot, void


@njit(nogil=True)
def _advance(
    p: PlantValues, s: Array, dx: float, v: float, h: float, current: float, gain: float, strength: float, structure: float
) -> float:
    """Make a step, update the fast state and return the force."""
    force, rod, dashpot, void = _forces(p, s, dx, v, h, current, gain, strength, structure)
    travel = rod - s[ROD]
    if p.seal_friction_coulomb > 0.0:
        s[SEAL] = seal_deflection(p, s[SEAL], travel, v, s[SEAL_LEVEL])
        # Valid from the next step on: within a step, friction must not fall with speed.
        s[SEAL_LEVEL] = stribeck_factor(p, travel / h)
    if p.side_load_friction_slope > 0.0:
        s[GUIDE] = guide_deflection(s[GUIDE], travel)
    state = damper_forms.hysteretic_state(p, s[HYSTERESIS], s[CREEP], dx, h, current)
    s[CREEP] = damper_forms.creep_after(p, s[CREEP], s[HYSTERESIS], state, h)
    s[HYSTERESIS] = state
    for k in range(BRANCHES):
        s[BRANCH + k] = branch_elongation(p, k, s[BRANCH + k], dx, h)
    s[GAS_HEAT] = heated_force(p, s[GAS_HEAT], s[ROD], rod, h)
    s[MOUNT] = series_elongation(p, s[MOUNT], force, h)
    s[DRIVE], s[JOINT] = backlash_offset(p, s[DRIVE], force, h), joint_offset(p, s[JOINT], force, h)
    s[PISTON] += dx
    s[DASHPOT], s[VOID], s[ROD] = dashpot, void, rod
    return float(force)


@njit(nogil=True)
def _overshoot(
    p: PlantValues, s: Array, x: float, w: float, h: float, current: float, gain: float, strength: float, structure: float
) -> float:
    """Return by how many metres piston and series elements overshoot the drive at a piston speed ``w``."""
    force, rod, _, _ = _forces(p, s, w * h, w, h, current, gain, strength, structure)
    overshoot = rod + series_elongation(p, s[MOUNT], force, h) + backlash_offset(p, s[DRIVE], force, h) - x
    return float(overshoot + joint_offset(p, s[JOINT], force, h))


@njit(nogil=True)
def _solve_piston_speed(
    p: PlantValues,
    s: Array,
    x: float,
    w: float,
    slope: float,
    h: float,
    current: float,
    gain: float,
    strength: float,
    structure: float,
) -> tuple[float, float]:
    """Return the piston speed without overshoot and the slope there, by secants, or by bisection at a kink."""
    low, high, before, error = -np.inf, np.inf, w, np.inf
    for _ in range(80):
        last, error = error, _overshoot(p, s, x, w, h, current, gain, strength, structure)
        if abs(error) < TOLERANCE:
            break
        if np.isfinite(last) and w != before:
            slope = max((error - last) / (w - before), h)
        far = w - 2.0 * error / h  # the slope of the motion itself, halved because the force may fall along the way
        if error > 0.0:
            low, high = max(low, far), min(high, w)
        else:
            low, high = max(low, w), min(high, far)
        before, w = w, w - error / slope
        if (np.isfinite(last) and abs(error) > 0.5 * abs(last)) or not low < w < high:
            w = 0.5 * (low + high)
    return w, slope
