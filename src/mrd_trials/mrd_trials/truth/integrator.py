"""Steps a damper through a motion: one kernel for all dampers and effects.

Without anything in series the drive's motion is the piston's. Else the piston's speed is the root of a scalar equation at
each of a few sub-steps (backward Euler): what drive, joints and springs leave for it under the force that it then makes.
Everything in series gives way the more, the larger the force, and the force grows with the speed, so that there is one root.

Each process compiles the kernels here anew: a cache on disk would not see that an effect's file has changed.
"""

import math
from collections import namedtuple
from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth import bases
from mrd_trials.truth.effects import EFFECTS
from mrd_trials.truth.effects.absent import rebuilt, squeezed, tapered
from mrd_trials.truth.effects.declare import Values
from mrd_trials.truth.effects.fluid import branch, gas, stretched, thinned, uneven, void, weakened
from mrd_trials.truth.effects.structure import BRISTLE, GUIDE, guided, loose, stopped, stribeck, swept

Array = NDArray[np.float64]

NAMES = (
    "form",
    *bases.PARAMETERS,
    *(f"{effect.id}_{quantity.name}" for effect in EFFECTS.values() for quantity in effect.quantities),
)
Given = namedtuple("Given", NAMES)  # type: ignore[misc]
"""`Values` that a kernel can read."""

SUBSTEP = 1 / 32000
"""s, longest one where the force decides what moves."""

BACKLASH_RESISTANCE = 150.0
"""N s/m, of grease in the drive's lash."""

TOLERANCE = 3e-11
"""m, of the equation for what is in series: well below a millinewton against the stiffest fluid."""

HEAT, TRAVELLED, STRUCTURE = range(3)
"""Slow state: J above ambient, m since the fluid settled, what shear has left of the fluid's structure."""

Z, E, Q, LEVEL, G, Y, N, DRIVE, JOINT, PISTON, ROD = range(11)
"""Fast state: hysteresis; stretch of the relaxing branch; bristles of the seal and their aim, of the guide; and in m
dashpot in series, void, drive's and damper's joint, piston and rod."""


def values(base: str, parameters: Mapping[str, float], effects: Mapping[str, Mapping[str, float]]) -> Values:
    """Of a plant.

    Raises
    ------
    ValueError
        For an unknown form, effect or parameter.
    """
    form = bases.find_base(base)
    given = {**form.nominal, **parameters}
    if unknown := given.keys() - form.nominal.keys():
        raise ValueError(f"base {base}: unknown parameter {min(unknown)}, expected {', '.join(form.nominal)}")
    for name, own in effects.items():
        if name not in EFFECTS:
            raise ValueError(f"effect {name}: unknown, expected one of {', '.join(EFFECTS)}")
        expected = {quantity.name for quantity in EFFECTS[name].quantities}
        if own.keys() != expected:
            raise ValueError(
                f"effect {name}: has parameters {', '.join(own) or 'none'}, expected {', '.join(sorted(expected))}"
            )
        given |= {f"{name}_{key}": value for key, value in own.items()}
    given["form"] = float(form.form)
    found: Values = Given(  # type: ignore[assignment]
        *(float(given.get(name, 0.0)) for name in NAMES)
    )
    return found


def in_series(base: str, effects: Mapping[str, Mapping[str, float]]) -> bool:
    """Whether something gives way between the drive and the fluid."""
    return bases.find_base(base).form == bases.SPENCER or any(
        EFFECTS[name].in_series and any(own[quantity.name] for quantity in EFFECTS[name].quantities if quantity.grows)
        for name, own in effects.items()
    )


@njit(nogil=True)
def stepped(
    p: Values, position: Array, velocity: Array, current: Array, step: float, gain: float, series: bool, slow: Array
) -> Array:
    """Force of the damper on the load cell.

    Parameters
    ----------
    p : Values
    position, velocity : ndarray (samples,)
        Of the drive, at its rod.
    current : ndarray (samples,)
        A, that the fluid feels.
    step : float
        s.
    gain : float
        Of the damper's force.
    series : bool
        Whether to let the force decide what moves.
    slow : ndarray (3,)
        Heat, travel and structure; kept up to date.

    Returns
    -------
    ndarray (samples,)
        N.
    """
    fast = np.zeros(11)
    fast[LEVEL] = stribeck(p, 0.0)
    found = np.empty_like(position)
    fast[PISTON] = fast[ROD] = position[0]
    found[0] = gain * (p.offset + p.stiffness * position[0] + gas(p, position[0]))
    if series:  # pressed to one side of the joints by what holds the rod at rest
        side = 1.0 if found[0] > 0.0 else -1.0
        fast[DRIVE], fast[JOINT] = 0.5 * side * p.backlash_play, 0.5 * side * p.joint_play_play
        fast[PISTON] -= fast[DRIVE] + fast[JOINT] + p.series_compliance_compliance * found[0]
        fast[ROD] = fast[PISTON]
    pieces = max(int(np.ceil(step / SUBSTEP - 1e-6)), 1) if series else 1
    h = step / pieces
    w, slope = velocity[0], h
    for i in range(1, len(position)):
        before = fast[ROD]
        weak = gain * weakened(p, slow[HEAT], slow[TRAVELLED])
        if series:
            for k in range(1, pieces + 1):
                x, now = (
                    _between(position, velocity, i, k / pieces, step),
                    current[i - 1] + k / pieces * (current[i] - current[i - 1]),
                )
                w, slope = _solved(p, fast, x, w, slope, h, now, gain, weak, slow[STRUCTURE])
                found[i] = _commit(p, fast, w * h, w, h, now, gain, weak, slow[STRUCTURE])
        else:
            found[i] = _commit(p, fast, position[i] - fast[PISTON], velocity[i], h, current[i], gain, weak, slow[STRUCTURE])
        moved = fast[ROD] - before
        slow[TRAVELLED] += abs(moved)
        if p.thermal_fade_fade > 0.0:
            slow[HEAT] = max(slow[HEAT] * (1.0 - step / p.thermal_fade_cooling_time) + found[i] * moved, 0.0)
        if p.thixotropy_weakening > 0.0:
            slow[STRUCTURE] = rebuilt(p, slow[STRUCTURE], moved, step)
    return found


@njit(nogil=True)
def _between(position: Array, velocity: Array, i: int, part: float, step: float) -> float:
    """Position of the drive within the step that ends at sample ``i``: a cubic."""
    u = 1.0 - part
    return float(
        u * u * (1.0 + 2.0 * part) * position[i - 1]
        + part * part * (1.0 + 2.0 * u) * position[i]
        + part * u * step * (u * velocity[i - 1] - part * velocity[i])
    )


@njit(nogil=True)
def _forces(
    p: Values, s: Array, dx: float, v: float, h: float, current: float, gain: float, weak: float, structure: float
) -> tuple[float, float, float, float]:
    """Damper's force, rod, dashpot in series and void after the piston has moved by ``dx`` at ``v``."""
    z = bases.deflected(p, s[Z], dx, current)
    strength = bases.yield_force(p, current)
    if p.tapered_gap_taper != 0.0:
        strength *= tapered(p, s[PISTON] + dx)
    if p.thixotropy_weakening > 0.0:
        strength *= 1.0 - p.thixotropy_weakening * (1.0 - structure)
    fluid = strength * bases.hysteretic(p, z, (z - s[Z]) / h, v, current) + bases.viscous(p, current) * thinned(p, v) * v
    fluid += branch(p, stretched(p, s[E], dx, h), current) + p.orifice_loss_loss * abs(v) * v
    fluid = weak * uneven(p, fluid)
    y, n = s[Y], void(p, s[N], fluid, h)
    series = bases.dashpot(p, current)
    if series > 0.0:
        y += h * fluid / (gain * series)
    rod = s[PISTON] + dx + y + n + squeezed(p, fluid)
    moved = rod - s[ROD]
    force = (
        p.offset + p.stiffness * rod + gas(p, rod) + stopped(p, rod, moved / h) + p.field_stiffness_stiffness * current * rod
    )
    if p.seal_friction_coulomb > 0.0:
        force += p.seal_friction_coulomb * swept(s[Q], moved, BRISTLE, s[LEVEL])
    if p.side_load_friction_slope > 0.0:
        force += guided(p, rod) * swept(s[G], moved, GUIDE, 1.0)
    if p.guide_waviness_amplitude > 0.0:
        force += p.guide_waviness_amplitude * math.sin(
            2.0 * math.pi * rod / p.guide_waviness_length + p.guide_waviness_phase
        )
    return fluid + gain * force, rod, y, n


@njit(nogil=True)
def _commit(
    p: Values, s: Array, dx: float, v: float, h: float, current: float, gain: float, weak: float, structure: float
) -> float:
    """The step is made; returns the force."""
    force, rod, y, n = _forces(p, s, dx, v, h, current, gain, weak, structure)
    moved = rod - s[ROD]
    if p.seal_friction_coulomb > 0.0:
        s[Q] = swept(s[Q], moved, BRISTLE, s[LEVEL])
        s[LEVEL] = stribeck(p, moved / h)  # for the next step: within one, friction must not fall with speed
    if p.side_load_friction_slope > 0.0:
        s[G] = swept(s[G], moved, GUIDE, 1.0)
    s[Z], s[E] = bases.deflected(p, s[Z], dx, current), stretched(p, s[E], dx, h)
    s[DRIVE] = loose(s[DRIVE], p.backlash_play, force, BACKLASH_RESISTANCE, p.backlash_drag, h)
    s[JOINT] = loose(s[JOINT], p.joint_play_play, force, p.joint_play_resistance, 0.0, h)
    s[PISTON] += dx
    s[Y], s[N], s[ROD] = y, n, rod
    return float(force)


@njit(nogil=True)
def _left(
    p: Values, s: Array, x: float, w: float, h: float, current: float, gain: float, weak: float, structure: float
) -> float:
    """m by which piston and all in series overshoot the drive, at a speed of the piston."""
    force, rod, _, _ = _forces(p, s, w * h, w, h, current, gain, weak, structure)
    found = rod + p.series_compliance_compliance * force - x
    found += loose(s[DRIVE], p.backlash_play, force, BACKLASH_RESISTANCE, p.backlash_drag, h)
    return float(found + loose(s[JOINT], p.joint_play_play, force, p.joint_play_resistance, 0.0, h))


@njit(nogil=True)
def _solved(
    p: Values,
    s: Array,
    x: float,
    w: float,
    slope: float,
    h: float,
    current: float,
    gain: float,
    weak: float,
    structure: float,
) -> tuple[float, float]:
    """Speed of the piston at which all meets, and the slope there: secants, and halving where these fail at a kink."""
    low, high, before, error = -np.inf, np.inf, w, np.inf
    for _ in range(80):
        last, error = error, _left(p, s, x, w, h, current, gain, weak, structure)
        if abs(error) < TOLERANCE:
            break
        if np.isfinite(last) and w != before:
            slope = max((error - last) / (w - before), h)
        far = w - 2.0 * error / h  # as steep as the motion itself, with room for a force that falls along the way
        if error > 0.0:
            low, high = max(low, far), min(high, w)
        else:
            low, high = max(low, w), min(high, far)
        before, w = w, w - error / slope
        if (np.isfinite(last) and abs(error) > 0.5 * abs(last)) or not low < w < high:
            w = 0.5 * (low + high)
    return w, slope
