"""A plant, what it is made to do, and what is recorded of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter

from mrd_trials.truth.effects.absent import overloaded, ringing, stuck
from mrd_trials.truth.effects.coil import effective
from mrd_trials.truth.effects.declare import Values
from mrd_trials.truth.effects.drive import rippled
from mrd_trials.truth.effects.sensing import MAINS, lagged, transduced
from mrd_trials.truth.instruments import Instruments, Recorded, sampled
from mrd_trials.truth.integrator import HEAT, STRUCTURE, in_series, stepped, values

Array = NDArray[np.float64]

SLOWEST = 8000.0
"""Hz, that a motion must be given at."""

SERVO, DAMPING = 32.0, 0.8
"""Hz and share of critical, of the drive's position loop."""

SUPPLY = 3e-3
"""s, by which the supply lets the current follow its command."""

REST = 30.0
"""s between two recordings."""


@dataclass(frozen=True)
class Motion:
    """What drive and supply are commanded during one recording.

    Attributes
    ----------
    time : ndarray (samples,)
        s, equally spaced from 0 by at most 1/8000 s.
    position : ndarray (samples,)
        m from mid-stroke.
    current : ndarray (samples,)
        A.
    exact : bool
        Whether drive and coil do what is commanded, as for a recorded motion that is replayed; else they follow as they can.
    """

    time: Array
    position: Array
    current: Array
    exact: bool = False

    def __post_init__(self) -> None:
        if not len(self.time) == len(self.position) == len(self.current) > 1:
            raise ValueError(
                f"motion of {len(self.time)} times, {len(self.position)} positions, {len(self.current)} currents"
            )
        if not all(np.isfinite(each).all() for each in (self.time, self.position, self.current)):
            raise ValueError("motion: expected finite numbers")
        if self.step > (1 + 1e-6) / SLOWEST or not np.allclose(np.diff(self.time), self.step, rtol=1e-3, atol=0.0):
            raise ValueError(f"motion: expected times equally spaced by at most 1/{SLOWEST:g} s")

    @property
    def step(self) -> float:
        """s."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))


@dataclass(frozen=True)
class Plant:
    """A damper in its rig.

    Attributes
    ----------
    base : str
        Id of its form.
    parameters : mapping
        Of the form; nominal where left out.
    effects : mapping
        Parameters of each effect, by id.
    """

    base: str
    parameters: Mapping[str, float]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def record(plant: Plant, motions: Sequence[Motion], instruments: Instruments, rng: np.random.Generator) -> list[Recorded]:
    """Recordings of one session, in order, with 30 s of rest between them.

    Heat, the settled fluid, magnetisation and the load cell's drift carry over. Noise, run-to-run scatter and the phase of
    the mains are drawn apart, so that plants that differ by an effect differ by nothing else. A recording begins whenever
    someone starts it: mains hum has another phase in each.

    Parameters
    ----------
    plant : Plant
    motions : sequence of Motion
    instruments : Instruments
    rng : numpy Generator
        Its state alone decides on noise and scatter.

    Returns
    -------
    list of Recorded

    Raises
    ------
    ValueError
        For an unknown form, effect or parameter.
    """
    p = values(plant.base, plant.parameters, plant.effects)
    series = in_series(plant.base, plant.effects)
    slow, memory, clock = np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0
    found = []
    for motion, own in zip(motions, rng.spawn(len(motions)), strict=True):
        scatter, *streams = own.spawn(6)
        gain, offset, phase = scatter.normal(), scatter.normal(), scatter.uniform()
        step = motion.step
        shown, rod, current, acting = _driven(p, motion, phase, memory)
        gain = 1.0 + instruments.gain_scatter * gain
        force = stepped(p, rod[0], rod[1], acting, step, gain, series, slow)
        force = (
            _read(p, force + p.moving_mass_mass * rod[2], shown, current, clock, step) + instruments.offset_scatter * offset
        )
        position = shown if p.sensor_stiction_slack == 0.0 else stuck(shown, p.sensor_stiction_slack)
        position = transduced(p.lvdt_nonlinearity_cubic, p.lvdt_nonlinearity_gain, position)
        reading = (1.0 + p.current_sensor_error_gain) * current + p.current_sensor_error_offset
        hum = p.mains_hum_amplitude, phase
        found.append(_written(instruments, streams, step, position, reading, rod[2], force, hum))
        clock += len(force) * step + REST
        if p.thermal_fade_fade > 0.0:
            slow[HEAT] *= np.exp(-REST / p.thermal_fade_cooling_time)
        if p.thixotropy_weakening > 0.0:
            slow[STRUCTURE] = 1.0 - (1.0 - slow[STRUCTURE]) * np.exp(-REST / p.thixotropy_recovery)
    return found


def _driven(
    p: Values, motion: Motion, phase: float, memory: Array
) -> tuple[Array, tuple[Array, Array, Array], Array, Array]:
    """Position that the encoder shows; position, velocity and acceleration of the rod; current that flows, and that acts."""
    step = motion.step
    if motion.exact:
        path = CubicSpline(np.arange(len(motion.time)) * step, motion.position)
        shown, velocity, acceleration = motion.position, path(path.x, 1), path(path.x, 2)
        current = motion.current
    else:
        shown, velocity, acceleration = followed(motion.position, step)
        current = lagged(SUPPLY, motion.current, step)
    rod = (shown, velocity, acceleration)
    if p.servo_ripple_amplitude > 0.0:
        rod = rippled(p.servo_ripple_amplitude, p.servo_ripple_phase, *rod)
    acting = current
    if p.supply_ripple_share > 0.0:
        turns = p.supply_ripple_frequency * step * np.arange(len(current)) + phase
        acting = current * (1.0 + p.supply_ripple_share * np.sin(2 * np.pi * turns))
    return shown, rod, current, effective(p, acting, step, memory)


def followed(command: Array, step: float) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of a drive of second order, at rest at first; exact for a polygon of commands."""
    w = 2 * np.pi * SERVO
    denominator = [1.0, 2 * DAMPING * w, w * w]
    found = []
    for numerator in ([w * w], [w * w, 0.0], [w * w, 0.0, 0.0]):
        b, a, _ = cont2discrete((numerator, denominator), step, method="foh")
        b = np.ravel(b)
        moved = np.asarray(lfilter(b, a, command - command[0]))
        found.append(moved)
    return found[0] + command[0], found[1], found[2]


def _read(p: Values, force: Array, position: Array, current: Array, clock: float, step: float) -> Array:
    """Force channel as it leaves its amplifier, from the force on the cell: cell, wires, converter in this order."""
    time = np.arange(len(force)) * step
    force = ringing(p.frame_resonance_share, p.frame_resonance_frequency, p.frame_resonance_damping, force, step)
    if p.cell_overload_overload > 0.0:
        force = overloaded(p.cell_overload_overload, force)
    force = lagged(p.force_sensor_lag_lag, force + p.load_cell_drift_drift * (clock + time), step)
    force = force + p.channel_crosstalk_from_position * position + p.channel_crosstalk_from_current * current
    return np.interp(time - p.channel_delay_delay, time, force) if p.channel_delay_delay > 0.0 else force


def _written(
    instruments: Instruments,
    streams: Sequence[np.random.Generator],
    step: float,
    position: Array,
    current: Array,
    acceleration: Array,
    force: Array,
    hum: tuple[float, float],
) -> Recorded:
    """Sampled at one jittered time for all channels, with each channel's noise, and the mains' hum on the force.

    The ``hum`` (N, turns) is picked up by what converts, so that its size is what recordings hold of it at every rate.
    """
    samples = int(((len(force) - 1) * step) * instruments.rate * (1 + 1e-9)) + 1
    time = np.arange(samples) / instruments.rate
    jitter = instruments.jitter * streams[0].standard_normal(samples)

    def read(signal: Array, deviation: float, stream: np.random.Generator) -> Array:
        return sampled(instruments, time, jitter, step, signal) + deviation * stream.standard_normal(samples)

    amplitude, phase = hum
    mains = amplitude * np.sin(2 * np.pi * (MAINS * (time + jitter) + phase))
    return Recorded(
        time,
        read(position, instruments.position, streams[1]),
        read(current, instruments.current, streams[2]),
        read(acceleration, instruments.acceleration, streams[3]),
        read(force, instruments.force, streams[4]) + mains,
    )
