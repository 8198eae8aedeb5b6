"""Piecewise polynomials of time: one form for every motion, with exact derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

Array = NDArray[np.float64]

# Coefficients of every path, so that paths can be joined: quintic.
_ORDER = 6


class State(NamedTuple):
    """Where the rod is and how it moves: m, m/s, m/s²."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


REST = State(0.0)


def state_at(path: PPoly, time: float) -> State:
    """State on a path at one time; at a break, the one after it."""
    return State(*(float(path(time, nu)) for nu in range(3)))


def hermite(times: Array, level: Array, rate: Array, curvature: Array) -> PPoly:
    """Quintic spline through points with given first and second derivatives.

    Parameters
    ----------
    times, level, rate, curvature : ndarray (n,)
        Strictly increasing times; values and derivatives there. n ≥ 2.

    Returns
    -------
    PPoly
        Twice continuously differentiable; between points its error is of sixth order in their spacing.
    """
    h = np.diff(times)
    x, v, a = level[:-1], rate[:-1], curvature[:-1]
    dx = level[1:] - x - v * h - a * h**2 / 2
    dv = (rate[1:] - v - a * h) * h
    da = (curvature[1:] - a) * h**2 / 2
    return PPoly(
        np.array(
            [(6 * dx - 3 * dv + da) / h**5, (-15 * dx + 7 * dv - 2 * da) / h**4, (10 * dx - 4 * dv + da) / h**3, a / 2, v, x]
        ),
        times,
    )


def from_jerk(start: State, durations: Sequence[float], jerks: Sequence[float]) -> PPoly:
    """Path from a state through pieces of constant jerk; pieces without duration are left out."""
    pieces = [(h, j) for h, j in zip(durations, jerks, strict=True) if h > 0] or [(0.0, 0.0)]
    coefficients, times = np.zeros((_ORDER, len(pieces))), np.zeros(len(pieces) + 1)
    x, v, a = start
    for i, (h, j) in enumerate(pieces):
        coefficients[2:, i] = j / 6, a / 2, v, x
        times[i + 1] = times[i] + h
        x, v, a = x + h * (v + h * (a / 2 + h * j / 6)), v + h * (a + h * j / 2), a + h * j
    return PPoly(coefficients, times)


def resting(position: float, duration: float) -> PPoly:
    """Rest at one position."""
    return from_jerk(State(position), [duration], [0.0])


def joined(paths: Sequence[PPoly]) -> PPoly:
    """Paths one after the other, each from the end of the one before."""
    coefficients, times = [], [np.zeros(1)]
    for path in paths:
        if path.x[-1] > path.x[0]:
            missing = _ORDER - len(path.c)
            coefficients.append(np.pad(path.c, ((missing, 0), (0, 0))))
            times.append(times[-1][-1] + path.x[1:] - path.x[0])
    if not coefficients:
        return paths[0]
    return PPoly(np.concatenate(coefficients, axis=1), np.concatenate(times))


def cut(path: PPoly, duration: float) -> PPoly:
    """The first ``duration`` of a path that starts at 0."""
    count = int(np.searchsorted(path.x, duration * (1 - 1e-12)))
    return PPoly(path.c[:, :count], np.append(path.x[:count], duration))


def extremes(path: PPoly, derivative: int = 0) -> tuple[float, float]:
    """Smallest and largest value of a derivative of a path, between its breaks as well as at them."""
    function = path.derivative(derivative)
    roots = function.derivative().roots(discontinuity=False, extrapolate=False)
    inner = function(roots[np.isfinite(roots)])
    ends = np.zeros(len(path.x) - 1)
    for row in function.c:
        ends = ends * np.diff(path.x) + row
    values = np.concatenate([function.c[-1], ends, inner])
    return float(values.min()), float(values.max())


def largest(path: PPoly, derivative: int = 0) -> float:
    """Largest magnitude of a derivative of a path."""
    low, high = extremes(path, derivative)
    return max(-low, high)
