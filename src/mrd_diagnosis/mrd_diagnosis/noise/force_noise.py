"""Noise of the force sensor: estimated from runs that repeat each other, else from the periods of a run, else from its
residual.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial import cKDTree

from mrd_diagnosis.recordings.repetition import repeating_period, runs_repeat
from mrd_identification.low_pass import known_force_filter
from mrd_identification.recording import Recording
from mrd_runs.signals.current import normal_deviation

Array = NDArray[np.float64]

SEGMENT = 32
"""Samples of a segment whose spectrum is taken: mostly fewer than between two reversals."""

USUAL_COIL_LAG = 0.02
"""Usual lag in s of a coil."""

INDEPENDENT_AFTER = 8
"""Samples after which the noise of a sensor is independent."""

COMPARED_SAMPLES = 2000
"""Samples, at most, for which the sample of most similar state is looked up."""

LEAST_COMPARED = 20
"""Samples with an independent neighbour below which similar states say nothing."""

LARGEST_SPECTRAL_RATIO = 0.8
"""Largest 2ρ/(1 + ρ²) that is attributed to noise (ρ = 0.5). A spectrum that falls off faster is an error of the model."""


def force_noise_variance(
    index: int, recordings: Sequence[Recording], residuals: Sequence[Array], propagated: Sequence[Array]
) -> tuple[float, str]:
    """Estimate the variance in N² of the force sensor's noise in one run.

    Parameters
    ----------
    index : int
        Number of the run.
    recordings : sequence of Recording
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N.
    propagated : sequence of ndarray (counted samples,)
        Variance in N² of the errors of motion and current, propagated through the model.

    Returns
    -------
    variance : float
    source : str
        ``repeats``, ``periods`` or ``residual``.
    """
    recording = recordings[index]
    # Runs from before and after a change differ by more than noise.
    same_set = [other for other in range(len(recordings)) if recordings[other].without_effects == recording.without_effects]
    variances = [
        _variance_from_repeat(recordings, residuals, propagated, index, other)
        for other in same_set
        if other != index and runs_repeat(recording.smoothed, recordings[other].smoothed)
    ]
    if variances:
        return float(np.median(variances)), "repeats"
    period = repeating_period(recording.smoothed)
    if period and len(residuals[index]) > 2 * period * recording.rate:
        return _variance_from_periods(recording, residuals[index], propagated[index], period), "periods"
    residual = without_offset_and_gain(residuals[index], recording.force)
    # Behind a filter, only samples at twice the cut-off have nearly independent noise, and a spectrum that shows it.
    low_pass = known_force_filter(recording.run)
    stride = max(1, int(recording.rate / (2 * low_pass.cutoff))) if low_pass else 1
    from_spectrum = _variance_from_spectrum(residual[::stride], propagated[index][::stride])
    # Errors of the model add to both estimates, so the smaller one is nearer to the truth.
    return min(from_spectrum, _variance_from_similar_states(recording, residual, INDEPENDENT_AFTER * stride)), "residual"


def without_offset_and_gain(residual: Array, force: Array) -> Array:
    """Remove what an offset and a gain error of the force explain from a residual (n,) of a run."""
    columns = np.stack([np.ones_like(force), force - force.mean()], axis=1)
    return np.asarray(residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])


def _variance_from_repeat(
    recordings: Sequence[Recording], residuals: Sequence[Array], propagated: Sequence[Array], index: int, other: int
) -> float:
    """Return half the variance of the difference between a run and its repeat."""
    first, second = recordings[index].counted, recordings[other].counted
    common = range(max(first.start, second.start), min(first.stop, second.stop))
    a, b = (slice(common.start - counted.start, common.stop - counted.start) for counted in (first, second))
    difference = without_offset_and_gain(residuals[index][a] - residuals[other][b], recordings[index].force[a])
    return _variance_of_difference(difference, propagated[index][a] + propagated[other][b]) / 2


def _variance_from_periods(recording: Recording, residual: Array, propagated: Array, period: float) -> float:
    """Return half the variance of what changes from period to period, apart from a change of offset and gain."""
    samples = period / (recording.step * float(np.median(np.diff(recording.run.time))))
    whole, fraction = int(samples), samples - int(samples)

    def one_period_later(series: Array) -> Array:
        return (1 - fraction) * series[whole:-1] + fraction * series[whole + 1 :]

    difference = one_period_later(residual) - residual[: -whole - 1]
    force, errors = recording.force[: -whole - 1], one_period_later(propagated) + propagated[: -whole - 1]
    # Interpolation averages white noise.
    averaging = 1 + (1 - fraction) ** 2 + fraction**2
    return _variance_of_difference(without_offset_and_gain(difference, force), errors) / averaging


def _variance_of_difference(difference: Array, propagated: Array) -> float:
    """Return the variance of a difference (n,) minus the propagated one, from the samples where that one is small."""
    calm = propagated <= np.median(propagated)
    return max(normal_deviation(difference[calm]) ** 2 - float(np.mean(propagated[calm])), 0.0)


def _variance_from_similar_states(recording: Recording, residual: Array, independent_after: int) -> float:
    """Return half the variance of the residual's difference between samples of most similar motion and current.

    What a model lacks mostly depends on the state, so that it cancels (Stefánsson, Končar and Jones 1997).
    """
    run, motion = recording.run, recording.motion
    reversals = np.flatnonzero(motion.velocity[1:] * motion.velocity[:-1] < 0) + 1
    last = np.zeros(len(run), dtype=int)
    last[reversals] = reversals
    travel = np.abs(motion.position - motion.position[np.maximum.accumulate(last)])
    current = recording.smoothed.current
    keep = np.exp(-1.0 / (run.rate * USUAL_COIL_LAG))
    lagged = lfilter([1 - keep], [1, -keep], current, zi=[keep * current[0]])[0]
    # Hysteresis changes fastest right after a reversal, hence the root. The current acts most, hence the factors.
    features = [motion.position, motion.velocity, motion.acceleration, np.sqrt(travel), 2 * current, 2 * lagged]
    spreads = [float(np.std(feature)) for feature in features[:-2]] + [float(np.std(current))] * 2
    scales = [spread if spread > 1e-9 * np.abs(f).max() else np.inf for f, spread in zip(features, spreads, strict=True)]
    states = np.stack([f / scale for f, scale in zip(features, scales, strict=True)], axis=1)[recording.counted]
    compared = np.unique(np.linspace(0, len(states) - 1, COMPARED_SAMPLES).astype(int))
    distance, neighbours = cKDTree(states).query(states[compared], k=min(3 * independent_after, len(states)))
    # The noise of neighbours in time may not be independent.
    independent = np.abs(neighbours - compared[:, None]) > independent_after
    first = np.argmax(independent, axis=1)
    rows = np.flatnonzero(independent.any(axis=1))
    if len(rows) < LEAST_COMPARED:
        return float(np.mean(residual**2))
    near = rows[distance[rows, first[rows]] <= np.median(distance[rows, first[rows]])]
    return normal_deviation(residual[compared[near]] - residual[neighbours[near, first[near]]]) ** 2 / 2


def _segments(series: Array) -> Array:
    """Return half-overlapping segments (m, SEGMENT)."""
    length = min(SEGMENT, len(series))
    return np.lib.stride_tricks.sliding_window_view(series, length)[:: length // 2]


def _variance_from_spectrum(residual: Array, propagated: Array) -> float:
    """Return the variance of the noise in a residual from the upper half of its spectrum, where models leave little.

    The noise is white or has passed a first-order filter: 1/S is then a line over cos ω (first-order autoregression). Only
    segments with propagated errors up to their median count.
    """
    means = _segments(propagated).mean(axis=1)
    segments = _segments(residual)[means <= np.median(means)]
    length = segments.shape[1]
    line = np.vander(np.linspace(-1.0, 1.0, length), 2)
    window = np.hanning(length + 2)[1:-1]
    spectra = np.abs(np.fft.rfft((segments - segments @ (line @ np.linalg.pinv(line))) * window)) ** 2
    upper = np.arange(length // 4, (length - 1) // 2 + 1)
    # The median over the segments, because reversals are outliers; the median of an exponential distribution is log 2.
    density = np.median(spectra[:, upper], axis=0) / (np.log(2.0) * np.sum(window**2))
    if not density.all():
        return 0.0
    # 1/S = constant - slope cos ω; slope/constant = 2ρ/(1 + ρ²) for a first-order autoregression.
    regressors = np.stack([np.ones(len(upper)), -np.cos(2 * np.pi * upper / length)], axis=1)
    constant, slope = np.linalg.lstsq(regressors * density[:, None], np.ones(len(upper)), rcond=None)[0]
    ratio = slope / constant
    if ratio <= 0:
        return float(density.mean())
    ratio = min(ratio, LARGEST_SPECTRAL_RATIO)
    correlation = (1 - np.sqrt(1 - ratio**2)) / ratio
    shape = (1 + correlation**2) * (1 - ratio * np.cos(2 * np.pi * upper / length))
    return float(np.mean(density * shape) / (1 - correlation**2))
