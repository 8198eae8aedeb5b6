"""How dated values grow: trend, change point, when a limit is reached."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.special import stdtrit

from mrd_diagnosis.diagnosis import Interval

Array = NDArray[np.float64]

FEWEST_DATES = 3
"""Of a trend: with two, nothing is left to tell growth from scatter."""

FEWEST_FOR_CHANGE = 6
"""Dates of a series in which a change point is looked for."""

ALPHA = 0.02
"""Share of steady series in which a change point is seen: a false alarm costs more than one date of waiting."""

REPLICATES = 1999


@dataclass(frozen=True)
class Change:
    """A change point.

    Attributes
    ----------
    kind : {"step", "bend"}
        The values jump, or their slope changes.
    before, after : int
        Places of the dates that it lies between; a bend is at one, and both are the same.
    size : Interval
        Of the jump, or of the change of slope per unit of time.
    p_value : float
        Of so clear a change somewhere in a series that has none.
    """

    kind: Literal["step", "bend"]
    before: int
    after: int
    size: Interval
    p_value: float


@dataclass(frozen=True)
class Growth:
    """Dated values as a line, with a change point where there is one.

    Attributes
    ----------
    times : ndarray (dates,)
    slope : Interval
        Per unit of time; with a bend, after it.
    scatter : float
        Standard deviation from date to date beyond what the intervals of single dates explain.
    change : Change or None
    p_change : float
        Of the clearest candidate for a change point; nan where there are too few dates to look for one.
    """

    times: Array
    slope: Interval
    scatter: float
    change: Change | None
    p_change: float
    _coefficients: Array
    _covariance: Array

    def line(self, times: Array) -> tuple[Array, Array, Array]:
        """Line at some times, and the ends of its 95 % interval; each (times,)."""
        rows = self._rows(np.asarray(times, np.float64))
        middle = rows @ self._coefficients
        half = self._quantile * np.sqrt(np.einsum("ij,jk,ik->i", rows, self._covariance, rows))
        return middle, middle - half, middle + half

    def reaches(self, limit: float) -> Interval | None:
        """When the line, drawn on, reaches a limit; None where it leads elsewhere or its direction is not certain.

        Ends are those between which the limit lies within the interval of the line (Fieller, 1954).
        """
        last = float(self.times[-1])
        here, ahead = self._rows(np.array([last, last + 1.0]))
        onward = ahead - here
        distance, pace = float(here @ self._coefficients) - limit, float(onward @ self._coefficients)
        q2 = self._quantile**2
        (v00, v01), (_, v11) = (q2 * (a @ self._covariance @ np.stack([here, onward], axis=1)) for a in (here, onward))
        square, linear, constant = pace**2 - v11, distance * pace - v01, distance**2 - v00
        if square <= 0.0 or distance * pace >= 0.0:
            return None
        root = np.sqrt(max(linear**2 - square * constant, 0.0))
        return Interval(last - distance / pace, last + (-linear - root) / square, last + (-linear + root) / square)

    @property
    def _quantile(self) -> float:
        return float(stdtrit(len(self.times) - len(self._coefficients), 0.975))

    def _rows(self, times: Array) -> Array:
        rows = _line(times)
        return rows if self.change is None else np.column_stack([rows, _departure(self.times, times, self.change)])


def growth(times: Array, values: Array, covariance: Array, seed: int = 0) -> Growth:
    """Trend of dated values, of random effects: every date departs from the line by its own error and by more.

    The more is estimated (Paule & Mandel, 1982), and the intervals follow from how the dates scatter around the line (Knapp
    & Hartung, 2003), so that errors which all dates share or which are judged too large do no harm. A step or a bend is
    looked for between all dates, at least two on each side of a step and three with a bend; the clearest must be clearer
    than in all but 2 % of simulated series that only grow steadily. The slope beside it takes its place as given.

    Parameters
    ----------
    times : ndarray (dates,)
        Increasing.
    values : ndarray (dates,)
    covariance : ndarray (dates, dates)
        Of the errors of the values.
    seed : int
        Of the simulated series.
    """
    rows = _line(times)
    fitted = _regress(rows, values, covariance)
    change, p_change = None, float("nan")
    if len(times) >= FEWEST_FOR_CHANGE:
        candidate, p_change = _clearest_change(times, values, fitted, seed)
        if p_change <= ALPHA:
            with_change = np.column_stack([rows, _departure(times, times, candidate)])
            fitted = _regress(with_change, values, covariance)
            change = replace(candidate, size=fitted.interval(np.array([0.0, 0.0, 1.0])), p_value=p_change)
    onward = np.zeros(len(fitted.coefficients))
    onward[1] = 1.0
    if change is not None and change.kind == "bend":
        onward[2] = 1.0
    return Growth(times, fitted.interval(onward), fitted.scatter, change, p_change, fitted.coefficients, fitted.covariance)


@dataclass(frozen=True)
class _Regression:
    coefficients: Array
    covariance: Array
    scatter: float
    rows: Array
    root: Array

    def interval(self, of: Array) -> Interval:
        """Of a linear combination of the coefficients."""
        value = float(of @ self.coefficients)
        spare = len(self.rows) - len(self.coefficients)
        half = float(stdtrit(spare, 0.975) * np.sqrt(of @ self.covariance @ of))
        return Interval(value, value - half, value + half)


def _regress(rows: Array, values: Array, covariance: Array) -> _Regression:
    """Generalised least squares with scatter between the dates."""
    spare = len(values) - rows.shape[1]

    def solved(scatter: float) -> tuple[Array, Array, float, Array]:
        # A little of the mean keeps what has no errors at all regular.
        least = 1e-12 * float(np.trace(covariance) / len(values) + np.var(values)) + 1e-300
        root = cholesky(covariance + (scatter**2 + least) * np.eye(len(values)), lower=True)
        white = solve_triangular(root, np.column_stack([rows, values]), lower=True)
        inverse = np.linalg.pinv(white[:, :-1])
        coefficients = inverse @ white[:, -1]
        left = white[:, -1] - white[:, :-1] @ coefficients
        return coefficients, inverse @ inverse.T, float(left @ left), root

    largest = float(np.ptp(values)) or 1.0
    scatter = 0.0
    if solved(0.0)[2] > spare:
        scatter = float(brentq(lambda s: solved(s)[2] - spare, 0.0, 10.0 * largest, xtol=1e-9 * largest))
    coefficients, spread, left, root = solved(scatter)
    return _Regression(coefficients, spread * left / spare, scatter, rows, root)


def _clearest_change(times: Array, values: Array, steady: _Regression, seed: int) -> tuple[Change, float]:
    """The most likely change point, and how often steady series have one as clear (maximum statistic)."""
    candidates = list(_candidates(len(times)))
    departures = np.column_stack([_departure(times, times, candidate) for candidate in candidates])

    def white(columns: Array) -> Array:
        return np.asarray(solve_triangular(steady.root, columns, lower=True))

    basis = np.linalg.qr(white(steady.rows))[0]
    departures = white(departures)
    departures -= basis @ (basis.T @ departures)
    departures /= np.linalg.norm(departures, axis=0)
    spare = len(times) - 3

    def clearness(series: Array) -> Array:
        """F statistic (series, candidates) of adding each candidate to the line."""
        left = series - (series @ basis) @ basis.T
        gain = (left @ departures) ** 2
        return np.asarray(gain * spare / np.maximum((left**2).sum(axis=1)[:, None] - gain, 1e-12 * gain + 1e-300))

    observed = clearness(white(values)[None])[0]
    # White series are all that is needed: the statistic does not depend on line and scale.
    simulated = np.random.default_rng(seed).standard_normal((REPLICATES, len(times)))
    as_clear = int((clearness(simulated).max(axis=1) >= observed.max()).sum())
    return candidates[int(observed.argmax())], (1 + as_clear) / (1 + REPLICATES)


def _candidates(dates: int) -> Iterator[Change]:
    nothing = Interval(0.0)
    for after in range(2, dates - 1):
        yield Change("step", after - 1, after, nothing, 1.0)
    for at in range(2, dates - 2):
        yield Change("bend", at, at, nothing, 1.0)


def _line(times: Array) -> Array:
    return np.column_stack([np.ones_like(times), times])


def _departure(dates: Array, times: Array, change: Change) -> Array:
    """What a change of size one adds at some times."""
    if change.kind == "bend":
        return np.asarray(np.maximum(times - dates[change.before], 0.0))
    return np.asarray(times > 0.5 * (dates[change.before] + dates[change.after]), np.float64)
