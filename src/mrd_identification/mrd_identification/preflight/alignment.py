"""Alignment of two series in time: cross-correlation and the part in which shifted series overlap."""

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DEFAULT_REACH = 5
"""The longest shift looked at is the length of the shorter series over this number, so that 80 % of it still overlap."""


def overlap(first: Array, second: Array, shift: int) -> tuple[Array, Array]:
    """Return the parts of two series that coincide when the second series is ``shift`` samples late."""
    count = min(len(first) + min(shift, 0), len(second) - max(shift, 0), len(first), len(second))
    return first[max(-shift, 0) :][:count], second[max(shift, 0) :][:count]


def cross_correlation(first: Array, second: Array, reach: int | None = None) -> tuple[Indices, Array]:
    """Return the shifts of the second series up to ``reach`` samples, and the correlation of the overlap at each shift."""
    first, second = first - first.mean(), second - second.mean()
    size = fft.next_fast_len(len(first) + len(second), real=True)
    product = fft.irfft(np.conj(fft.rfft(first, size)) * fft.rfft(second, size), size)
    reach = min(len(first), len(second)) // DEFAULT_REACH if reach is None else reach
    shifts = np.arange(-reach, reach + 1)
    start_first, start_second = np.maximum(-shifts, 0), np.maximum(shifts, 0)
    count = np.minimum(len(first) - start_first, len(second) - start_second)
    energy_first, energy_second = (np.append(0.0, np.cumsum(series**2)) for series in (first, second))
    norm = (energy_first[start_first + count] - energy_first[start_first]) * (
        energy_second[start_second + count] - energy_second[start_second]
    )
    return shifts, np.asarray(product[shifts] / np.sqrt(np.maximum(norm, 1e-300)))


def best_shift(first: Array, second: Array) -> tuple[float, int]:
    """Return the correlation of two series at the shift that aligns them best, and that shift in samples."""
    shifts, correlation = cross_correlation(first, second)
    best = int(np.argmax(correlation))
    # A periodic motion has several peaks of about the same height: take the one with the smallest shift.
    peaks = np.flatnonzero((correlation[1:-1] >= correlation[:-2]) & (correlation[1:-1] >= correlation[2:])) + 1
    peaks = peaks[correlation[peaks] > correlation[best] - 1e-4]
    best = int(peaks[np.argmin(np.abs(shifts[peaks]))]) if len(peaks) else best
    shift = int(shifts[best])
    return float(np.corrcoef(*overlap(first, second, shift))[0, 1]), shift
