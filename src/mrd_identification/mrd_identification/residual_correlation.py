"""Stretches of a residual that count as independent of each other."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

Array = NDArray[np.float64]

MOST = 400
"""Stretches in all: more would not make anything surer."""

FEWEST = 20
"""Values from which a correlation is still worth computing."""


def correlation_length(residuals: Array) -> int:
    """Samples over which ``residuals`` (n,) hang together; 1 where each stands for itself.

    A slow error may hide under a larger one that changes from sample to sample, and yet be all that matters to an offset or
    a stiffness. So the autocorrelation is followed to where it falls below a tenth, or into what chance makes of it, for the
    residuals and for their means over 2, 4, 8 and so on samples.
    """
    means = residuals - residuals.mean()
    longest, scale = _decay(means), 1
    while len(means) >= 2 * FEWEST:
        means = 0.5 * (means[: len(means) // 2 * 2 : 2] + means[1::2])
        scale *= 2
        longest = max(longest, (_decay(means) - 1) * scale)
    return min(longest, len(residuals))


def _decay(series: Array) -> int:
    """First lag at which the autocorrelation is as good as none."""
    padded = next_fast_len(2 * len(series), real=True)
    autocorrelation = irfft(np.abs(rfft(series, padded)) ** 2, padded)[: len(series)]
    below = np.flatnonzero(autocorrelation <= max(0.1, 3.0 / np.sqrt(len(series))) * autocorrelation[0])
    return max(1, int(below[0])) if below.size else len(series)


def independent_segments(runs: Sequence[slice], correlated: int) -> list[slice]:
    """Cut runs into stretches four times as long as the residual is correlated, each within one run.

    Parameters
    ----------
    runs : sequence of slice
        Where the samples of each run are.
    correlated : int
        As from `correlation_length`.
    """
    samples = runs[-1].stop - runs[0].start
    length = max(4 * correlated, samples // MOST, 1)
    found: list[slice] = []
    for run in runs:
        edges = np.linspace(run.start, run.stop, max(1, (run.stop - run.start) // length) + 1).astype(int)
        found += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return found
