"""Integration of a damper along a motion: one compiled function for all damper forms and effects.

Without a series element, the piston moves as the drive does. With one, the piston's speed is the root of a scalar equation
at each of a few sub-steps (backward Euler): piston, joints and springs together must move as the drive does, under the force
that this speed gives. A series element gives way more under a larger force, and the force grows with the speed, so there is
exactly one root.

Every process compiles these functions again: a cache on disk would not notice that the file of an effect has changed.
"""

import math
from collections import namedtuple
from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth import damper_forms
from mrd_trials.truth.effects import EFFECTS
from mrd_trials.truth.effects.absent import bubble_compression, rebuilt_structure, taper_factor
from mrd_trials.truth.effects.fluid import (
    asymmetric_force,
    branch_elongation,
    branch_force,
    fluid_strength,
    gas_force,
    thinning_factor,
    void_after_step,
)
from mrd_trials.truth.effects.structure import (
    GUIDE_TRAVEL,
    SEAL_TRAVEL,
    bristle_deflection,
    guide_friction,
    joint_offset,
    stop_force,
    stribeck_factor,
)
from mrd_trials.truth.effects.true_effect import PlantValues

Array = NDArray[np.float64]

NAMES = (
    "form",
    *damper_forms.PARAMETERS,
    *(f"{effect.id}_{parameter.name}" for effect in EFFECTS.values() for parameter in effect.parameters),
)
CompiledValues = namedtuple("CompiledValues", NAMES)  # type: ignore[misc]
"""`PlantValues` that a compiled function can read."""

SUBSTEP = 1 / 32000
"""Longest sub-step in s with a series element."""

BACKLASH_RESISTANCE = 150.0
"""Viscous resistance in N s/m of the grease in the drive's backlash."""

TOLERANCE = 3e-11
"""Tolerance in m of the equation for series elements: well below a millinewton against the stiffest fluid."""

HEAT, TRAVELLED, STRUCTURE = range(3)
"""Places in the slow state: heat above ambient in J, travel in m since the fluid settled, its structure (0 to 1)."""

HYSTERESIS, BRANCH, SEAL, SEAL_LEVEL, GUIDE, DASHPOT, VOID, DRIVE, JOINT, PISTON, ROD = range(11)
"""Places in the fast state: hysteretic state, elongation of the relaxing branch, bristles of the seal and the level that
they tend to, bristles of the guide; then in m: dashpot in series, void, joints of drive and damper, piston, rod."""


def plant_values(form: str, parameters: Mapping[str, float], effects: Mapping[str, Mapping[str, float]]) -> PlantValues:
    """Return the parameters of a plant in one object; those of its damper form are nominal where they are not given.

    Raises
    ------
    ValueError
        When a form, effect or parameter is unknown, or an effect lacks a parameter.
    """
    damper = damper_forms.find_form(form)
    given = {**damper.nominal, **parameters}
    if unknown := given.keys() - damper.nominal.keys():
        raise ValueError(f"damper form {form}: unknown parameter {min(unknown)}, expected {', '.join(damper.nominal)}")
    for name, effect_values in effects.items():
        if name not in EFFECTS:
            raise ValueError(f"effect {name}: unknown, expected one of {', '.join(EFFECTS)}")
        expected = {parameter.name for parameter in EFFECTS[name].parameters}
        if effect_values.keys() != expected:
            raise ValueError(
                f"effect {name}: has parameters {', '.join(effect_values) or 'none'}, expected {', '.join(sorted(expected))}"
            )
        given |= {f"{name}_{key}": value for key, value in effect_values.items()}
    given["form"] = float(damper.code)
    values: PlantValues = CompiledValues(  # type: ignore[assignment]
        *(float(given.get(name, 0.0)) for name in NAMES)
    )
    return values


def has_series_element(form: str, effects: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether something gives way between the drive and the fluid."""
    return damper_forms.find_form(form).code == damper_forms.SPENCER or any(
        EFFECTS[name].in_series and any(values[parameter.name] for parameter in EFFECTS[name].parameters if parameter.grows)
        for name, values in effects.items()
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
    slow : ndarray (3,)
        Slow state; updated in place.

    Returns
    -------
    ndarray (samples,)
        Force in N.
    """
    fast = np.zeros(11)
    fast[SEAL_LEVEL] = stribeck_factor(p, 0.0)
    force = np.empty_like(position)
    fast[PISTON] = fast[ROD] = position[0]
    force[0] = gain * (p.offset + p.stiffness * position[0] + gas_force(p, position[0]))
    if series:  # the force that holds the rod at rest presses the joints to one side
        side = 1.0 if force[0] > 0.0 else -1.0
        fast[DRIVE], fast[JOINT] = 0.5 * side * p.backlash_play, 0.5 * side * p.joint_play_play
        fast[PISTON] -= fast[DRIVE] + fast[JOINT] + p.series_compliance_compliance * force[0]
        fast[ROD] = fast[PISTON]
    pieces = max(int(np.ceil(step / SUBSTEP - 1e-6)), 1) if series else 1
    h = step / pieces
    w, slope = velocity[0], h
    for i in range(1, len(position)):
        before = fast[ROD]
        strength = gain * fluid_strength(p, slow[HEAT], slow[TRAVELLED])
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
        if p.thermal_fade_fade > 0.0:
            slow[HEAT] = max(slow[HEAT] * (1.0 - step / p.thermal_fade_cooling_time) + force[i] * travel, 0.0)
        if p.thixotropy_weakening > 0.0:
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
    z = damper_forms.hysteretic_state(p, s[HYSTERESIS], dx, current)
    yielding = damper_forms.yield_force(p, current)
    if p.tapered_gap_taper != 0.0:
        yielding *= taper_factor(p, s[PISTON] + dx)
    if p.thixotropy_weakening > 0.0:
        yielding *= 1.0 - p.thixotropy_weakening * (1.0 - structure)
    fluid = (
        yielding * damper_forms.hysteretic_force(p, z, (z - s[HYSTERESIS]) / h, v, current)
        + damper_forms.viscosity(p, current) * thinning_factor(p, v) * v
    )
    fluid += branch_force(p, branch_elongation(p, s[BRANCH], dx, h), current) + p.orifice_loss_loss * abs(v) * v
    fluid = strength * asymmetric_force(p, fluid)
    dashpot, void = s[DASHPOT], void_after_step(p, s[VOID], fluid, h)
    series = damper_forms.series_viscosity(p, current)
    if series > 0.0:
        dashpot += h * fluid / (gain * series)
    rod = s[PISTON] + dx + dashpot + void + bubble_compression(p, fluid)
    travel = rod - s[ROD]
    force = (
        p.offset
        + p.stiffness * rod
        + gas_force(p, rod)
        + stop_force(p, rod, travel / h)
        + p.field_stiffness_stiffness * current * rod
    )
    if p.seal_friction_coulomb > 0.0:
        force += p.seal_friction_coulomb * bristle_deflection(s[SEAL], travel, SEAL_TRAVEL, s[SEAL_LEVEL])
    if p.side_load_friction_slope > 0.0:
        force += guide_friction(p, rod) * bristle_deflection(s[GUIDE], travel, GUIDE_TRAVEL, 1.0)
    if p.guide_waviness_amplitude > 0.0:
        force += p.guide_waviness_amplitude * math.sin(
            2.0 * math.pi * rod / p.guide_waviness_length + p.guide_waviness_phase
        )
    return fluid + gain * force, rod, dashpot, void


@njit(nogil=True)
def _advance(
    p: PlantValues, s: Array, dx: float, v: float, h: float, current: float, gain: float, strength: float, structure: float
) -> float:
    """Make a step, update the fast state and return the force."""
    force, rod, dashpot, void = _forces(p, s, dx, v, h, current, gain, strength, structure)
    travel = rod - s[ROD]
    if p.seal_friction_coulomb > 0.0:
        s[SEAL] = bristle_deflection(s[SEAL], travel, SEAL_TRAVEL, s[SEAL_LEVEL])
        # Valid from the next step on: within a step, friction must not fall with speed.
        s[SEAL_LEVEL] = stribeck_factor(p, travel / h)
    if p.side_load_friction_slope > 0.0:
        s[GUIDE] = bristle_deflection(s[GUIDE], travel, GUIDE_TRAVEL, 1.0)
    s[HYSTERESIS] = damper_forms.hysteretic_state(p, s[HYSTERESIS], dx, current)
    s[BRANCH] = branch_elongation(p, s[BRANCH], dx, h)
    s[DRIVE] = joint_offset(s[DRIVE], p.backlash_play, force, BACKLASH_RESISTANCE, p.backlash_drag, h)
    s[JOINT] = joint_offset(s[JOINT], p.joint_play_play, force, p.joint_play_resistance, 0.0, h)
    s[PISTON] += dx
    s[DASHPOT], s[VOID], s[ROD] = dashpot, void, rod
    return float(force)


@njit(nogil=True)
def _overshoot(
    p: PlantValues, s: Array, x: float, w: float, h: float, current: float, gain: float, strength: float, structure: float
) -> float:
    """Return by how many metres piston and series elements overshoot the drive at a piston speed ``w``."""
    force, rod, _, _ = _forces(p, s, w * h, w, h, current, gain, strength, structure)
    overshoot = rod + p.series_compliance_compliance * force - x
    overshoot += joint_offset(s[DRIVE], p.backlash_play, force, BACKLASH_RESISTANCE, p.backlash_drag, h)
    return float(overshoot + joint_offset(s[JOINT], p.joint_play_play, force, p.joint_play_resistance, 0.0, h))


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
