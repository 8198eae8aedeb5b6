"""Means over cycles and runs, with their intervals."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit  # scipy.stats, which has it too, takes a third of a second to import

RUNS_FOR_INTERVAL = 3
"""From this number of runs on, the interval follows from the differences between runs, which those between cycles of a run
do not show."""


class Average(NamedTuple):
    """Mean of a number over cycles and runs, in the order of the fields of a `Value`."""

    value: float
    lower: float
    upper: float
    scatter: float
    cycles: int
    runs: int


def average(numbers: Sequence[float], runs: Sequence[str]) -> Average:
    """Average a number over cycles.

    Parameters
    ----------
    numbers : sequence of float
        One of each cycle, at least one.
    runs : sequence of str
        Name of the run of each.

    Returns
    -------
    Average
        Its interval is that of Student's t distribution: over the means of the runs where there are at least
        `RUNS_FOR_INTERVAL`, else over the cycles.
    """
    values, names = np.asarray(numbers, np.float64), np.asarray(runs)
    value, distinct = float(values.mean()), np.unique(names)
    if len(values) < 2:
        return Average(value, math.nan, math.nan, math.nan, len(values), len(distinct))
    units = values
    if len(distinct) >= RUNS_FOR_INTERVAL:
        units = np.array([values[names == name].mean() for name in distinct])
    half = float(stdtrit(len(units) - 1, 0.975) * units.std(ddof=1) / math.sqrt(len(units)))
    return Average(value, value - half, value + half, float(values.std(ddof=1)), len(values), len(distinct))


def intercept(columns: ArrayLike, numbers: ArrayLike) -> tuple[float, float, float]:
    """Return the coefficient of the first column by least squares, half its 95 % interval, and the residual scatter.

    Both are nan where there are as many coefficients as numbers.
    """
    design, values = np.asarray(columns, np.float64), np.asarray(numbers, np.float64)
    inverse = np.linalg.pinv(design)
    coefficients = inverse @ values
    degrees = len(values) - design.shape[1]
    if degrees < 1:
        return float(coefficients[0]), math.nan, math.nan
    scatter = float(np.linalg.norm(values - design @ coefficients)) / math.sqrt(degrees)
    return float(coefficients[0]), float(stdtrit(degrees, 0.975)) * scatter * float(np.linalg.norm(inverse[0])), scatter
