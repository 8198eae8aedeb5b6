"""Effects put into measured runs after the fact.

Every effect here can be added to a recording without a model of the damper, by these assumptions: the force less its mean
is the fluid's; what is parallel to the damper adds a force that follows from the measured motion; what is in series adds an
elongation that follows from the measured force; a sensor changes what it reads. Where the drive crosses a play, the rod
rests, and the run takes longer than the recorded one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.air_bubble import bubble_compression
from mrd_trials.truth.effects.backlash import backlash_offset
from mrd_trials.truth.effects.current_sensor_error import current_reading
from mrd_trials.truth.effects.end_stop import stop_force
from mrd_trials.truth.effects.field_stiffness import elastic_force
from mrd_trials.truth.effects.flow_asymmetry import asymmetric_force
from mrd_trials.truth.effects.gas_spring import gas_force, heated_force
from mrd_trials.truth.effects.guide_waviness import waviness_force
from mrd_trials.truth.effects.hardening_spring import hardening_force
from mrd_trials.truth.effects.joint_play import joint_offset
from mrd_trials.truth.effects.lvdt_nonlinearity import transducer_reading
from mrd_trials.truth.effects.mains_hum import hum
from mrd_trials.truth.effects.moving_mass import inertia_force
from mrd_trials.truth.effects.orifice_loss import turbulent_force
from mrd_trials.truth.effects.rate_dependent_hysteresis import BRANCHES, branch_elongation, branch_force
from mrd_trials.truth.effects.seal_friction import seal_deflection, stribeck_factor
from mrd_trials.truth.effects.sensor_stiction import sticking_reading
from mrd_trials.truth.effects.series_compliance import AT_REST, series_elongation
from mrd_trials.truth.effects.servo_ripple import tooth_error
from mrd_trials.truth.effects.settling import settling_factor
from mrd_trials.truth.effects.side_load_friction import guide_deflection, guide_friction
from mrd_trials.truth.effects.thermal_fade import store_heat, thermal_factor
from mrd_trials.truth.effects.true_effect import PlantValues
from mrd_trials.truth.integration import FLUID_HEAT, HEAT, TRAVELLED, plant_values, rested_state
from mrd_trials.truth.recording import REST, force_channel

Array = NDArray[np.float64]

ALTERATIONS = (
    "servo_ripple",
    "backlash",
    "current_sensor_error",
    "gas_spring",
    "flow_asymmetry",
    "rate_dependent_hysteresis",
    "thermal_fade",
    "settling",
    "series_compliance",
    "joint_play",
    "seal_friction",
    "side_load_friction",
    "hardening_spring",
    "end_stop",
    "moving_mass",
    "lvdt_nonlinearity",
    "load_cell_drift",
    "force_sensor_lag",
    "channel_delay",
    "mains_hum",
    "channel_crosstalk",
    "frame_resonance",
    "orifice_loss",
    "field_stiffness",
    "air_bubble",
    "sensor_stiction",
    "guide_waviness",
    "cell_overload",
    "gain_drift",
)
"""Effects that can be put into a recording; the others need the force of the damper at another current or motion."""


SLOWEST_CROSSING = 0.01
"""Least speed at which the drive crosses a play, over the largest speed of the run: a drive at rest would never cross it."""


@dataclass(frozen=True)
class MeasuredRun:
    """A measured run; all arrays have the shape (samples,).

    Attributes
    ----------
    time : ndarray
        Time in s from 0, about equally spaced.
    position, velocity, acceleration : ndarray
        Motion in m, m/s and m/s²; velocity and acceleration are smooth.
    current, force : ndarray
        Coil current in A and force in N.
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    current: Array
    force: Array


@dataclass(frozen=True)
class AlteredRun:
    """A run as it would have been recorded with some effects; all arrays have the shape (samples,).

    Attributes
    ----------
    time, position, current, force : ndarray
        As in `MeasuredRun`. The time ends later where plays were crossed.
    recorded : ndarray of int
        Sample of the measured run that was reached; it stays the same while the rod rests.
    """

    time: Array
    position: Array
    current: Array
    force: Array
    recorded: NDArray[np.intp]


def alter(
    runs: Sequence[MeasuredRun],
    effects: Mapping[str, Mapping[str, float]],
    formulas: Mapping[str, str],
    rng: np.random.Generator,
) -> list[AlteredRun]:
    """Return the runs as they would have been recorded with some effects.

    The runs are taken as one session, in their order, with a pause of 30 s between them.

    Parameters
    ----------
    runs : sequence of MeasuredRun
    effects : mapping
        Parameters of each effect, by id.
    formulas : mapping
        Formula of each effect, the first one where left out; may name further effects.
    rng : numpy Generator
        Draws the phase of the mains in each run, and the noise of the force while a play is crossed.

    Raises
    ------
    ValueError
        When an effect, formula or parameter is unknown, or an effect cannot be put into a recording.
    """
    if wrong := sorted(effects.keys() - set(ALTERATIONS)):
        raise ValueError(f"effect {wrong[0]}: cannot be put into a recording, expected one of {', '.join(ALTERATIONS)}")
    p = plant_values("bouc_wen", {}, effects, formulas)
    preload = float(np.mean(np.concatenate([run.force for run in runs])))
    # Stops, springs and transducers are mounted about the middle of the strokes, wherever the zero of the recordings is.
    middle = middle_of_strokes(runs)
    slow, clock, altered = rested_state(), 0.0, []
    for run in runs:
        step = float((run.time[-1] - run.time[0]) / (len(run.time) - 1))
        rod = run.position - middle
        force = _force_on_cell(p, rod, run.velocity, run.current, run.force - preload, step, slow) + preload
        force += inertia_force(p, rod, run.velocity, run.acceleration, step)
        before, crossing = _crossings(p, run.velocity, run.acceleration, force, step)
        recorded = np.insert(np.arange(len(force)), before, before - 1)
        rests = np.insert(np.zeros(len(force), bool), before, True)
        time = run.time[recorded] + step * np.cumsum(rests)
        force = np.insert(force, before, crossing)
        position = _shown_by_encoder(p, rod[recorded] + _elongations(p, force, step))
        force[rests] += _noise(run.force) * rng.standard_normal(len(before))
        force = force_channel(p, force, position, run.current[recorded], clock, time, step)
        force = force + hum(p, time, rng.random())
        current = current_reading(p, clock + time, run.current[recorded])
        shown = transducer_reading(p, sticking_reading(p, position)) + middle
        altered.append(AlteredRun(time, shown, current, force, recorded))
        clock += time[-1] + REST
        store_heat(p, slow[: FLUID_HEAT + 1], 0.0, REST)
    return altered


def middle_of_strokes(runs: Sequence[MeasuredRun]) -> float:
    """Return the position in m in the middle of the strokes of all runs."""
    return 0.5 * (max(float(run.position.max()) for run in runs) + min(float(run.position.min()) for run in runs))


def _noise(force: Array) -> float:
    """Return the standard deviation in N of white noise, from what differs between neighbouring samples."""
    return float(np.median(np.abs(np.diff(force, 2))) / (0.6745 * math.sqrt(6.0)))


@njit(nogil=True)
def _force_on_cell(
    p: PlantValues, position: Array, velocity: Array, current: Array, fluid: Array, step: float, slow: Array
) -> Array:
    """Return the force beyond the preload, from that of the fluid, when some effects act along with it."""
    force = np.empty_like(fluid)
    seal, level, guide, gas_heat = 0.0, stribeck_factor(p, 0.0), 0.0, 0.0
    branches = np.zeros(BRANCHES)
    for i in range(len(force)):
        x, v = position[i], velocity[i]
        before = position[max(i - 1, 0)]
        strength = thermal_factor(p, slow[HEAT], slow[FLUID_HEAT]) * settling_factor(p, slow[TRAVELLED])
        seal = seal_deflection(p, seal, x - before, v, level)
        level = stribeck_factor(p, v)
        guide = guide_deflection(guide, x - before)
        gas_heat = heated_force(p, gas_heat, before, x, step)
        parallel = gas_force(p, x) + gas_heat + hardening_force(p, x) + stop_force(p, x, v) + elastic_force(p, x, current[i])
        parallel += waviness_force(p, x) + turbulent_force(p, v)
        if p.seal_friction_coulomb > 0.0:
            parallel += p.seal_friction_coulomb * seal
        if p.side_load_friction_slope > 0.0:
            parallel += guide_friction(p, x) * guide
        for k in range(BRANCHES):
            branches[k] = branch_elongation(p, k, branches[k], x - before, step)
            parallel += branch_force(p, k, branches[k], current[i])
        force[i] = strength * asymmetric_force(p, fluid[i], v) + parallel
        slow[TRAVELLED] += abs(x - before)
        store_heat(p, slow[: FLUID_HEAT + 1], force[i] * (x - before), step)
    return force


@njit(nogil=True)
def _plays_at_rest(p: PlantValues, force: float) -> tuple[float, float]:
    """Return where drive and joint lie in their plays when a force has acted for long."""
    side = 1.0 if force > 0.0 else -1.0
    return 0.5 * side * p.backlash_play, 0.5 * side * p.joint_play_play


@njit(nogil=True)
def _plays_after(p: PlantValues, plays: tuple[float, float], force: float, step: float) -> tuple[float, float]:
    """Return where drive and joint lie in their plays after a step under a force."""
    return backlash_offset(p, plays[0], force, step), joint_offset(p, plays[1], force, step)


@njit(nogil=True)
def _moved(plays: tuple[float, float], after: tuple[float, float]) -> float:
    """Return by how much drive and joint have moved together."""
    return after[0] - plays[0] + after[1] - plays[1]


@njit(nogil=True)
def _crossings(
    p: PlantValues, velocity: Array, acceleration: Array, force: Array, step: float
) -> tuple[NDArray[np.intp], Array]:
    """Return the samples at which the rod rests while the drive crosses its plays.

    The recorded force would push the drive across within a sample or two, but the drive has a speed of its own: that of the
    rod, or what it reaches in the play with the acceleration of the rod. Until it is across, the rod rests, and the force
    is the one that moves the drive at this speed.

    Returns
    -------
    before : ndarray (m,)
        Recorded sample before which each of these samples comes, in their order.
    crossing : ndarray (m,)
        Force in N.
    """
    before, crossing = [0 for _ in range(0)], [0.0 for _ in range(0)]
    play = p.backlash_play + p.joint_play_play
    plays = _plays_after(p, _plays_at_rest(p, force[0]), force[0], step)
    slowest, largest = SLOWEST_CROSSING * np.abs(velocity).max(), np.abs(force).max()
    for i in range(1, len(force)):
        speed = max(abs(velocity[i]), math.sqrt(0.5 * abs(acceleration[i]) * play), slowest)
        moved = _moved(plays, _plays_after(p, plays, force[i], step))
        while speed > 0.0 and abs(moved) > speed * step:
            forward = moved > 0.0
            weak, strong = (-largest, force[i]) if forward else (largest, force[i])
            for _ in range(50):
                middle = 0.5 * (weak + strong)
                moved = _moved(plays, _plays_after(p, plays, middle, step))
                if (moved if forward else -moved) > speed * step:
                    strong = middle
                else:
                    weak = middle
            plays = _plays_after(p, plays, strong, step)
            before.append(i)
            crossing.append(strong)
            moved = _moved(plays, _plays_after(p, plays, force[i], step))
        plays = _plays_after(p, plays, force[i], step)
    return np.array(before, dtype=np.intp), np.array(crossing, dtype=np.float64)


@njit(nogil=True)
def _elongations(p: PlantValues, force: Array, step: float) -> Array:
    """Return by how much everything in series with the damper is longer under its force."""
    elongation = np.empty_like(force)
    plays = _plays_at_rest(p, force[0])
    mount = series_elongation(p, 0.0, force[0], AT_REST)
    for i in range(len(force)):
        plays = _plays_after(p, plays, force[i], step)
        mount = series_elongation(p, mount, force[i], step)
        elongation[i] = plays[0] + plays[1] + mount + bubble_compression(p, force[i])
    return elongation


def _shown_by_encoder(p: PlantValues, rod: Array) -> Array:
    """Return what an encoder shows that lacks the error of the teeth between it and the rod."""
    shown = rod
    for _ in range(20):  # the iteration contracts: the error changes by less than a tenth of the motion
        shown = rod - tooth_error(p, shown)[0]
    return shown
