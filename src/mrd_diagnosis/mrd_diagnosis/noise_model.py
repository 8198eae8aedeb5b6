"""The noise floor: how far measured and modelled force may differ though the model is true.

Two parts, for every sample. The force sensor's own noise, which is white or has passed a first-order filter. And errors of
the measured motion and current (errors in variables), which the model turns into force: large where the rod reverses and
where the current switches, so they are drawn and sent through the model. No noise is larger than the residual itself.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import lfilter
from scipy.spatial import cKDTree

from mrd_diagnosis.diagnosis import RunNoise
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, consecutive_forces
from mrd_runs import Run
from mrd_runs.signals.current import current_noise, normal_deviation, steady_current
from mrd_runs.signals.motion import between_samples, divided, finer, motion_errors
from mrd_runs.signals.smoothed_run import SmoothedRun
from mrd_sim.models import DamperModel
from mrd_sim.path import Path, make_path, pieces

Array = NDArray[np.float64]

_STRETCH = 32
"""Samples over which noise is estimated at a time: fewer than between two reversals, mostly."""
_ALIKE = 0.005
"""Motions and currents that differ by less than this share of their span (rms), noise aside, are the same."""

_FINE = 250.0
"""Hz; what happens between samples that come faster does not matter."""

_COIL, _APART = 0.02, 8
"""s, a usual lag of coils; samples after which a sensor's noise has forgotten itself."""
_LEAST = 1e-6
"""Of the largest force; no reading is better."""
_REDDEST = 0.8
"""Largest 2ρ/(1 + ρ²) that a spectrum is taken to say of noise: ρ = 0.5. What falls off faster is left by the model."""


def estimate_noise(
    recordings: Sequence[Recording], model: DamperModel, theta: Array, rng: np.random.Generator, *, draws: int = 12
) -> list[RunNoise]:
    """Noise floor of every run.

    Parameters
    ----------
    recordings : sequence of Recording
        Their paths may hold the measured current or the steady one.
    model : DamperModel
    theta : ndarray (parameters,)
        Near enough the truth that it turns errors of the motion into like errors of the force.
    rng : numpy Generator
    draws : int
        Errors of motion and current drawn for each run.

    Returns
    -------
    list of RunNoise
        The force sensor's part is taken from runs that repeat each other, else from the periods of a run, else from its
        residual: from its high frequencies, or from how much it differs at like states.
    """
    of_runs = list(zip(recordings, rng.spawn(len(recordings)), strict=True))
    carried = in_threads(lambda each: _carried(each[0], model, theta, each[1], draws), of_runs)
    modelled = consecutive_forces(model, theta, recordings)
    residuals = [recording.force - force for recording, force in zip(recordings, modelled, strict=True)]
    found = []
    for index, recording in enumerate(recordings):
        residual, errors = _without_own(residuals[index], recording.force), carried[index]
        variance, source = _scatter(index, recordings, residuals, carried)
        if not source:
            # What the model left adds to either, so the smaller one is nearer the truth.
            variance = min(_high_frequencies(residual, errors), _like_states(recording, residual))
            source = "residual"
        variance = min(max(variance, _step(recording.force) ** 2 / 12), float(np.mean(residual**2)))
        # Something, also without any noise: what counts is divided by it.
        variance = max(variance, (_LEAST * float(np.abs(recording.force).max())) ** 2, np.finfo(float).tiny)
        errors = _at_most(_without_dips(errors), residual, variance)
        sigma = np.sqrt(variance + errors)
        found.append(RunNoise(sigma, float(np.sqrt(variance)), float(np.sqrt(errors.mean())), source))
    return found


# --- errors of motion and current


def _carried(recording: Recording, model: DamperModel, theta: Array, rng: np.random.Generator, draws: int) -> Array:
    """Variance in N² of the model's force due to errors of motion and current, at the counted samples."""
    run = recording.run
    coarse = _parts(recording.smoothed)
    # The same vertices as without errors, or what differs by them would count as one.
    parts = np.maximum(coarse, pieces(run)) if model.follows_force else np.full(len(run) - 1, coarse)
    time, moved = finer(run.time, parts), between_samples(run.time, recording.motion, parts)
    drawn_at, places = finer(run.time, coarse), divided(len(run), parts)
    used = recording.path.current[recording.path.samples]
    level = recording.smoothed.current
    switches = _switches(level, current_noise(run.current))
    of_current = _current_errors(run, level, not np.array_equal(used, run.current), rng, draws)
    expected = model.force(theta, recording.path)
    squares, larger = np.zeros(len(run)), finer(_rounding(recording.smoothed), parts)
    for *drawn, error in zip(*motion_errors(run.time, recording.motion, rng, draws, coarse), of_current, strict=True):
        wrong = tuple(true + larger * np.interp(time, drawn_at, of) for true, of in zip(moved, drawn, strict=True))
        current, at = _between(used + error, switches, parts, rng)
        path = _switched_path(time, wrong, current, at, rng)
        path = replace(path, samples=path.samples[places], mains=recording.path.mains)
        squares += (model.force(theta, path) - expected) ** 2
    return squares[recording.counted] / draws


def _parts(smoothed: SmoothedRun) -> int:
    """Into how many parts a sampling interval is divided: one where the motion hardly changes meanwhile."""
    run, moved = smoothed.run, smoothed.motion
    if moved.position_noise == 0.0:
        return 1
    return max(1, min(int(np.ceil(2.0 / (run.rate * moved.time_constant))), int(_FINE / run.rate)))


def _between(
    current: Array, switches: NDArray[np.intp], parts: NDArray[np.intp], rng: np.random.Generator
) -> tuple[Array, NDArray[np.intp]]:
    """A current between its samples, its intervals `divided`, and after which instants it switches there."""
    found, places = finer(current, parts), divided(len(current), parts)
    at = places[switches] + rng.integers(parts[switches])
    for start, place, end in zip(places[switches], at, places[switches + 1], strict=True):
        found[start : place + 1] = found[start]
        found[place + 1 : end] = found[end]
    return found, at


def _rounding(smoothed: SmoothedRun) -> Array:
    """Factor by which a smoothed motion errs more than its model says: at corners of the motion, which it rounds.

    There the readings stay to one side of it. In trials the velocity then was wrong by 2.5 standard deviations for each one
    of the readings' mean.
    """
    run, moved = smoothed.run, smoothed.motion
    if moved.position_noise == 0.0:
        return np.ones(len(run))
    length = int(np.clip(2.0 * moved.time_constant * run.rate, 3, len(run)))
    aside = np.convolve((run.position - moved.position) / moved.position_noise, np.full(length, length**-0.5), "same")
    peak = maximum_filter1d(np.abs(aside), 2 * length + 1)
    # 0.6745: median of the absolute value of a standard normal variable.
    return np.where(peak > 4.0 * np.median(np.abs(aside)) / 0.6745, np.maximum(2.5 * peak, 1.0), 1.0)


def _current_errors(run: Run, level: Array, averaged: bool, rng: np.random.Generator, draws: int) -> Array:
    """Errors in A (draws, n) of a measured current, or of what `steady_current` makes of it."""
    errors = rng.normal(0.0, current_noise(run.current), (draws, len(run)))
    if not averaged or not errors.any():
        return errors
    # Averaging takes longer than the model does: a few of them serve for all draws.
    few = np.array([steady_current(level + error) - level for error in errors[:3]])
    signs = rng.choice([-1.0, 1.0], draws)
    return np.asarray(few[np.arange(draws) % len(few)] * signs[:, None])


def _without_dips(variance: Array) -> Array:
    """Variances from a few draws scatter: their neighbours help, but must not wear down a peak."""
    return np.maximum(variance, np.convolve(np.pad(variance, 2, mode="edge"), np.full(5, 0.2), "valid"))


def _switches(current: Array, noise: float) -> NDArray[np.intp]:
    """Samples after which the current jumps: by more than noise and far more than before and after."""
    change = np.abs(np.diff(current))
    padded = np.pad(change, 1)
    beside = np.maximum(padded[:-2], padded[2:])
    return np.flatnonzero(change > 3.0 * beside + max(6.0 * noise, 1e-3))


def _switched_path(
    time: Array, moved: tuple[Array, Array, Array], current: Array, switches: NDArray[np.intp], rng: np.random.Generator
) -> Path:
    """The path with the current switching at once, no one knows when between the two samples, instead of ramping."""
    if not len(switches):
        return make_path(time, *moved, current)
    # Two instants a thousandth of the interval apart, with the motion between the samples.
    fraction = np.repeat(rng.uniform(0.0, 0.999, len(switches)), 2) + np.tile([0.0, 0.001], len(switches))
    before = np.repeat(switches, 2)
    step = time[before + 1] - time[before]

    def insert(series: Array, values: Array) -> Array:
        return np.insert(series, before + 1, values)

    position, velocity, acceleration = moved
    h, x, v = fraction, position[before], velocity[before]
    x_after, v_after = position[before + 1], velocity[before + 1]
    between = (
        (1 + 2 * h) * (1 - h) ** 2 * x
        + h * (1 - h) ** 2 * step * v
        + h**2 * (3 - 2 * h) * x_after
        + h**2 * (h - 1) * step * v_after
    )
    path = make_path(
        insert(time, time[before] + h * step),
        insert(position, between),
        insert(velocity, (1 - h) * v + h * v_after),
        insert(acceleration, (1 - h) * acceleration[before] + h * acceleration[before + 1]),
        insert(current, current[before + np.tile([0, 1], len(switches))]),
    )
    measured = np.insert(np.ones(len(time), dtype=bool), before + 1, False)
    return replace(path, samples=path.samples[measured])


def _at_most(errors: Array, residual: Array, variance: float) -> Array:
    """Scale errors down where even the residual is smaller: in groups of samples with like errors."""
    scaled = errors.copy()
    order = np.argsort(errors, kind="stable")
    for group in np.array_split(order, min(10, max(len(order) // 50, 1))):
        left = max(float(np.mean(residual[group] ** 2)) - variance, 0.0)
        scaled[group] *= min(1.0, left / max(float(errors[group].mean()), 1e-300))
    return scaled


def _without_own(residual: Array, force: Array) -> Array:
    """Residual of a run without offset and gain of its own."""
    columns = np.stack([np.ones_like(force), force - force.mean()], axis=1)
    return np.asarray(residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])


# --- the force sensor


def _scatter(
    index: int, recordings: Sequence[Recording], residuals: Sequence[Array], carried: Sequence[Array]
) -> tuple[float, str]:
    """Variance of the force sensor from what does not repeat, and whether runs or periods do; "" where none do."""
    found = [
        _of_repeat(recordings, residuals, carried, index, other)
        for other in range(len(recordings))
        if other != index and _repeats(recordings[index].smoothed, recordings[other].smoothed)
    ]
    if found:
        return float(np.median(found)), "repeats"
    recording = recordings[index]
    period = repeating_period(recording.smoothed)
    if period and len(residuals[index]) > 2 * period * recording.run.rate:
        return _of_periods(recording, residuals[index], carried[index], period), "periods"
    return 0.0, ""


def _repeats(smoothed: SmoothedRun, again: SmoothedRun) -> bool:
    """Whether two runs, not one, have the same motion and current at the same times."""
    run, other = smoothed.run, again.run
    if len(run) != len(other) or np.abs(run.time - other.time).max() > 0.1 / run.rate:
        return False
    if np.array_equal(run.force, other.force):
        return False
    noise = current_noise(run.current)
    return _same(run.current, other.current, noise, np.abs(run.current).max()) and _same(
        smoothed.motion.position, again.motion.position, smoothed.motion.position_noise, np.ptp(run.position)
    )


def _same(series: Array, other: Array, noise: float, span: float) -> bool:
    return bool(np.sqrt(np.mean((series - other) ** 2)) < _ALIKE * span + 2.0 * noise)


def _of_repeat(
    recordings: Sequence[Recording], residuals: Sequence[Array], carried: Sequence[Array], index: int, other: int
) -> float:
    one, two = recordings[index].counted, recordings[other].counted
    common = range(max(one.start, two.start), min(one.stop, two.stop))
    a, b = (slice(common.start - counted.start, common.stop - counted.start) for counted in (one, two))
    difference = _without_own(residuals[index][a] - residuals[other][b], recordings[index].force[a])
    return _typical(difference, carried[index][a] + carried[other][b]) / 2


def repeating_period(smoothed: SmoothedRun) -> float | None:
    """Period in s after which motion and current of a run repeat, three times at least; None where they do not."""
    run, moved = smoothed.run, smoothed.motion
    n, interval = len(run), float(np.median(np.diff(run.time)))
    if n < 3 * _STRETCH or np.abs(np.diff(run.time) - interval).max() > 0.1 * interval:
        return None
    position = moved.position - moved.position.mean()
    lags = np.arange(1, n // 3 + 1)
    spectrum = np.fft.rfft(position, 2 * n)
    together = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[lags]
    total = np.cumsum(position**2)
    # Mean square of x(t + lag) - x(t).
    change = (total[n - 1 - lags] + total[-1] - total[lags - 1] - 2 * together) / (n - lags)
    tolerance = (_ALIKE * float(np.ptp(position)) + 2.0 * moved.position_noise) ** 2
    rises = np.flatnonzero(change > float(np.var(position)))
    noise = current_noise(run.current)
    for k in range(int(rises[0]) if len(rises) else n, len(lags) - 1):
        if change[k] <= min(change[k - 1], change[k + 1], tolerance):
            lag = int(lags[k])
            if _same(run.current[lag:], run.current[:-lag], noise, np.abs(run.current).max()):
                left, middle, right = change[k - 1 : k + 2]
                return interval * (lag + 0.5 * float(left - right) / float(left - 2 * middle + right))
    return None


def _of_periods(recording: Recording, residual: Array, carried: Array, period: float) -> float:
    """Half the variance of what changes from period to period, drift of offset and gain aside."""
    samples = period / float(np.median(np.diff(recording.run.time)))
    whole, fraction = int(samples), samples - int(samples)

    def later(series: Array) -> Array:
        return (1 - fraction) * series[whole:-1] + fraction * series[whole + 1 :]

    difference = later(residual) - residual[: -whole - 1]
    force, errors = recording.force[: -whole - 1], later(carried) + carried[: -whole - 1]
    # Interpolation averages white noise.
    return _typical(_without_own(difference, force), errors) / (1 + (1 - fraction) ** 2 + fraction**2)


def _typical(difference: Array, errors: Array) -> float:
    """Variance of a difference, that of its errors of motion and current taken off, where these are small."""
    calm = errors <= np.median(errors)
    return max(normal_deviation(difference[calm]) ** 2 - float(np.mean(errors[calm])), 0.0)


def _like_states(recording: Recording, residual: Array) -> float:
    """Half the variance of the residual's difference between a sample and the one of most alike motion and current.

    What a model misses mostly depends on the state, so that it cancels (Stefánsson, Končar and Jones 1997).
    """
    run, moved = recording.run, recording.motion
    turns = np.flatnonzero(moved.velocity[1:] * moved.velocity[:-1] < 0) + 1
    last = np.zeros(len(run), dtype=int)
    last[turns] = turns
    travel = np.abs(moved.position - moved.position[np.maximum.accumulate(last)])
    current = recording.smoothed.current
    keep = np.exp(-1.0 / (run.rate * _COIL))
    lagged = lfilter([1 - keep], [1, -keep], current, zi=[keep * current[0]])[0]
    # Right after a turn the hysteresis changes fastest, hence the root; the current acts most.
    features = [moved.position, moved.velocity, moved.acceleration, np.sqrt(travel), 2 * current, 2 * lagged]
    spreads = [float(np.std(feature)) for feature in features[:-2]] + [float(np.std(current))] * 2
    scales = [spread if spread > 1e-9 * np.abs(f).max() else np.inf for f, spread in zip(features, spreads, strict=True)]
    states = np.stack([f / scale for f, scale in zip(features, scales, strict=True)], axis=1)[recording.counted]
    # Not a neighbour in time: its noise may not be independent.
    some = np.unique(np.linspace(0, len(states) - 1, 2000).astype(int))
    distance, like = cKDTree(states).query(states[some], k=min(3 * _APART, len(states)))
    apart = np.abs(like - some[:, None]) > _APART
    first = np.argmax(apart, axis=1)
    rows = np.flatnonzero(apart.any(axis=1))
    if len(rows) < 20:
        return float(np.mean(residual**2))
    near = rows[distance[rows, first[rows]] <= np.median(distance[rows, first[rows]])]
    return normal_deviation(residual[some[near]] - residual[like[near, first[near]]]) ** 2 / 2


def _stretches(series: Array) -> Array:
    """Half overlapping stretches (m, _STRETCH)."""
    length = min(_STRETCH, len(series))
    return np.lib.stride_tricks.sliding_window_view(series, length)[:: length // 2]


def _calm(errors: Array) -> NDArray[np.bool_]:
    """Which stretches have no more than their median of errors."""
    means = _stretches(errors).mean(axis=1)
    return np.asarray(means <= np.median(means))


def _high_frequencies(residual: Array, errors: Array) -> float:
    """Variance of the noise in a residual from the upper half of its spectrum, where models leave little.

    The noise is white or has passed a first-order filter: 1/S is then a line over cos ω (first-order autoregression).
    """
    stretches = _stretches(residual)[_calm(errors)]
    length = stretches.shape[1]
    line = np.vander(np.linspace(-1.0, 1.0, length), 2)
    window = np.hanning(length + 2)[1:-1]
    spectra = np.abs(np.fft.rfft((stretches - stretches @ (line @ np.linalg.pinv(line))) * window)) ** 2
    upper = np.arange(length // 4, (length - 1) // 2 + 1)
    # Median over stretches, as reversals are outliers; that of an exponential distribution is log 2.
    density = np.median(spectra[:, upper], axis=0) / (np.log(2.0) * np.sum(window**2))
    if not density.all():
        return 0.0
    # 1/S = level - slope cos ω, and of a first-order autoregression slope/level = 2ρ/(1 + ρ²).
    regressors = np.stack([np.ones(len(upper)), -np.cos(2 * np.pi * upper / length)], axis=1)
    level, slope = np.linalg.lstsq(regressors * density[:, None], np.ones(len(upper)), rcond=None)[0]
    ratio = slope / level
    if ratio <= 0:
        return float(density.mean())
    ratio = min(ratio, _REDDEST)
    correlation = (1 - np.sqrt(1 - ratio**2)) / ratio
    shape = (1 + correlation**2) * (1 - ratio * np.cos(2 * np.pi * upper / length))
    return float(np.mean(density * shape) / (1 - correlation**2))


def _step(series: Array) -> float:
    """Step of the digits of a reading; 0 where it has none."""
    gaps = np.diff(np.unique(series))
    gaps = gaps[gaps > 1e-9 * np.abs(series).max(initial=1e-300)]
    if not len(gaps):
        return 0.0
    step = float(gaps.min())
    return step if np.mean(np.abs(gaps / step - np.round(gaps / step)) < 0.05) > 0.95 else 0.0
