"""A plant, what the bench commands, and what is recorded."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter

from mrd_trials.truth.effects.absent import overloaded_reading, ringing_force, sticking_reading
from mrd_trials.truth.effects.coil import acting_current
from mrd_trials.truth.effects.drive import rippled_motion
from mrd_trials.truth.effects.sensing import MAINS, lagged, transducer_reading
from mrd_trials.truth.effects.true_effect import PlantValues
from mrd_trials.truth.instruments import Readings, TrueInstruments, sample_signal
from mrd_trials.truth.integration import HEAT, STRUCTURE, damper_force, has_series_element, plant_values

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
    """

    form: str
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


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
        When a form, effect or parameter is unknown.
    """
    p = plant_values(plant.form, plant.parameters, plant.effects)
    series = has_series_element(plant.form, plant.effects)
    slow, memory, clock = np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0
    recorded = []
    for command, (scatter, streams) in zip(commands, _draw_runs(instruments, rng, len(commands)), strict=True):
        step = command.step
        shown, rod, current, acting = _driven(p, command, scatter.phase, memory)
        force = damper_force(p, rod[0], rod[1], acting, step, scatter.gain, series, slow)
        force = _force_channel(p, force + p.moving_mass_mass * rod[2], shown, current, clock, step) + scatter.offset
        position = shown if p.sensor_stiction_slack == 0.0 else sticking_reading(shown, p.sensor_stiction_slack)
        position = transducer_reading(p.lvdt_nonlinearity_cubic, p.lvdt_nonlinearity_gain, position)
        current_reading = (1.0 + p.current_sensor_error_gain) * current + p.current_sensor_error_offset
        hum = p.mains_hum_amplitude, scatter.phase
        recorded.append(_read(instruments, streams, step, position, current_reading, rod[2], force, hum))
        clock += len(force) * step + REST
        if p.thermal_fade_fade > 0.0:
            slow[HEAT] *= np.exp(-REST / p.thermal_fade_cooling_time)
        if p.thixotropy_weakening > 0.0:
            slow[STRUCTURE] = 1.0 - (1.0 - slow[STRUCTURE]) * np.exp(-REST / p.thixotropy_recovery)
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


def _driven(
    p: PlantValues, command: BenchCommand, phase: float, memory: Array
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
        rod = rippled_motion(p.servo_ripple_amplitude, p.servo_ripple_phase, *rod)
    acting = current
    if p.supply_ripple_share > 0.0:
        turns = p.supply_ripple_frequency * step * np.arange(len(current)) + phase
        acting = current * (1.0 + p.supply_ripple_share * np.sin(2 * np.pi * turns))
    return shown, rod, current, acting_current(p, acting, step, memory)


def followed_command(command: Array, step: float) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a drive of second order from rest, exactly for a polygon of commands."""
    w = 2 * np.pi * SERVO_FREQUENCY
    denominator = [1.0, 2 * SERVO_DAMPING * w, w * w]
    motion = []
    for numerator in ([w * w], [w * w, 0.0], [w * w, 0.0, 0.0]):
        b, a, _ = cont2discrete((numerator, denominator), step, method="foh")
        motion.append(np.asarray(lfilter(np.ravel(b), a, command - command[0])))
    return motion[0] + command[0], motion[1], motion[2]


def _force_channel(p: PlantValues, force: Array, position: Array, current: Array, clock: float, step: float) -> Array:
    """Return the output of the force channel, from the force on the cell: cell, wires and converter act in this order."""
    time = np.arange(len(force)) * step
    force = ringing_force(p.frame_resonance_share, p.frame_resonance_frequency, p.frame_resonance_damping, force, step)
    if p.cell_overload_overload > 0.0:
        force = overloaded_reading(p.cell_overload_overload, force)
    force = lagged(p.force_sensor_lag_lag, force + p.load_cell_drift_drift * (clock + time), step)
    force = force + p.channel_crosstalk_from_position * position + p.channel_crosstalk_from_current * current
    return np.interp(time - p.channel_delay_delay, time, force) if p.channel_delay_delay > 0.0 else force


def _read(
    instruments: TrueInstruments,
    streams: Sequence[np.random.Generator],
    step: float,
    position: Array,
    current: Array,
    acceleration: Array,
    force: Array,
    hum: tuple[float, float],
) -> Readings:
    """Sample all channels at the same jittered times, and add the noise of each channel and the hum of the force channel.

    The ``hum`` (amplitude in N, phase in turns) is picked up by the converter, so readings hold its full size at every rate.
    """
    samples = int(((len(force) - 1) * step) * instruments.rate * (1 + 1e-9)) + 1
    time = np.arange(samples) / instruments.rate
    jitter = instruments.jitter * streams[0].standard_normal(samples)

    def read(signal: Array, deviation: float, stream: np.random.Generator) -> Array:
        return sample_signal(instruments, time, jitter, step, signal) + deviation * stream.standard_normal(samples)

    amplitude, phase = hum
    mains = amplitude * np.sin(2 * np.pi * (MAINS * (time + jitter) + phase))
    return Readings(
        time,
        read(position, instruments.position, streams[1]),
        read(current, instruments.current, streams[2]),
        read(acceleration, instruments.acceleration, streams[3]),
        read(force, instruments.force, streams[4]) + mains,
    )
