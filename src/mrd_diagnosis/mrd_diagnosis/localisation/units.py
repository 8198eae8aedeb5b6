"""Statistical units of the localisation: pieces of the recordings of which each is one observation of the excess error.

A unit is a stroke, from one reversal of the rod to the next: it has samples after the reversal, in mid-stroke and before
the end, so that the excess of its bins can be compared within it. Strokes are joined until they are longer than the memory
of the residual, because what is correlated from one to the next is no new observation.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Axis, RunNoise
from mrd_diagnosis.localisation.events import reversals, span_of_positions
from mrd_identification.recording import Recording
from mrd_runs.scales import scales_of
from mrd_runs.signals.current_steps import current_steps

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

FORGOTTEN = 0.2
"""Correlation of the residual from which it counts as forgotten. The squares are then correlated by the square of that."""

LEAST_UNITS = 100
"""Number of units into which the duration of the recordings is divided at least, for axes whose bins are times or runs. What
the residual remembers for longer is a drift, whose place is a time."""

BETWEEN_UNITS: tuple[Axis, ...] = ("run", "time", "current")
"""Axes whose bins hold whole units, which are compared with each other. On the others, bins are compared within units."""


def units_of_axis(
    axis: Axis, recordings: Sequence[Recording], bin_of_sample: Sequence[Indices], memories: Sequence[float]
) -> tuple[Indices, Indices]:
    """Return the unit of every counted sample of all recordings, and the run of every unit.

    Units begin where the rod reverses. The two directions are compared within a stroke there and the next one back. For the
    nearness to an end, a unit is half a stroke, which passes one end. After a step of the current, the unit goes on until
    the next step. Of the current, a unit is the time at one level: a level that is kept through a run is one observation,
    however long. Strokes are divided only for time and runs.

    Parameters
    ----------
    axis : str
    recordings : sequence of Recording
    bin_of_sample : sequence of ndarray (counted samples,)
        Bins of the axis, of each recording.
    memories : sequence of float
        Least duration in s of a unit of each recording, from `memory`.
    """
    middle = sum(span_of_positions(recordings)) / 2
    total = sum(recording.run.duration for recording in recordings)
    longest = total / LEAST_UNITS if axis in ("run", "time") else np.inf
    scale = scales_of([recording.run for recording in recordings]).current
    unit_of_sample: list[Indices] = []
    run_of_unit: list[int] = []
    for run, (recording, bins, memory_of_run) in enumerate(zip(recordings, bin_of_sample, memories, strict=True)):
        if axis == "current":
            begins = np.flatnonzero(np.diff(bins)) + 1
        elif axis == "step":
            begins = _counted(recording, current_steps(recording.smoothed.current, recording.run.rate, scale))
        else:
            begins = _counted(recording, np.searchsorted(recording.path.samples, reversals(recording.path)))
            if axis == "sign":
                begins = begins[::2]
            elif axis == "end":
                beyond = recording.motion.position[recording.counted] > middle
                begins = np.union1d(begins, np.flatnonzero(np.diff(beyond)) + 1)
        least = max(2, round(min(memory_of_run, total / LEAST_UNITS) * recording.rate))
        edges = _joined(begins, len(bins), least)
        pieces = np.maximum(np.ceil(np.diff(edges) / (longest * recording.rate)), 1).astype(int)
        divided = np.interp(np.arange(pieces.sum() + 1), np.append(0, np.cumsum(pieces)), edges)
        sizes = np.diff(np.unique(divided.astype(int)))
        unit_of_sample.append(len(run_of_unit) + np.repeat(np.arange(len(sizes)), sizes))
        run_of_unit += [run] * len(sizes)
    return np.concatenate(unit_of_sample), np.array(run_of_unit)


def memory(recording: Recording, noise: RunNoise, residual: Array) -> float:
    """Return the time in s after which the excess part of a residual (counted samples,) is forgotten."""
    samples = len(residual)
    spectrum = np.abs(np.fft.rfft(residual, 2 * samples)) ** 2
    covariance = np.fft.irfft(spectrum)[:samples]
    excess = covariance[0] - float(np.sum(noise.sigma**2))
    forgotten = np.flatnonzero(covariance[1:] < FORGOTTEN * max(excess, 0.0))
    return float(forgotten[0] + 1 if len(forgotten) else samples) / recording.rate


def _counted(recording: Recording, samples: Indices) -> Indices:
    """Return the first counted sample at or after each sample, as far as there is one."""
    counted = -((recording.counted.start - samples) // recording.step)
    return np.asarray(counted[(counted > 0) & (counted < len(recording.force))])


def _joined(begins: Indices, samples: int, least: int) -> list[int]:
    """Return the edges of units that begin at some of ``begins``, each with at least so many samples."""
    edges = [0]
    for begin in map(int, begins):
        if begin - edges[-1] >= least and samples - begin >= least:
            edges.append(begin)
    return [*edges, samples]
