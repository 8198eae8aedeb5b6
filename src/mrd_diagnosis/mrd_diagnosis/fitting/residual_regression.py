"""Regression of the residual on a flexible model: the share of the gap that it predicts on unseen runs can be explained."""

import itertools
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_diagnosis.localisation.events import travel_since_reversal
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import Recording
from mrd_runs.scales import scales_of

Array = NDArray[np.float64]

MOST_SAMPLES = 20_000
"""Samples of all runs together, evenly spaced; more do not change the share."""

FOURIER_FEATURES = 400
"""Number of random Fourier features."""

MOST_INTERACTING = 3
"""Features on which a Fourier feature depends, at most: physical effects join few causes, and such a model generalises."""

RIDGES = 10.0 ** np.arange(-6, 3)
"""Ridges that are tried, relative to the mean eigenvalue of the normal matrix."""

TRAVELS = (0.005, 0.025, 0.1, 0.5)
"""Travels, over half the span of the position, over which the memories of the rod's direction and of the force fade."""

TIMES = (3e-3, 12e-3, 50e-3)
"""Times in s, those of coils, particles and amplifiers, over which the memories of current and force fade."""

CURRENTS = (0.15, 0.6)
"""Changes of current, over the largest one, over which the memory of the current's direction fades."""

SLOW = 0.1
"""Speed, over that of fast strokes, below which friction may be viscous."""

BLOCKS = 6
"""Blocks that take the place of runs where there is only one run."""

GAP_BETWEEN_BLOCKS = 0.5
"""Time in s between such blocks that is not used."""

SATURATION = 3.0
"""Standard deviations at which a feature saturates, so that it does not extrapolate far in an unseen run."""


def explainable_fraction(
    recordings: Sequence[Recording], residuals: Sequence[Array], sigma_by_run: Sequence[Array], rng: np.random.Generator
) -> float:
    """Return the share of the excess squared error that a flexible model of the residual closes on unseen runs.

    The model is ridge regression on motion, current and modelled force, on their memories that fade over time, travel or
    change of current, and on random Fourier features of these (Rahimi & Recht 2007). Each run is left out in turn; of a
    single run, each block, with gaps between the blocks. The ridge for a run is the one that predicts the others best. A run
    that is predicted worse than by zero, because it is unlike the others, counts as not explained.

    The result names no cause, and it is only a lower bound of what can be explained: a true effect has a better formula.

    Parameters
    ----------
    recordings : sequence of Recording
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N, without the run's offset and gain error. The modelled force is a feature, so that
        it must hold no noise: it is the recorded force minus the residual.
    sigma_by_run : sequence of ndarray (counted samples,)
        Standard deviation of the noise in N.
    rng : numpy.random.Generator
        Source of the frequencies of the Fourier features.

    Returns
    -------
    float
        Between 0 and 1. An excess within `Thresholds.noise_variance_error` of the noise variance is raised to that value, so
        that nothing is explainable where there is no gap.
    """
    stride = -(-sum(map(len, residuals)) // MOST_SAMPLES)
    features = np.concatenate([of_run[::stride] for of_run in _features(recordings, residuals)])
    residual, sigma = (np.concatenate([values[::stride] for values in series]) for series in (residuals, sigma_by_run))
    folds = _folds(recordings, [-(-len(of_run) // stride) for of_run in residuals], stride)
    used = np.concatenate([np.arange(fold.start, fold.stop) for fold in folds])
    noise = float(np.sum(sigma[used] ** 2))
    excess = float(np.sum(residual[used] ** 2)) - noise
    if noise == 0.0 and excess == 0.0:
        return 0.0
    basis = _basis(features, rng, FOURIER_FEATURES)
    # The excess varies as well: with the weight 1 / sigma, samples with much noise would hardly count.
    weight = 1.0 / np.sqrt(sigma**2 + max(excess, 0.0) / len(used) + 1e-300)
    errors = _held_out_errors(basis, residual, weight, folds)
    of_other_folds = errors.sum(axis=0) - errors
    chosen = errors[np.arange(len(folds)), np.argmin(of_other_folds, axis=1)]
    before = np.array([np.sum(residual[fold] ** 2) for fold in folds])
    closed = float(np.maximum(before - chosen, 0.0).sum())
    return float(np.clip(closed / max(excess, THRESHOLDS.noise_variance_error * noise), 0.0, 1.0))


def flexible_functions(
    recordings: Sequence[Recording], residuals: Sequence[Array], rng: np.random.Generator, count: int
) -> Array:
    """Return the functions (counted samples, columns) of that model with ``count`` Fourier features; other arguments as of
    `explainable_fraction`.
    """
    return _basis(np.concatenate(_features(recordings, residuals)), rng, count)


def _folds(recordings: Sequence[Recording], counts: Sequence[int], stride: int) -> list[slice]:
    """Return the samples of each run, or of each block where there is one run."""
    edges = [0, *itertools.accumulate(counts)]
    gap = 0
    if len(counts) == 1:
        edges = [int(edge) for edge in np.linspace(0, counts[0], BLOCKS + 1)]
        gap = min(round(0.5 * GAP_BETWEEN_BLOCKS * recordings[0].rate / stride), counts[0] // (8 * BLOCKS))
    return [slice(start + gap, stop - gap) for start, stop in itertools.pairwise(edges)]


def _features(recordings: Sequence[Recording], residuals: Sequence[Array]) -> list[Array]:
    """Return motion, current, modelled force and their memories (counted samples, features) of each run."""
    scales = scales_of([recording.run for recording in recordings])
    features = []
    for recording, residual in zip(recordings, residuals, strict=True):
        path, counted, time = recording.path, recording.counted, recording.run.time
        position, velocity, acceleration, current = (
            series[path.samples] for series in (path.position, path.velocity, path.acceleration, path.current)
        )
        modelled = np.interp(time, time[counted], recording.force - residual)
        travel, change, step = (np.diff(series, prepend=series[0]) for series in (position, current, time))
        direction = np.sign(travel)
        columns = [
            position,
            velocity,
            acceleration,
            np.sign(velocity) * np.sqrt(np.abs(velocity)),
            np.tanh(velocity / (SLOW * scales.speed)),
            np.log(travel_since_reversal(path) / scales.stroke + TRAVELS[0]) * direction,
            current,
            modelled,
            modelled * np.cumsum(modelled * velocity * step),
            *(fading_memory(np.exp(-np.abs(travel) / (scale * scales.stroke)), direction) for scale in TRAVELS),
            *(modelled - fading_memory(np.exp(-np.abs(travel) / (scale * scales.stroke)), modelled) for scale in TRAVELS),
            *(
                fading_memory(np.exp(-np.abs(change) / (scale * scales.current)), np.sign(change)) * direction
                for scale in CURRENTS
            ),
            *(current - fading_memory(np.exp(-step / scale), current) for scale in TIMES),
            *(modelled - fading_memory(np.exp(-step / scale), modelled) for scale in TIMES),
        ]
        features.append(np.stack([column[counted] for column in columns], axis=1))
    return features


@njit(cache=True, nogil=True)
def fading_memory(kept: Array, series: Array) -> Array:
    """Return the memory (n,) of a series of which the share ``kept`` remains from sample to sample."""
    memory = np.empty_like(series)
    state = series[0]
    for k in range(len(series)):
        state = series[k] + kept[k] * (state - series[k])
        memory[k] = state
    return memory


def _basis(features: Array, rng: np.random.Generator, count: int) -> Array:
    """Return the features and ``count`` random Fourier features of them (samples, columns), of unit variance."""
    saturated = SATURATION * np.tanh(_standardised(features) / SATURATION)
    # Each Fourier feature depends on a few features of its own, with a wavelength of a few standard deviations.
    order = rng.random((saturated.shape[1], count)).argsort(axis=0)
    interacting = rng.integers(1, MOST_INTERACTING + 1, count)
    frequencies = np.where(order < interacting, rng.standard_normal(order.shape) / np.sqrt(interacting), 0.0)
    waves = np.cos(saturated @ frequencies + rng.uniform(0, 2 * np.pi, count))
    return np.concatenate([_standardised(saturated), _standardised(waves)], axis=1)


def _standardised(columns: Array) -> Array:
    """Return the columns with mean 0 and variance 1, without those that do not vary."""
    spread = columns.std(axis=0)
    varies = spread > 1e-9 * np.abs(columns).max(axis=0)
    return np.asarray((columns[:, varies] - columns[:, varies].mean(axis=0)) / spread[varies])


def _held_out_errors(basis: Array, residual: Array, weight: Array, folds: Sequence[slice]) -> Array:
    """Return the squared error (folds, ridges) of each fold, predicted from the other folds."""
    matrices, gradients = [], []
    for fold in folds:
        scaled = basis[fold] * weight[fold, None]
        matrices.append(scaled.T @ scaled)
        gradients.append(scaled.T @ (residual[fold] * weight[fold]))
    matrix, gradient = np.sum(matrices, axis=0), np.sum(gradients, axis=0)
    errors = np.empty((len(folds), len(RIDGES)))
    for index, fold in enumerate(folds):
        values, vectors = np.linalg.eigh(matrix - matrices[index])
        rotated = vectors.T @ (gradient - gradients[index])
        ridges = RIDGES * values.mean()
        solutions = vectors @ (rotated[:, None] / (np.maximum(values, 0.0)[:, None] + ridges))
        errors[index] = np.sum((residual[fold, None] - basis[fold] @ solutions) ** 2, axis=0)
    return errors
