"""Localisation of the gap: excess squared error, beyond what noise explains, over every axis of the recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import welch
from scipy.special import ndtr

from mrd_diagnosis.axis_bins import Bins, bins_of_axes, labelled_bins, log_edges, range_labels
from mrd_diagnosis.diagnosis import Interval, Region, RunNoise
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BLOCK_DURATION = 1.0
"""Duration in s of a block. Residuals of a damper model are correlated over much less, so blocks count as independent."""

LEAST_RUNS_TO_RESAMPLE = 4
"""Runs below which intervals come from resampling blocks instead of runs."""

LEAST_SAMPLES_OF_BIN = 20
"""Samples below which nothing is said about a bin."""

RESAMPLES = 400
"""Samples of the bootstrap."""

FRAME_DURATION = 2.0
"""Duration in s of the frames of a spectrum in which an oscillation is looked for: it resolves 0.5 Hz."""

WIDTH_OF_LINE = 1.2
"""Ratio of the ends of the band of an oscillation: a reader calls it one frequency."""

LEAST_SHARE_OF_LINE = 0.5
"""Share of the excess that an oscillation has at least. A flat spectrum has less than a fifth in such a band."""

ABOVE_MOTION = 5.0
"""Ratio of the frequency of an oscillation to that of the motion: what lies below may be a harmonic of the motion."""


@dataclass(frozen=True)
class ExcessTable:
    """Sums over blocks of about `BLOCK_DURATION`, each within one run, and over the bins of an axis.

    Attributes
    ----------
    bins : Bins
    run_of_block : ndarray (blocks,)
    excess : ndarray (blocks, bins)
        Squared error in N² beyond the variance of the noise.
    noise : ndarray (blocks, bins)
        Variance of the noise in N².
    samples : ndarray (blocks, bins)
    """

    bins: Bins
    run_of_block: Indices
    excess: Array
    noise: Array
    samples: Array

    def by_run(self) -> Array:
        """Return the excess (runs, bins)."""
        runs = range(int(self.run_of_block.max()) + 1)
        return np.stack([self.excess[self.run_of_block == run].sum(axis=0) for run in runs])


def localise(
    recordings: Sequence[Recording],
    noise: Sequence[RunNoise],
    residuals: Sequence[Array],
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
) -> tuple[Region, ...]:
    """Return the bins of every axis with their share of the excess squared error.

    The excess of a bin is the sum of r² - sigma² over its samples. An axis that does not vary in these recordings is left
    out. Travel since the last reversal takes the place of time since then, because hysteresis, play and compliance act over
    a length at any speed. What acts over a time (lag, delay) already shows over current, frequency and acceleration.

    Parameters
    ----------
    recordings : sequence of Recording
        In the order in which they were recorded: time counts through all of them.
    noise : sequence of RunNoise
    residuals : sequence of ndarray (counted samples,)
        Measured minus modelled force in N, without the run's offset and gain error.
    rng : numpy.random.Generator
    resamples : int
        Samples of the bootstrap.

    Returns
    -------
    tuple of Region
        The significant ones first, then by share x log(lift). This is the contribution of the bin to the G statistic of
        excess against samples, large where a small part of the samples has much of the excess. Empty without excess.

    Notes
    -----
    The test statistic is the sum over blocks of the bin's excess above its part of a uniform excess, divided by the root of
    its sum of squares. For independent blocks with symmetric errors, its tails are below those of a normal variable, however
    unequal the blocks are (Efron 1969). The false-discovery rate over all bins is controlled after Benjamini & Hochberg
    (1995). Excess within `Thresholds.noise_variance_error` of the noise variance is not counted.

    Intervals resample runs. They resample blocks where there are fewer runs than `LEAST_RUNS_TO_RESAMPLE`, and for the axes
    run and time, because each run has its own bins there.
    """
    regions: list[Region] = []
    p_values: list[float] = []
    for table in _excess_tables(recordings, noise, residuals):
        by_block = len(recordings) < LEAST_RUNS_TO_RESAMPLE or table.bins.axis in ("run", "time")
        regions_of_axis, p_values_of_axis = _regions(table, table.excess if by_block else table.by_run(), rng, resamples)
        regions += regions_of_axis
        p_values += p_values_of_axis
    q_values = _q_values(np.array(p_values))
    regions = [replace(region, q_value=float(q)) for region, q in zip(regions, q_values, strict=True)]
    return tuple(
        sorted(regions, key=lambda region: (region.q_value >= THRESHOLDS.q_value, -_concentration(region), region.q_value))
    )


def find_oscillation(
    recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]
) -> Region | None:
    """Return the narrow band of frequencies that has most of the excess error; None where no band has most of it.

    The band lies above the frequencies of the motion.
    """
    spectra, motions = [], []
    for recording, of_run, residual in zip(recordings, noise, residuals, strict=True):
        velocity = recording.motion.velocity[recording.counted]
        white = float(np.sum(of_run.sigma**2))
        energies = _energies(residual, recording.rate)
        spectra.append(energies - white / len(energies))
        motions.append(_energies(velocity, recording.rate))
    excess, motion = _added(spectra), np.cumsum(_added(motions))
    total = float(sum(np.sum(r**2) - np.sum(n.sigma**2) for r, n in zip(residuals, noise, strict=True)))
    first = ABOVE_MOTION * int(np.searchsorted(motion, 0.95 * motion[-1]))
    starts = np.arange(max(1, int(first)), len(excess))
    stops = np.minimum(np.floor(WIDTH_OF_LINE * starts).astype(int) + 1, len(excess))
    if total <= 0.0 or not len(starts):
        return None
    sums = np.append(0.0, np.cumsum(excess))
    best = int(np.argmax(sums[stops] - sums[starts]))
    band = np.arange(starts[best], stops[best])
    share = float(excess[band].sum()) / total
    if share < LEAST_SHARE_OF_LINE:
        return None
    centre = float(np.average(band, weights=np.maximum(excess[band], 0.0))) / FRAME_DURATION
    lower, upper = (float(band[place]) / FRAME_DURATION for place in (0, -1))
    share_within_bounds, unknown = Interval(min(share, 1.0)), float("nan")
    label = f"an oscillation near {centre:.{0 if centre >= 10 else 1}f} Hz"
    return Region("frequency", lower, upper, "Hz", share_within_bounds, unknown, unknown, label)


def _energies(series: Array, rate: float) -> Array:
    """Return the sum of the squares of a series at multiples of 1 / FRAME_DURATION."""
    frame = round(FRAME_DURATION * rate)
    padded = np.pad(series, (0, max(0, frame - len(series))))
    _, power = welch(padded, rate, "hann", frame, detrend=False, scaling="spectrum")
    return np.asarray(power * float(series @ series) / max(float(power.sum()), np.finfo(float).tiny))


def _added(spectra: Sequence[Array]) -> Array:
    """Add spectra of different lengths."""
    longest = max(map(len, spectra))
    return np.asarray(np.sum([np.pad(spectrum, (0, longest - len(spectrum))) for spectrum in spectra], axis=0))


def _regions(table: ExcessTable, units: Array, rng: np.random.Generator, resamples: int) -> tuple[list[Region], list[float]]:
    """Return the regions of one axis and their p-values; none without excess.

    Intervals resample the excess ``units`` (units, bins).
    """
    excess, samples = table.excess.sum(axis=0), table.samples.sum(axis=0)
    if excess.sum() <= 0.0:
        return [], []
    uniform = samples / samples.sum()
    drawn = rng.multinomial(len(units), np.full(len(units), 1 / len(units)), size=resamples) @ units
    lower, upper = np.quantile(_shares(drawn), (0.025, 0.975), axis=0)
    shares, p_values = _shares(excess), _p_values(table, uniform)
    counted = list(map(int, np.flatnonzero(samples >= LEAST_SAMPLES_OF_BIN)))
    regions = []
    for index in counted:
        share = Interval(*(float(values[index]) for values in (shares, lower, upper)))
        (first, last), label = table.bins.bounds[index], table.bins.labels[index]
        lift = share.value / float(uniform[index])
        regions.append(Region(table.bins.axis, first, last, table.bins.unit, share, lift, 1.0, label))
    return regions, [float(p_values[index]) for index in counted]


def _excess_tables(
    recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]
) -> list[ExcessTable]:
    """Return the excess over every axis that varies."""
    squares = np.concatenate([residual**2 for residual in residuals])
    variance = np.concatenate([of_run.sigma**2 for of_run in noise])
    block, run_of_block = _blocks(recordings)
    tables = []
    for bins, bin_of_sample in bins_of_axes(recordings):
        size = len(bins.labels)
        if size < 2:
            continue
        cell = block * (size + 1) + np.where(bin_of_sample < 0, size, bin_of_sample)

        def summed(weights: Array | None, cell: Indices = cell, size: int = size) -> Array:
            sums = np.bincount(cell, weights, minlength=len(run_of_block) * (size + 1))
            return sums.reshape(-1, size + 1)[:, :size].astype(float)

        tables.append(ExcessTable(bins, run_of_block, summed(squares - variance), summed(variance), summed(None)))
    return [*tables, _frequency_table(recordings, noise, residuals)]


def _blocks(recordings: Sequence[Recording]) -> tuple[Indices, Indices]:
    """Return the block of every counted sample, and the run of every block."""
    block_of_sample, run_of_block, first = [], [], 0
    for run, recording in enumerate(recordings):
        samples = len(recording.force)
        blocks = max(1, round(samples / recording.rate / BLOCK_DURATION))
        block_of_sample.append(first + np.arange(samples) * blocks // samples)
        run_of_block += [run] * blocks
        first += blocks
    return np.concatenate(block_of_sample), np.array(run_of_block)


def _frequency_table(recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]) -> ExcessTable:
    """Return the excess over frequency.

    Bands are equally wide on a logarithmic scale, and all count as equally many samples. In proportion to their width in Hz,
    no excess would be found anywhere but at the lowest frequencies.
    """
    highest = max(recording.rate for recording in recordings) / 2
    inner = log_edges(np.array([highest]), 3.0, (1, 3))
    inner = inner[inner >= 1.0 / BLOCK_DURATION]
    edges = np.array([0.0, *inner, highest])
    bins = labelled_bins("frequency", "Hz", edges, 1.0, range_labels("frequencies", "Hz"))
    parts = []
    for run, (recording, of_run, residual) in enumerate(zip(recordings, noise, residuals, strict=True)):
        sums = _band_sums(recording, of_run, residual, [0.0, *inner])
        parts.append((np.full(sums.shape[1], run), *sums))
    return ExcessTable(bins, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _band_sums(recording: Recording, noise: RunNoise, residual: Array, lower_edges: Sequence[float]) -> Array:
    """Return excess, noise and samples (3, frames, bands) of a run, over half-overlapping frames.

    The squares of the sine windows of the frames sum to one, so that no energy is lost. The noise of the force sensor is
    white. The error of the measured motion and current has the spectrum of the smoother: flat up to its time constant.
    """
    rate = recording.rate
    hop = max(8, min(round(BLOCK_DURATION * rate), len(residual) // 4))
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


def _shares(excess: Array) -> Array:
    """Return the share of each bin, the last axis, between 0 and 1."""
    total = excess.sum(axis=-1, keepdims=True)
    return np.asarray(np.clip(excess / np.maximum(total, 1e-12 * np.abs(excess).sum(axis=-1, keepdims=True) + 1e-300), 0, 1))


def _p_values(table: ExcessTable, uniform: Array) -> Array:
    """Return the one-sided p-value of each bin for more excess than a uniform distribution gives."""
    above = table.excess - THRESHOLDS.noise_variance_error * table.noise - np.outer(table.excess.sum(axis=1), uniform)
    return np.asarray(ndtr(-above.sum(axis=0) / np.sqrt((above**2).sum(axis=0) + 1e-300)))


def _q_values(p_values: Array) -> Array:
    """Return the q-values of p-values (Benjamini & Hochberg 1995)."""
    order = np.argsort(p_values)[::-1]
    ranks = np.arange(len(p_values), 0, -1)
    q_values = np.empty_like(p_values)
    q_values[order] = np.minimum.accumulate(np.minimum(p_values[order] * len(p_values) / ranks, 1.0))
    return q_values


def _concentration(region: Region) -> float:
    return region.share.value * float(np.log(max(region.lift, 1e-12)))
