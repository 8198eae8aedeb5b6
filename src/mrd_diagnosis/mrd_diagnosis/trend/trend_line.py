"""Trend line through dated values, with a change point where there is one, and when it reaches a limit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.change_point import ChangePoint, clearest_change
from mrd_diagnosis.trend.regression import Regression, regress

Array = NDArray[np.float64]

FEWEST_DATES = 3
"""Dates of a trend. With two dates, no degree of freedom is left to tell a trend from scatter."""
FEWEST_DATES_FOR_CHANGE = 6
"""Dates of a series in which a change point is looked for: three on each side of it."""
CHANGE_ALPHA = 0.02
"""Share of series without a change point in which one is reported. A false alarm costs more than one date of waiting."""


@dataclass(frozen=True)
class TrendLine:
    """Straight line through dated values, with a step or a bend where there is a change point.

    Attributes
    ----------
    times : ndarray (dates,)
    regression : Regression
        Coefficients: value at time 0, slope, and size of the change if there is one.
    change : ChangePoint or None
    p_change : float
        p-value of the clearest candidate for a change point; nan where there are too few dates to look for one.
    """

    times: Array
    regression: Regression
    change: ChangePoint | None
    p_change: float

    @property
    def slope(self) -> Interval:
        """Change of the value per unit of time; after a bend, if there is one."""
        combination = np.zeros(len(self.regression.coefficients))
        combination[1] = 1.0
        if self.change is not None and self.change.kind == "bend":
            combination[2] = 1.0
        return self.regression.interval(combination)

    @property
    def change_size(self) -> Interval | None:
        """Jump of the value at a step, or change of the slope at a bend."""
        return None if self.change is None else self.regression.interval(np.array([0.0, 0.0, 1.0]))

    @property
    def scatter(self) -> float:
        """Standard deviation from date to date beyond what the intervals of the dates explain."""
        return self.regression.scatter

    def predict(self, times: Array) -> tuple[Array, Array, Array]:
        """Return the line at some times and the ends of its 95 % interval, each (times,)."""
        design = _design(self.times, np.asarray(times, np.float64), self.change)
        value = design @ self.regression.coefficients
        variance = np.einsum("ij,jk,ik->i", design, self.regression.covariance, design)
        half = self.regression.student_t * np.sqrt(variance)
        return value, value - half, value + half

    def crossing(self, limit: float) -> Interval | None:
        """Return the time at which the extrapolated line reaches a limit, with its 95 % interval (Fieller, 1954).

        None where the line leads away from the limit, or where the sign of its slope is not certain.
        """
        last = float(self.times[-1])
        here, ahead = _design(self.times, np.array([last, last + 1.0]), self.change)
        step = ahead - here
        coefficients, covariance = self.regression.coefficients, self.regression.covariance
        distance, slope = float(here @ coefficients) - limit, float(step @ coefficients)
        t2 = self.regression.student_t**2
        (v00, v01), (_, v11) = (t2 * (row @ covariance @ np.stack([here, step], axis=1)) for row in (here, step))
        square, linear, constant = slope**2 - v11, distance * slope - v01, distance**2 - v00
        if square <= 0.0 or distance * slope >= 0.0:
            return None
        root = np.sqrt(max(linear**2 - square * constant, 0.0))
        return Interval(last - distance / slope, last + (-linear - root) / square, last + (-linear + root) / square)


def fit_trend_line(times: Array, values: Array, covariance: Array, seed: int = 0) -> TrendLine:
    """Fit a trend line to dated values by a random-effects meta-regression, with a change point if one is clear.

    Parameters
    ----------
    times : ndarray (dates,)
        Increasing.
    values : ndarray (dates,)
    covariance : ndarray (dates, dates)
        Covariance of the errors of the values.
    seed : int
        Seed of the simulated series that a change point is compared with.
    """
    regression = regress(_design(times, times), values, covariance)
    change, p_change = None, float("nan")
    if len(times) >= FEWEST_DATES_FOR_CHANGE:
        candidate, p_change = clearest_change(times, values, regression, seed)
        if p_change <= CHANGE_ALPHA:
            change = candidate
            regression = regress(_design(times, times, change), values, covariance)
    return TrendLine(times, regression, change, p_change)


def _design(dates: Array, times: Array, change: ChangePoint | None = None) -> Array:
    """Return the design matrix (times, coefficients) of a line at some times."""
    columns = [np.ones_like(times), times]
    return np.column_stack(columns if change is None else [*columns, change.effect(dates, times)])
