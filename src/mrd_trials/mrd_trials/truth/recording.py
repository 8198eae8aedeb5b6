"""A plant, what the bench commands, and what is recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter

from mrd_trials.truth.effects.cell_overload import overloaded_reading
from mrd_trials.truth.effects.channel_crosstalk import leaking_force
from mrd_trials.truth.effects.channel_delay import delayed_force
from mrd_trials.truth.effects.coil_lag import lagged_current
from mrd_trials.truth.effects.current_saturation import saturated_current
from mrd_trials.truth.effects.current_sensor_error import current_reading
from mrd_trials.truth.effects.force_sensor_lag import lagged_force
from mrd_trials.truth.effects.frame_resonance import ringing_force
from mrd_trials.truth.effects.gain_drift import drifting_gain
from mrd_trials.truth.effects.linear_filters import lagged
from mrd_trials.truth.effects.load_cell_drift import drift_force
from mrd_trials.truth.effects.lvdt_nonlinearity import transducer_reading
from mrd_trials.truth.effects.magnetic_hysteresis import remanent_current
from mrd_trials.truth.effects.mains_hum import hum
from mrd_trials.truth.effects.moving_mass import inertia_force
from mrd_trials.truth.effects.sensor_stiction import sticking_reading
from mrd_trials.truth.effects.servo_ripple import rippled_motion
from mrd_trials.truth.effects.supply_ripple import rippling_current
from mrd_trials.truth.effects.thermal_fade import store_heat
from mrd_trials.truth.effects.thixotropy import rebuilt_structure
from mrd_trials.truth.effects.true_effect import PlantValues
from mrd_trials.truth.instruments import Readings, TrueInstruments, sample_signal
from mrd_trials.truth.integration import FLUID_HEAT, STRUCTURE, damper_force, has_series_element, plant_values, rested_state

Array = NDArray[np.float64]

LEAST_COMMAND_RATE = 8000.0
"""Lowest rate in Hz at which a command may be given: the integration steps from sample to sample."""

SERVO_FREQUENCY, SERVO_DAMPING = 32.0, 0.8
"""Natural frequency in Hz and damping ratio of the drive's position loop."""

SUPPLY_LAG = 3e-3
"""Time constant in s with which the current of the supply follows its command."""

REST = 30.0
"""Pause in s between two runs."""


@dataclass(frozen=True)
class BenchCommand:
    """Commands to drive and supply during one run.

    Attributes
    ----------
    time : ndarray (samples,)
        Time in s, equally spaced from 0 by at most 1/8000 s.
    position : ndarray (samples,)
        Position in m from mid-stroke.
    current : ndarray (samples,)
        Coil current in A.
    exact : bool
        Whether drive and coil do exactly what is commanded, as in the replay of a recorded run; else they lag behind it.
    """

    time: Array
    position: Array
    current: Array
    exact: bool = False

    def __post_init__(self) -> None:
        if not len(self.time) == len(self.position) == len(self.current) > 1:
            raise ValueError(
                f"command of {len(self.time)} times, {len(self.position)} positions, {len(self.current)} currents: "
                "expected equally many of each, at least 2"
            )
        if not all(np.isfinite(series).all() for series in (self.time, self.position, self.current)):
            raise ValueError("command: expected finite numbers")
        if self.step > (1 + 1e-6) / LEAST_COMMAND_RATE or not np.allclose(
            np.diff(self.time), self.step, rtol=1e-3, atol=0.0
        ):
            raise ValueError(f"command: expected times equally spaced by at most 1/{LEAST_COMMAND_RATE:g} s")

    @property
    def step(self) -> float:
        """Sampling period in s."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))


@dataclass(frozen=True)
class TruePlant:
    """A damper in its rig.

    Attributes
    ----------
    form : str
        Id of its damper form.
    parameters : mapping
        Parameters of the form; nominal where left out.
    effects : mapping
        Parameters of each effect, by id.
    formulas : mapping
        Id of the formula of an effect, the first one where left out; may name further effects.
    """

    form: str
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    formulas: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class RunDeviation:
    """Scatter of one run, by which it differs from other runs of the same plant.

    Attributes
    ----------
    gain : float
        Factor of the damper's force.
    offset : float
        Offset of the load cell in N.
    phase : float
        Phase of the mains in turns at the start of the run; nobody starts a run at a fixed phase.
    """

    gain: float
    offset: float
    phase: float


def draw_scatter(instruments: TrueInstruments, rng: np.random.Generator, runs: int) -> list[RunDeviation]:
    """Return the scatter of the runs that `record` makes with a generator in the same state."""
    return [scatter for scatter, _ in _draw_runs(instruments, rng, runs)]


def record(
    plant: TruePlant, commands: Sequence[BenchCommand], instruments: TrueInstruments, rng: np.random.Generator
) -> list[Readings]:
    """Record the runs of one session in order, with a pause of 30 s between them.

    Heat, the settled fluid, magnetisation and the load cell's drift carry over from run to run. Noise and scatter are drawn
    independently of the plant, so that plants that differ by an effect differ by nothing else.

    Parameters
    ----------
    plant : TruePlant
    commands : sequence of BenchCommand
    instruments : TrueInstruments
    rng : numpy Generator
        Its state alone decides on noise and scatter.

    Raises
    ------
    ValueError
        When a form, effect, formula or parameter is unknown.
    """
    p = plant_values(plant.form, plant.parameters, plant.effects, plant.formulas)
    series = has_series_element(plant.form, plant.effects)
    slow, magnetic, clock = rested_state(), MagneticMemory(), 0.0
    recorded = []
    for command, (scatter, streams) in zip(commands, _draw_runs(instruments, rng, len(commands)), strict=True):
        step = command.step
        time: Array = step * np.arange(len(command.time), dtype=float)
        shown, rod, current, acting = _driven(p, command, scatter.phase, magnetic)
        force = damper_force(p, rod[0], rod[1], acting, step, scatter.gain, series, slow) + inertia_force(p, *rod, step)
        force = force_channel(p, force, shown, current, clock, time, step) + scatter.offset
        position = transducer_reading(p, sticking_reading(p, shown))
        channels = position, current_reading(p, clock + time, current), rod[2], force
        recorded.append(_read(p, instruments, streams, step, channels, scatter.phase))
        clock += len(force) * step + REST
        store_heat(p, slow[: FLUID_HEAT + 1], 0.0, REST)
        slow[STRUCTURE] = rebuilt_structure(p, slow[STRUCTURE], 0.0, REST)
    return recorded


def _draw_runs(
    instruments: TrueInstruments, rng: np.random.Generator, runs: int
) -> list[tuple[RunDeviation, list[np.random.Generator]]]:
    """Return the scatter of each run, and the generators of its noise: time, position, current, acceleration, force."""
    drawn = []
    for run_rng in rng.spawn(runs):
        scatter, *streams = run_rng.spawn(6)
        gain, offset, phase = scatter.normal(), scatter.normal(), scatter.uniform()
        drawn.append(
            (RunDeviation(1.0 + instruments.gain_scatter * gain, instruments.offset_scatter * offset, phase), streams)
        )
    return drawn


@dataclass
class MagneticMemory:
    """What coil and iron remember from run to run; nan before the first one."""

    coil: Array = field(default_factory=lambda: np.full(3, np.nan))
    iron: Array = field(default_factory=lambda: np.full(2, np.nan))


def _driven(
    p: PlantValues, command: BenchCommand, phase: float, magnetic: MagneticMemory
) -> tuple[Array, tuple[Array, Array, Array], Array, Array]:
    """Return the encoder's position, the rod's position, velocity and acceleration, the current and the acting current."""
    step = command.step
    if command.exact:
        path = CubicSpline(np.arange(len(command.time)) * step, command.position)
        shown, velocity, acceleration = command.position, path(path.x, 1), path(path.x, 2)
        current = command.current
    else:
        shown, velocity, acceleration = followed_command(command.position, step)
        current = lagged(SUPPLY_LAG, command.current, step)
    rod = (shown, velocity, acceleration)
    if p.servo_ripple_amplitude > 0.0:
        rod = rippled_motion(p, *rod)
    acting = lagged_current(p, rippling_current(p, current, step, phase), step, magnetic.coil)
    return shown, rod, current, saturated_current(p, remanent_current(p, acting, magnetic.iron))


def followed_command(command: Array, step: float) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a drive of second order from rest, exactly for a polygon of commands."""
    w = 2 * np.pi * SERVO_FREQUENCY
    denominator = [1.0, 2 * SERVO_DAMPING * w, w * w]
    motion = []
    for numerator in ([w * w], [w * w, 0.0], [w * w, 0.0, 0.0]):
        b, a, _ = cont2discrete((numerator, denominator), step, method="foh")
        motion.append(np.asarray(lfilter(np.ravel(b), a, command - command[0])))
    return motion[0] + command[0], motion[1], motion[2]


def force_channel(
    p: PlantValues, force: Array, position: Array, current: Array, clock: float, time: Array, step: float
) -> Array:
    """Return the output of the force channel, from the force on the cell: cell, wires and converter act in this order."""
    force = overloaded_reading(p, ringing_force(p, force, step)) * drifting_gain(p, clock + time)
    force = lagged_force(p, force + drift_force(p, clock + time), step)
    return delayed_force(p, time, force + leaking_force(p, position, current, step))


def _read(
    p: PlantValues,
    instruments: TrueInstruments,
    streams: Sequence[np.random.Generator],
    step: float,
    channels: tuple[Array, Array, Array, Array],
    phase: float,
) -> Readings:
    """Sample position, current, acceleration and force at the same jittered times, and add the noise of each and the hum.

    The hum is picked up by the converter, so readings hold its full size at every rate.
    """
    samples = int(((len(channels[0]) - 1) * step) * instruments.rate * (1 + 1e-9)) + 1
    time = np.arange(samples) / instruments.rate
    jitter = instruments.jitter * streams[0].standard_normal(samples)
    noises = instruments.position, instruments.current, instruments.acceleration, instruments.force
    position, current, acceleration, force = (
        sample_signal(instruments, time, jitter, step, signal) + noise * stream.standard_normal(samples)
        for signal, noise, stream in zip(channels, noises, streams[1:], strict=True)
    )
    return Readings(time, position, current, acceleration, force + hum(p, time + jitter, phase))
