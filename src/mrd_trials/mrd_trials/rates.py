"""Shares, spreads and calibration, each with what it takes to judge it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

Array = NDArray[np.float64]

LEAST_PROBABILITY = 1e-3
"""The log score takes no probability as nearer to 0 or 1: one wrong "certain" shall not decide alone."""


@dataclass(frozen=True)
class Rate:
    """A share of plants (or causes, intervals) with its 95 % Clopper-Pearson interval; all nan where there are none.

    Source: C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404-413.
    """

    hits: int
    of: int

    @property
    def value(self) -> float:
        return self.hits / self.of if self.of else float("nan")

    @property
    def lower(self) -> float:
        return self._quantile(0.025, self.hits, 0.0)

    @property
    def upper(self) -> float:
        return self._quantile(0.975, self.hits + 1, 1.0)

    @property
    def bound(self) -> float:
        """One-sided upper bound, at 95 %."""
        return self._quantile(0.95, self.hits + 1, 1.0)

    def _quantile(self, level: float, first: int, end: float) -> float:
        if not self.of:
            return float("nan")
        second = self.of + 1 - first
        return float(betaincinv(first, second, level)) if first and second else end


@dataclass(frozen=True)
class Spread:
    """A figure over plants; nan where there are none."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        return self.quantile(0.5)

    def quantile(self, level: float) -> float:
        return float(np.quantile(self.values, level)) if self.values else float("nan")


@dataclass(frozen=True)
class Reliable:
    """A tenth of the probabilities: their mean, and how often they were right."""

    lower: float
    mean: float
    right: Rate


@dataclass(frozen=True)
class Calibration:
    """Whether probabilities are what they say.

    Attributes
    ----------
    curve : tuple of Reliable
        Of the tenths that are not empty.
    error : float
        Expected calibration error: mean distance of the curve from the diagonal, weighted by counts.
    brier, log : float
        Mean squared error, and mean negative logarithm of the probability given to what was so.
    """

    count: int
    curve: tuple[Reliable, ...]
    error: float
    brier: float
    log: float


def calibration(probability: Array, right: NDArray[np.bool_]) -> Calibration:
    """Calibration of claims.

    Parameters
    ----------
    probability : ndarray (n,)
    right : ndarray (n,)
        Whether each was so.
    """
    if not len(probability):
        return Calibration(0, (), *3 * (float("nan"),))
    place = np.minimum((10 * probability).astype(int), 9)
    curve = tuple(
        Reliable(tenth / 10, float(probability[place == tenth].mean()), Rate(int(right[place == tenth].sum()), int(count)))
        for tenth, count in enumerate(np.bincount(place, minlength=10))
        if count
    )
    given = np.clip(np.where(right, probability, 1 - probability), LEAST_PROBABILITY, None)
    return Calibration(
        count=len(probability),
        curve=curve,
        error=sum(one.right.of * abs(one.mean - one.right.value) for one in curve) / len(probability),
        brier=float(np.mean((probability - right) ** 2)),
        log=float(-np.mean(np.log(given))),
    )
