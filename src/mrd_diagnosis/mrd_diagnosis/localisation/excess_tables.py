"""Sums of the excess error over the units of the recordings and the bins of every axis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import RunNoise
from mrd_diagnosis.localisation.axis_bins import Bins, bins_of_axes, labelled_bins, log_edges, range_labels
from mrd_diagnosis.localisation.units import memory, units_of_axis
from mrd_identification.recording import Recording

Array = NDArray[np.float64]

FRAME_DURATION = 1.0
"""Duration in s from one frame of the spectrum to the next; each frame is a unit."""


@dataclass(frozen=True)
class ExcessTable:
    """Sums over units, each within one run, and over the bins of an axis.

    Attributes
    ----------
    bins : Bins
    excess : ndarray (units, bins)
        Squared error in N² beyond the variance of the noise.
    noise : ndarray (units, bins)
        Variance of the noise in N².
    samples : ndarray (units, bins)
    """

    bins: Bins
    excess: Array
    noise: Array
    samples: Array


def excess_tables(
    recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]
) -> list[ExcessTable]:
    """Return the excess over every axis that varies; the arguments are those of `localise`."""
    squares = np.concatenate([residual**2 for residual in residuals])
    variance = np.concatenate([of_run.sigma**2 for of_run in noise])
    ends = np.cumsum([len(residual) for residual in residuals])[:-1]
    memories = list(map(memory, recordings, noise, residuals))
    tables = []
    for bins, bin_of_sample in bins_of_axes(recordings):
        if len(bins.labels) < 2:
            continue
        unit, run_of_unit = units_of_axis(bins.axis, recordings, np.split(bin_of_sample, ends), memories)
        inside = bin_of_sample >= 0
        shape = len(run_of_unit), len(bins.labels)
        cell = np.ravel_multi_index((unit[inside], bin_of_sample[inside]), shape)
        sums = [
            np.bincount(cell, weights, minlength=shape[0] * shape[1]).reshape(shape).astype(float)
            for weights in ((squares - variance)[inside], variance[inside], None)
        ]
        tables.append(ExcessTable(bins, *sums))
    return [*tables, frequency_table(recordings, noise, residuals)]


def frequency_table(recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]) -> ExcessTable:
    """Return the excess over frequency.

    Bands are equally wide on a logarithmic scale, and all count as equally many samples. In proportion to their width in Hz,
    no excess would be found anywhere but at the lowest frequencies.
    """
    highest = max(recording.rate for recording in recordings) / 2
    inner = log_edges(np.array([highest]), 3.0, (1, 3))
    inner = inner[inner >= 1.0 / FRAME_DURATION]
    edges = np.array([0.0, *inner, highest])
    bins = labelled_bins("frequency", "Hz", edges, 1.0, range_labels("frequencies", "Hz"))
    parts = []
    for recording, of_run, residual in zip(recordings, noise, residuals, strict=True):
        parts.append(_band_sums(recording, of_run, residual, [0.0, *inner]))
    return ExcessTable(bins, *np.concatenate(parts, axis=1))


def _band_sums(recording: Recording, noise: RunNoise, residual: Array, lower_edges: Sequence[float]) -> Array:
    """Return excess, noise and samples (3, frames, bands) of a run, over half-overlapping frames.

    The squares of the sine windows of the frames sum to one, so that no energy is lost. The noise of the force sensor is
    white. The error of the measured motion and current has the spectrum of the smoother: flat up to its time constant.
    """
    rate = recording.rate
    hop = max(8, min(round(FRAME_DURATION * rate), len(residual) // 4))
    window = np.sin(np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop))
    padded = np.pad(np.stack([residual, noise.sigma]), ((0, 0), (hop, hop + -len(residual) % hop)))
    frames, sigma = sliding_window_view(padded, 2 * hop, axis=1)[:, ::hop] * window
    spectrum = np.abs(np.fft.rfft(frames)) ** 2 / (2 * hop)
    spectrum[:, 1:-1] *= 2.0  # the negative frequencies
    frequency = np.fft.rfftfreq(2 * hop, 1 / rate)
    degrees = np.full(len(frequency), 2.0)
    degrees[[0, -1]] = 1.0
    time_constant = recording.motion.time_constant
    low_pass = degrees / (1.0 + (2 * np.pi * frequency * time_constant) ** 2) if np.isfinite(time_constant) else degrees
    variance = (sigma**2).sum(axis=1)
    of_force = np.minimum(((sigma > 0) * (window * noise.force) ** 2).sum(axis=1), variance)
    expected = np.outer(of_force, degrees / degrees.sum()) + np.outer(variance - of_force, low_pass / low_pass.sum())
    starts = np.searchsorted(frequency, lower_edges)
    present = starts < len(frequency)
    sums = np.zeros((3, len(frames), len(starts)))
    for target, values in zip(sums[:2], (spectrum - expected, expected), strict=True):
        target[:, present] = np.add.reduceat(values, starts[present], axis=1)
    sums[2, :, present] = (sigma > 0).sum(axis=1)
    return sums
