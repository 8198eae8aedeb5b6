"""Change point of a series: the step or bend that improves a straight line most, with its p-value."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from mrd_diagnosis.trend.regression import Regression

Array = NDArray[np.float64]

REPLICATES = 1999
"""Simulated series without a change point: enough for a p-value of 0.02 with a standard error of 0.003."""


@dataclass(frozen=True)
class ChangePoint:
    """A place at which the values jump or the slope changes.

    Attributes
    ----------
    kind : {"step", "bend"}
        Jump of the values, or change of the slope.
    before, after : int
        Indices of the dates between which a step is. A bend is at one date, and both indices are that of this date.
    """

    kind: Literal["step", "bend"]
    before: int
    after: int

    def effect(self, dates: Array, times: Array) -> Array:
        """Return what a change of size one adds at some times, for a series at ``dates``."""
        if self.kind == "bend":
            return np.asarray(np.maximum(times - dates[self.before], 0.0))
        return np.asarray(times > 0.5 * (dates[self.before] + dates[self.after]), np.float64)


def clearest_change(times: Array, values: Array, line: Regression, seed: int) -> tuple[ChangePoint, float]:
    """Find the clearest change point of a series, and its p-value by the maximum statistic.

    The p-value is the share of simulated series without a change point whose clearest candidate is as clear. Every place is
    tried that has two dates on each side of a step, or three on each side of a bend, the date of the bend included.

    Parameters
    ----------
    times, values : ndarray (dates,)
    line : Regression
        Straight line through the values.
    seed : int
        Seed of the simulated series.
    """
    candidates = list(_candidates(len(times)))
    effects = np.column_stack([candidate.effect(times, times) for candidate in candidates])

    def whiten(columns: Array) -> Array:
        return np.asarray(solve_triangular(line.root, columns, lower=True))

    basis = np.linalg.qr(whiten(line.design))[0]
    effects = whiten(effects)
    effects -= basis @ (basis.T @ effects)
    effects /= np.linalg.norm(effects, axis=0)
    degrees_of_freedom = len(times) - 3

    def f_statistic(series: Array) -> Array:
        """Return the F statistic (series, candidates) of adding each candidate to the line."""
        residuals = series - (series @ basis) @ basis.T
        gain = (residuals @ effects) ** 2
        rest = np.maximum((residuals**2).sum(axis=1)[:, None] - gain, 1e-12 * gain + 1e-300)
        return np.asarray(gain * degrees_of_freedom / rest)

    observed = f_statistic(whiten(values)[None])[0]
    # The statistic does not depend on the line or on the scale, so white series suffice.
    simulated = np.random.default_rng(seed).standard_normal((REPLICATES, len(times)))
    as_clear = int((f_statistic(simulated).max(axis=1) >= observed.max()).sum())
    return candidates[int(observed.argmax())], (1 + as_clear) / (1 + REPLICATES)


def _candidates(dates: int) -> Iterator[ChangePoint]:
    for after in range(2, dates - 1):
        yield ChangePoint("step", after - 1, after)
    for date in range(2, dates - 2):
        yield ChangePoint("bend", date, date)
