"""Oscillation in the excess error: a narrow band of frequencies, above those of the motion, that has most of it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

from mrd_diagnosis.diagnosis import Interval, Region, RunNoise
from mrd_identification.recording import Recording

Array = NDArray[np.float64]

FRAME_DURATION = 2.0
"""Duration in s of the frames of a spectrum in which an oscillation is looked for: it resolves 0.5 Hz."""

WIDTH_OF_LINE = 1.2
"""Ratio of the ends of the band of an oscillation: a reader calls it one frequency."""

LEAST_SHARE_OF_LINE = 0.5
"""Share of the excess that an oscillation has at least. A flat spectrum has less than a fifth in such a band."""

ABOVE_MOTION = 5.0
"""Ratio of the frequency of an oscillation to that of the motion: what lies below may be a harmonic of the motion."""

SHARE_OF_MOTION = 0.95
"""Share of the energy of the velocity below the highest frequency of the motion."""


def find_oscillation(
    recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]
) -> Region | None:
    """Return the narrow band of frequencies that has most of the excess error; None where no band has most of it.

    The band lies above the frequencies of the motion.
    """
    spectra = []
    for recording, of_run, residual in zip(recordings, noise, residuals, strict=True):
        energies = _energies(residual, recording.rate)
        spectra.append(energies - float(np.sum(of_run.sigma**2)) / len(energies))
    excess = _added(spectra)
    total = float(sum(np.sum(r**2) - np.sum(n.sigma**2) for r, n in zip(residuals, noise, strict=True)))
    first = round(ABOVE_MOTION * highest_frequency_of_motion(recordings) * FRAME_DURATION)
    starts = np.arange(max(1, first), len(excess))
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


def highest_frequency_of_motion(recordings: Sequence[Recording]) -> float:
    """Return the frequency in Hz below which `SHARE_OF_MOTION` of the energy of the velocity lies."""
    motion = np.cumsum(_added([_energies(of_run.motion.velocity[of_run.counted], of_run.rate) for of_run in recordings]))
    return int(np.searchsorted(motion, SHARE_OF_MOTION * motion[-1])) / FRAME_DURATION


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
