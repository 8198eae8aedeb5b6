"""Correlation time of residuals, and segments of runs that are long enough to count as independent."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

Array = NDArray[np.float64]

MOST_SEGMENTS = 400
"""Number of segments of all runs together; the statistics of more segments would hardly be more precise."""

FEWEST_VALUES = 20
"""Length of the shortest series of which an autocorrelation is estimated."""

NO_CORRELATION = 0.1
"""Autocorrelation below which values are taken as uncorrelated."""


def correlation_length(residuals: Array) -> int:
    """Return the number of samples over which ``residuals`` (n,) are correlated; 1 for uncorrelated ones.

    A slow error may be hidden by a larger one that changes from sample to sample, and still dominate the uncertainty of an
    offset or a stiffness. So the autocorrelation is followed until it falls below `NO_CORRELATION` or below three standard
    errors, for the residuals and for their means over 2, 4, 8 and so on samples.
    """
    means = residuals - residuals.mean()
    longest, scale = _first_uncorrelated_lag(means), 1
    while len(means) >= 2 * FEWEST_VALUES:
        means = 0.5 * (means[: len(means) // 2 * 2 : 2] + means[1::2])
        scale *= 2
        longest = max(longest, (_first_uncorrelated_lag(means) - 1) * scale)
    return min(longest, len(residuals))


def _first_uncorrelated_lag(series: Array) -> int:
    padded = next_fast_len(2 * len(series), real=True)
    autocorrelation = irfft(np.abs(rfft(series, padded)) ** 2, padded)[: len(series)]
    threshold = max(NO_CORRELATION, 3.0 / np.sqrt(len(series)))
    below = np.flatnonzero(autocorrelation <= threshold * autocorrelation[0])
    return max(1, int(below[0])) if below.size else len(series)


def independent_segments(runs: Sequence[slice], correlated: int) -> list[slice]:
    """Cut runs into segments four times as long as the residuals are correlated, each within one run.

    Parameters
    ----------
    runs : sequence of slice
        Slice of each run within all samples.
    correlated : int
        Number of samples, as `correlation_length` returns it.
    """
    samples = runs[-1].stop - runs[0].start
    length = max(4 * correlated, samples // MOST_SEGMENTS, 1)
    segments: list[slice] = []
    for run in runs:
        edges = np.linspace(run.start, run.stop, max(1, (run.stop - run.start) // length) + 1).astype(int)
        segments += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return segments
