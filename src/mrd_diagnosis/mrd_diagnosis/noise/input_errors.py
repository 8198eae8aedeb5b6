"""Errors of the measured motion and current, propagated through the model: they are large where the rod reverses and where
the current switches, so they are drawn at random and the force is computed with them. A force that jumps between two samples
is a further one: a reading holds a mean of some time before it, and the model gives the force of the instant.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from mrd_identification.recording import Recording
from mrd_runs.signals.current import current_noise, draw_current_noise
from mrd_runs.signals.motion import motion_between_samples, motion_errors, subdivide, subdivided_indices
from mrd_runs.signals.smoothed_run import SmoothedRun
from mrd_sim.models import DamperModel
from mrd_sim.path import Path, make_path, pieces

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

HIGHEST_RATE = 250.0
"""Rate in Hz up to which errors between the samples are drawn; what happens between faster samples does not matter."""

ERROR_AT_CORNERS = 2.5
"""Standard deviations by which the velocity was wrong at corners of the motion in simulated runs, for each standard
deviation of the readings' mean deviation from the smoothed motion.
"""

CORNER = 4.0
"""Standard deviations of that mean deviation above which a corner is assumed."""

MEDIAN_OF_ABSOLUTE_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""

LEAST_SWITCH = 2e-3
"""Change of current from one sample to the next, over the largest current, below which the coil is not switched."""

PARTS_OF_READING = 4
"""Parts of a sampling interval in which the force is computed to see how it changes within a reading."""

WIDTH_OF_SWITCH = 1e-3
"""Share of the sampling interval within which a switched current changes."""


def propagated_variance(
    recording: Recording,
    model: DamperModel,
    theta: Array,
    rng: np.random.Generator,
    draws: int,
    within_readings: bool = True,
) -> Array:
    """Return the variance in N² of the model's force by errors of motion and current, at the counted samples; with
    ``within_readings`` also by what it does within a reading.
    """
    run, smoothed = recording.run, recording.smoothed
    # What a simulator has beyond the model is the same on all paths, and the disturbed ones do not have it.
    model = replace(model, stands_for="")
    coarse = _error_subdivisions(smoothed)
    # Both forces need the same vertices; otherwise their difference would count as an error.
    parts = np.maximum(coarse, pieces(run)) if model.follows_force else np.full(len(run) - 1, coarse)
    time, motion = subdivide(run.time, parts), motion_between_samples(run.time, recording.motion, parts)
    error_time, places = subdivide(run.time, coarse), subdivided_indices(len(run), parts)
    used = recording.path.current[recording.path.samples]
    switches = _switches(smoothed.current, current_noise(run.current))
    current_errors = _current_errors(smoothed, not np.array_equal(used, run.current), rng, draws)
    expected = model.force(theta, recording.path)
    squares, factor = np.zeros(len(run)), subdivide(_error_factor(smoothed), parts)
    for *drawn, error in zip(*motion_errors(run.time, recording.motion, rng, draws, coarse), current_errors, strict=True):
        position, velocity, acceleration = (
            true + factor * np.interp(time, error_time, series) for true, series in zip(motion, drawn, strict=True)
        )
        current, instants = _subdivided_current(used + error, switches, parts, rng)
        path = _switched_path(time, (position, velocity, acceleration), current, instants, rng)
        path = replace(path, samples=path.samples[places], mains=recording.path.mains).as_warm_as(recording.path)
        path = path.led_in(recording.path.lead_in)
        squares += recording.as_recorded(model.force(theta, path) - expected) ** 2
    variance: Array = squares / draws
    if within_readings:
        variance += recording.as_recorded(_change_within_reading(recording, model, theta, used)) ** 2
    return variance[recording.counted]


def _change_within_reading(recording: Recording, model: DamperModel, theta: Array, current: Array) -> Array:
    """Return by how much the mean of the model's force in N (n,) over the two intervals beside a sample differs from the one
    at the sample, where the rod reverses within them and the force jumps; at most by as much as it jumps.

    Converters average, filters lag, and where a force jumps at the reversal, the reading lies anywhere between both sides. A
    force that bends smoothly is no noise: what a model lacks there, such as a mass, has its evidence in it.
    """
    time, moving = recording.run.time, recording.motion.velocity
    reverses = np.append(moving[:-1] * moving[1:] <= 0.0, False)
    beside = reverses | np.roll(reverses, 1)
    motion = motion_between_samples(time, recording.motion, PARTS_OF_READING)
    path = make_path(subdivide(time, PARTS_OF_READING), *motion, subdivide(current, PARTS_OF_READING))
    path = replace(path, mains=recording.path.mains).as_warm_as(recording.path).led_in(recording.path.lead_in)
    force = model.force(theta, path)
    window = 2 * PARTS_OF_READING + 1
    change = (uniform_filter1d(force, window, mode="nearest") - force)[::PARTS_OF_READING]
    # It jumps where it changes by more in a part of a reading than in those one sample before and after.
    step = np.pad(np.abs(np.diff(force)), PARTS_OF_READING, mode="edge")
    around = np.maximum(step[: -2 * PARTS_OF_READING], step[2 * PARTS_OF_READING :])
    jump = np.append(np.maximum(step[PARTS_OF_READING:-PARTS_OF_READING] - around, 0.0), 0.0)
    jumps = maximum_filter1d(jump, window, mode="nearest")[::PARTS_OF_READING]
    return np.asarray(np.where(beside, np.clip(change, -jumps, jumps), 0.0))


def _error_subdivisions(smoothed: SmoothedRun) -> int:
    """Return into how many parts a sampling interval is divided: one where the motion hardly changes within it."""
    run, motion = smoothed.run, smoothed.motion
    if motion.position_noise == 0.0:
        return 1
    return max(1, min(int(np.ceil(2.0 / (run.rate * motion.time_constant))), int(HIGHEST_RATE / run.rate)))


def _subdivided_current(
    current: Array, switches: Indices, parts: Indices, rng: np.random.Generator
) -> tuple[Array, Indices]:
    """Return a current with its intervals divided, and the indices there after which it switches."""
    subdivided, places = subdivide(current, parts), subdivided_indices(len(current), parts)
    instants = places[switches] + rng.integers(parts[switches])
    for start, instant, end in zip(places[switches], instants, places[switches + 1], strict=True):
        subdivided[start : instant + 1] = subdivided[start]
        subdivided[instant + 1 : end] = subdivided[end]
    return subdivided, instants


def _error_factor(smoothed: SmoothedRun) -> Array:
    """Return the factor (n,) by which a smoothed motion errs more than its model says.

    The smoother rounds corners of the motion. The readings then stay on one side of the smoothed motion.
    """
    run, motion = smoothed.run, smoothed.motion
    if motion.position_noise == 0.0:
        return np.ones(len(run))
    length = int(np.clip(2.0 * motion.time_constant * run.rate, 3, len(run)))
    deviation = np.convolve((run.position - motion.position) / motion.position_noise, np.full(length, length**-0.5), "same")
    peak = maximum_filter1d(np.abs(deviation), 2 * length + 1)
    is_corner = peak > CORNER * np.median(np.abs(deviation)) / MEDIAN_OF_ABSOLUTE_NORMAL
    return np.where(is_corner, np.maximum(ERROR_AT_CORNERS * peak, 1.0), 1.0)


def _current_errors(smoothed: SmoothedRun, averaged: bool, rng: np.random.Generator, draws: int) -> Array:
    """Draw errors in A (draws, n) of a measured current; where it is ``averaged``, of the steady current."""
    if not averaged:
        return draw_current_noise(smoothed.run.current, rng, draws)
    errors = smoothed.current_errors
    return np.asarray(errors[np.arange(draws) % len(errors)] * rng.choice([-1.0, 1.0], draws)[:, None])


def _switches(current: Array, noise: float) -> Indices:
    """Return the samples after which the current jumps: by more than noise, and far more than before and after."""
    change = np.abs(np.diff(current))
    padded = np.pad(change, 1)
    neighbours = np.maximum(padded[:-2], padded[2:])
    return np.flatnonzero(change > 3.0 * neighbours + max(6.0 * noise, LEAST_SWITCH * float(np.abs(current).max())))


def _switched_path(
    time: Array, motion: tuple[Array, Array, Array], current: Array, switches: Indices, rng: np.random.Generator
) -> Path:
    """Make a path whose current switches at once instead of ramping, at an unknown instant between two samples."""
    if not len(switches):
        return make_path(time, *motion, current)
    # Two vertices close to each other are inserted, with the motion interpolated between the samples.
    fraction = np.repeat(rng.uniform(0.0, 1.0 - WIDTH_OF_SWITCH, len(switches)), 2)
    fraction += np.tile([0.0, WIDTH_OF_SWITCH], len(switches))
    before = np.repeat(switches, 2)
    step = time[before + 1] - time[before]

    def insert(series: Array, values: Array) -> Array:
        return np.insert(series, before + 1, values)

    position, velocity, acceleration = motion
    after = before + 1
    # The same cubic as in `mrd_sim.path.cubic_hermite`, in a form that rounds differently: published figures rest on it.
    h, x, v, x_after, v_after = fraction, position[before], velocity[before], position[after], velocity[after]
    interpolated = (
        (1 + 2 * h) * (1 - h) ** 2 * x
        + h * (1 - h) ** 2 * step * v
        + h**2 * (3 - 2 * h) * x_after
        + h**2 * (h - 1) * step * v_after
    )
    path = make_path(
        insert(time, time[before] + fraction * step),
        insert(position, interpolated),
        insert(velocity, (1 - fraction) * velocity[before] + fraction * velocity[after]),
        insert(acceleration, (1 - fraction) * acceleration[before] + fraction * acceleration[after]),
        insert(current, current[before + np.tile([0, 1], len(switches))]),
    )
    is_sample = np.insert(np.ones(len(time), dtype=bool), before + 1, False)
    return replace(path, samples=path.samples[is_sample])
