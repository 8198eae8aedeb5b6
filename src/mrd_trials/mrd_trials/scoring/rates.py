"""Statistics of a score: rates with intervals, distributions over plants, calibration of probabilities."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rate:
    """A share of plants (or causes, intervals) with its 95 % Clopper-Pearson interval; all are nan where the total is 0.

    Source: C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404-413.
    """

    hits: int
    total: int

    @classmethod
    def from_outcomes(cls, outcomes: Sequence[bool]) -> "Rate":
        """Count outcomes."""
        return cls(sum(outcomes), len(outcomes))

    @property
    def value(self) -> float:
        """The observed share."""
        return self.hits / self.total if self.total else float("nan")

    @property
    def lower(self) -> float:
        """Lower end of the 95 % interval."""
        return self._quantile(0.025, self.hits, 0.0)

    @property
    def upper(self) -> float:
        """Upper end of the 95 % interval."""
        return self._quantile(0.975, self.hits + 1, 1.0)

    def _quantile(self, level: float, first: int, end: float) -> float:
        if not self.total:
            return float("nan")
        second = self.total + 1 - first
        return float(betaincinv(first, second, level)) if first and second else end


@dataclass(frozen=True)
class Distribution:
    """The values of a figure over plants; its quantiles are nan where there are none."""

    values: tuple[float, ...]

    @classmethod
    def of_finite(cls, values: Iterable[float]) -> "Distribution":
        """Take the finite ones of some values."""
        return cls(tuple(float(value) for value in values if np.isfinite(value)))

    @property
    def median(self) -> float:
        """Median of the values."""
        return self.quantile(0.5)

    def quantile(self, level: float) -> float:
        """Return the quantile of the values at a level."""
        return float(np.quantile(self.values, level)) if self.values else float("nan")


CHANCE_DRAWS = 2000
"""Outcomes drawn from probabilities, for the calibration error that chance alone gives."""


@dataclass(frozen=True)
class ReliabilityBin:
    """A tenth of the probabilities, from ``lower`` on: their mean, and how often the claims were right."""

    lower: float
    mean: float
    right: Rate


@dataclass(frozen=True)
class Calibration:
    """Whether claims are right as often as their probabilities say.

    Attributes
    ----------
    count : int
        Number of claims.
    curve : tuple of ReliabilityBin
        The tenths that are not empty.
    error : float
        Expected calibration error: mean distance of the curve from the diagonal, weighted by counts.
    by_chance : float
        What this error would be on average if every probability were right: a few claims never lie on the diagonal.
    stated, right : float
        Mean probability, and share of the claims that are right.
    """

    count: int
    curve: tuple[ReliabilityBin, ...]
    error: float
    by_chance: float
    stated: float
    right: float


def calibration(probability: Array, right: NDArray[np.bool_]) -> Calibration:
    """Compute the calibration of claims from their probabilities (n,) and from whether each was right (n,)."""
    if not len(probability):
        return Calibration(0, (), *4 * (float("nan"),))
    tenths = np.minimum((10 * probability).astype(int), 9)
    drawn = np.random.default_rng(0).random((CHANCE_DRAWS, len(probability))) < probability
    # Summed over a tenth, claims less probabilities are the distance of the curve from the diagonal times the count.
    of_tenth = tenths[:, None] == np.arange(10)
    distances = np.abs((drawn - probability) @ of_tenth).sum(axis=1) / len(probability)
    curve = tuple(
        ReliabilityBin(
            tenth / 10, float(probability[tenths == tenth].mean()), Rate(int(right[tenths == tenth].sum()), int(count))
        )
        for tenth, count in enumerate(np.bincount(tenths, minlength=10))
        if count
    )
    return Calibration(
        count=len(probability),
        curve=curve,
        error=sum(entry.right.total * abs(entry.mean - entry.right.value) for entry in curve) / len(probability),
        by_chance=float(distances.mean()),
        stated=float(probability.mean()),
        right=float(right.mean()),
    )
