"""Intervals of what a bootstrap over a few units, such as runs, resamples."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Array = NDArray[np.float64]


def half_width(units: int) -> float:
    """Return half of a 95 % interval over the standard deviation, where that follows from the scatter of so many units.

    It is Student's t, times the root of n / (n - 1), by which the deviation within a sample is too small. One unit has none.
    """
    return float(stdtrit(units - 1, 0.975) * np.sqrt(units / (units - 1))) if units > 1 else float("nan")


def widened(value: float, quantiles: Array, units: int) -> Array:
    """Return the ends of an interval about a value from the ``quantiles`` of a bootstrap over so many units; nan for one.

    The quantiles of a bootstrap of few units are too near to the value.
    """
    return value + half_width(units) / 1.96 * (quantiles - value)


def bootstrap_interval(value: float, drawn: Array, units: int) -> tuple[float, float]:
    """Return the 95 % interval about a value by the values (resamples,) of a bootstrap over so many units; nan for one."""
    lower, upper = widened(value, np.quantile(drawn, (0.025, 0.975)), units)
    return float(lower), float(upper)
