"""Effects put into measured runs after the fact.

Every effect here can be added to a recording without a model of the damper, by these assumptions: the force less its mean
is the fluid's; what is parallel to the damper adds a force that follows from the measured motion; what is in series adds an
elongation that follows from the measured force; a sensor changes what it reads.
"""

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


def alter(
    runs: Sequence[MeasuredRun],
    effects: Mapping[str, Mapping[str, float]],
    formulas: Mapping[str, str],
    rng: np.random.Generator,
) -> list[tuple[Array, Array, Array]]:
    """Return position, current and force of each run as they would have been recorded with some effects.

    The runs are taken as one session, in their order, with a pause of 30 s between them.

    Parameters
    ----------
    runs : sequence of MeasuredRun
    effects : mapping
        Parameters of each effect, by id.
    formulas : mapping
        Formula of each effect, the first one where left out; may name further effects.
    rng : numpy Generator
        Draws the phase of the mains in each run.

    Raises
    ------
    ValueError
        When an effect, formula or parameter is unknown, or an effect cannot be put into a recording.
    """
    if wrong := sorted(effects.keys() - set(ALTERATIONS)):
        raise ValueError(f"effect {wrong[0]}: cannot be put into a recording, expected one of {', '.join(ALTERATIONS)}")
    p = plant_values("bouc_wen", {}, effects, formulas)
    preload = float(np.mean(np.concatenate([run.force for run in runs])))
    slow, clock, altered = rested_state(), 0.0, []
    for run in runs:
        step = float((run.time[-1] - run.time[0]) / (len(run.time) - 1))
        motion = run.position, run.velocity, run.acceleration
        force = _force_on_cell(p, run.position, run.velocity, run.current, run.force - preload, step, slow) + preload
        force += inertia_force(p, *motion, step)
        position = _shown_by_encoder(p, run.position + _elongations(p, force, step))
        force = force_channel(p, force, position, run.current, clock, run.time, step)
        force = force + hum(p, run.time, rng.random())
        current = current_reading(p, clock + run.time, run.current)
        altered.append((transducer_reading(p, sticking_reading(p, position)), current, force))
        clock += run.time[-1] + REST
        store_heat(p, slow[: FLUID_HEAT + 1], 0.0, REST)
    return altered


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
def _elongations(p: PlantValues, force: Array, step: float) -> Array:
    """Return by how much everything in series with the damper is longer under its force."""
    elongation = np.empty_like(force)
    side = 1.0 if force[0] > 0.0 else -1.0
    drive, joint = 0.5 * side * p.backlash_play, 0.5 * side * p.joint_play_play
    mount = series_elongation(p, 0.0, force[0], AT_REST)
    for i in range(len(force)):
        drive, joint = backlash_offset(p, drive, force[i], step), joint_offset(p, joint, force[i], step)
        mount = series_elongation(p, mount, force[i], step)
        elongation[i] = drive + joint + mount + bubble_compression(p, force[i])
    return elongation


def _shown_by_encoder(p: PlantValues, rod: Array) -> Array:
    """Return what an encoder shows that lacks the error of the teeth between it and the rod."""
    shown = rod
    for _ in range(20):  # the iteration contracts: the error changes by less than a tenth of the motion
        shown = rod - tooth_error(p, shown)[0]
    return shown
