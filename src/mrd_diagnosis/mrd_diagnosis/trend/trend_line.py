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
"""Dates of a series in which a change point is looked for: beside a line and a change, three degrees of freedom are left."""
CHANGE_ALPHA = 0.02
"""Share of series without a change point in which one is reported. A false alarm costs more than one date of waiting."""
LONGEST_PREDICTION = 10.0
"""Time after the last date, over the time between the dates, for which a line says nothing any more."""


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
        """Return the time at which the line reaches a limit, or has passed it, with its 95 % interval (Fieller, 1954).

        None where the line leads away from a limit that it has not passed, where the sign of its slope is not certain, or
        where the limit is farther than `LONGEST_PREDICTION`.
        """
        last, span = float(self.times[-1]), float(self.times[-1] - self.times[0])
        distances = self.predict(self.times)[0] - limit
        if distances[0] * distances[-1] < 0.0:
            after = int(np.flatnonzero(distances * distances[-1] <= 0.0)[-1]) + 1
            begin, end = float(self.times[after - 1]), float(self.times[after])
            passed = self._crossing_between(limit, begin, end)
            # When a step was between its two dates, nobody knows.
            in_step = self.change is not None and self.change.kind == "step" and self.change.after == after
            return Interval(passed.value, begin, end) if passed and in_step else passed
        crossing = self._crossing_between(limit, last, last + span)
        return crossing if crossing and last <= crossing.value <= last + LONGEST_PREDICTION * span else None

    def _crossing_between(self, limit: float, begin: float, end: float) -> Interval | None:
        """Return where the line through its values at two times reaches a limit; None where its slope may be none."""
        here, there = _design(self.times, np.array([begin, end]), self.change)
        step = (there - here) / (end - begin)
        coefficients, covariance = self.regression.coefficients, self.regression.covariance
        distance, slope = float(here @ coefficients) - limit, float(step @ coefficients)
        t2 = self.regression.student_t**2
        (v00, v01), (_, v11) = (t2 * (row @ covariance @ np.stack([here, step], axis=1)) for row in (here, step))
        square, linear, constant = slope**2 - v11, distance * slope - v01, distance**2 - v00
        if square <= 0.0:
            return None
        root = np.sqrt(max(linear**2 - square * constant, 0.0))
        return Interval(begin - distance / slope, begin + (-linear - root) / square, begin + (-linear + root) / square)


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
