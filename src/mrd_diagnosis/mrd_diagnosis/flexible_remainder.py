"""How much of the gap could be explained at all: what a flexible model of the residual predicts of runs it has not seen."""

import itertools
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_diagnosis.localisation import travel_since_reversal
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import Recording

Array = NDArray[np.float64]

MOST_SAMPLES = 20_000
"""taken evenly from all runs: more make the ceiling no surer."""

WAVES = 400
"""Random Fourier features."""

INTERACTING = 3
"""Features at most that one of them depends on: physical effects join few causes, and what does generalises."""

RIDGES = 10.0 ** np.arange(-6, 3)
"""Candidates, relative to the mean of the normal matrix's diagonal."""

TRAVELS = (0.1e-3, 0.5e-3, 2e-3, 10e-3)
"""m of travel; over these the memories of the rod's direction and of the force fade."""

TIMES = (3e-3, 12e-3, 50e-3)
"""s; over these times the memories of current and force fade."""

CURRENTS = (0.1, 0.4)
"""A of change; over these the memory of the current's direction fades."""

BLOCKS = 6
"""that take the place of runs where there is one."""

GAP = 0.5
"""s between such blocks that are not used."""

LARGEST = 3.0
"""standard deviations that a feature saturates at, so that an unseen run does not reach far beyond the others."""


def explainable_fraction(
    recordings: Sequence[Recording], residuals: Sequence[Array], sigma_by_run: Sequence[Array], rng: np.random.Generator
) -> float:
    """Share of the excess squared error that a flexible model of the residual closes on runs it has not seen.

    The model is ridge regression on motion, current and modelled force, their memories that fade over time, travel or change
    of current, and random Fourier features of these (Rahimi & Recht 2007). One run is left out in turn; of a single run,
    blocks with gaps between them. The ridge for each is the one that predicts the others best; a run that is predicted worse
    than by nothing, being unlike the others, counts as not explained.

    This is no cause, and only a lower bound of what can be explained: a true effect has a better form than this.

    Parameters
    ----------
    recordings : sequence of Recording
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N, the run's own offset and gain taken out. The modelled force is a feature: what
        they leave of the recordings' force must hold no noise.
    sigma_by_run : sequence of ndarray (counted samples,)
        N, what of the residual is noise.
    rng : numpy.random.Generator
        For the frequencies of the Fourier features.

    Returns
    -------
    float
        Between 0 and 1. An excess within `Thresholds.noise_variance_error` of the noise's variance is taken as that large,
        so that there is nothing to explain where there is no gap.
    """
    stride = -(-sum(map(len, residuals)) // MOST_SAMPLES)
    features = np.concatenate([f[::stride] for f in _features(recordings, residuals)])
    residual, sigma = (np.concatenate([s[::stride] for s in series]) for series in (residuals, sigma_by_run))
    folds = _folds(recordings, [-(-len(r) // stride) for r in residuals], stride)
    used = np.concatenate([np.arange(fold.start, fold.stop) for fold in folds])
    noise = float(np.sum(sigma[used] ** 2))
    excess = float(np.sum(residual[used] ** 2)) - noise
    if noise == 0.0 and excess == 0.0:
        return 0.0
    basis = _basis(features, rng)
    # What is not noise varies, too: with 1 / sigma alone the fit would hardly look where noise is large.
    weight = 1.0 / np.sqrt(sigma**2 + max(excess, 0.0) / len(used) + 1e-300)
    errors = _unseen(basis, residual, weight, folds)
    others = errors.sum(axis=0) - errors
    chosen = errors[np.arange(len(folds)), np.argmin(others, axis=1)]
    before = np.array([np.sum(residual[fold] ** 2) for fold in folds])
    closed = float(np.maximum(before - chosen, 0.0).sum())
    return float(np.clip(closed / max(excess, THRESHOLDS.noise_variance_error * noise), 0.0, 1.0))


def _folds(recordings: Sequence[Recording], counts: Sequence[int], stride: int) -> list[slice]:
    """Samples of each run; of each block, without gaps, where there is one run."""
    edges = [0, *itertools.accumulate(counts)]
    gap = 0
    if len(counts) == 1:
        edges = [int(edge) for edge in np.linspace(0, counts[0], BLOCKS + 1)]
        gap = min(round(0.5 * GAP * recordings[0].run.rate / stride), counts[0] // (8 * BLOCKS))
    return [slice(start + gap, stop - gap) for start, stop in itertools.pairwise(edges)]


def _features(recordings: Sequence[Recording], residuals: Sequence[Array]) -> list[Array]:
    """Motion, current, modelled force and their memories, of each run (counted samples, features)."""
    found = []
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
            np.tanh(velocity / 0.01),
            np.log(travel_since_reversal(path) + 1e-4) * direction,
            current,
            modelled,
            modelled * np.cumsum(modelled * velocity * step),
            *(_faded(np.exp(-np.abs(travel) / scale), direction) for scale in TRAVELS),
            *(modelled - _faded(np.exp(-np.abs(travel) / scale), modelled) for scale in TRAVELS),
            *(_faded(np.exp(-np.abs(change) / scale), np.sign(change)) * direction for scale in CURRENTS),
            *(current - _faded(np.exp(-step / scale), current) for scale in TIMES),
            *(modelled - _faded(np.exp(-step / scale), modelled) for scale in TIMES),
        ]
        found.append(np.stack([column[counted] for column in columns], axis=1))
    return found


@njit(cache=True, nogil=True)
def _faded(keep: Array, drive: Array) -> Array:
    """Memory of ``drive`` of which ``keep`` is left from sample to sample."""
    memory = np.empty_like(drive)
    state = drive[0]
    for k in range(len(drive)):
        state = drive[k] + keep[k] * (state - drive[k])
        memory[k] = state
    return memory


def _basis(features: Array, rng: np.random.Generator) -> Array:
    """Features and random Fourier features of up to `INTERACTING` of them (samples, columns), of unit variance."""
    standard = LARGEST * np.tanh(_standardised(features) / LARGEST)
    # Each wave runs along its own few features, one wave length over a few standard deviations.
    order = rng.random((standard.shape[1], WAVES)).argsort(axis=0)
    many = rng.integers(1, INTERACTING + 1, WAVES)
    frequencies = np.where(order < many, rng.standard_normal(order.shape) / np.sqrt(many), 0.0)
    waves = np.cos(standard @ frequencies + rng.uniform(0, 2 * np.pi, WAVES))
    return np.concatenate([_standardised(standard), _standardised(waves)], axis=1)


def _standardised(columns: Array) -> Array:
    """Columns of mean 0 and variance 1, without those that do not vary."""
    spread = columns.std(axis=0)
    varies = spread > 1e-9 * np.abs(columns).max(axis=0)
    return np.asarray((columns[:, varies] - columns[:, varies].mean(axis=0)) / spread[varies])


def _unseen(basis: Array, residual: Array, weight: Array, folds: Sequence[slice]) -> Array:
    """Squared error (folds, ridges) of each fold, predicted from the others."""
    grams, slopes = [], []
    for fold in folds:
        scaled = basis[fold] * weight[fold, None]
        grams.append(scaled.T @ scaled)
        slopes.append(scaled.T @ (residual[fold] * weight[fold]))
    gram, slope = np.sum(grams, axis=0), np.sum(slopes, axis=0)
    errors = np.empty((len(folds), len(RIDGES)))
    for index, fold in enumerate(folds):
        values, vectors = np.linalg.eigh(gram - grams[index])
        turned = vectors.T @ (slope - slopes[index])
        ridges = RIDGES * values.mean()
        solutions = vectors @ (turned[:, None] / (np.maximum(values, 0.0)[:, None] + ridges))
        errors[index] = np.sum((residual[fold, None] - basis[fold] @ solutions) ** 2, axis=0)
    return errors
