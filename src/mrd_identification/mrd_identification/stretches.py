"""Stretches of a residual that count as independent of each other."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST = 400
"""Stretches in all: more would not make anything surer."""


def correlation_length(residuals: Array) -> int:
    """Samples after which the autocorrelation of ``residuals`` (n,) has fallen below a tenth."""
    spectrum = np.abs(np.fft.rfft(residuals - residuals.mean(), 2 * len(residuals))) ** 2
    autocorrelation = np.fft.irfft(spectrum)[: len(residuals)]
    below = np.flatnonzero(autocorrelation < 0.1 * autocorrelation[0])
    return int(below[0]) if below.size else len(residuals)


def stretches(runs: Sequence[slice], correlated: int) -> list[slice]:
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
