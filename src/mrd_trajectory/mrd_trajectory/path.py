"""Paths: position or current as piecewise polynomials of time, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Array = NDArray[np.float64]

# Number of coefficients of a quintic; paths with fewer are padded so that they can be concatenated.
_COEFFICIENTS = 6


class MotionState(NamedTuple):
    """Position (m), velocity (m/s) and acceleration (m/s²) of the rod at an instant."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


# At rest at mid-stroke.
REST = MotionState(0.0)


def state_at(path: PPoly, time: float) -> MotionState:
    """Return the state on a path at a time; at a break between two pieces, that of the later piece."""
    return MotionState(*(float(path(time, derivative)) for derivative in range(3)))


def end_state(path: PPoly) -> MotionState:
    """Return the state at the end of a path."""
    return state_at(scipy.interpolate.PPoly(path.c[:, -1:], path.x[-2:]), float(path.x[-1]))


def quintic_hermite(times: Array, level: Array, rate: Array, curvature: Array) -> PPoly:
    """Return the quintic Hermite interpolation of points with given first and second derivatives.

    Parameters
    ----------
    times, level, rate, curvature : ndarray (n,)
        Strictly increasing times, and values and derivatives at them; n ≥ 2.

    Returns
    -------
    PPoly
        Twice continuously differentiable; its error is of sixth order in the spacing of the points.
    """
    h = np.diff(times)
    x, v, a = level[:-1], rate[:-1], curvature[:-1]
    dx = level[1:] - x - v * h - a * h**2 / 2
    dv = (rate[1:] - v - a * h) * h
    da = (curvature[1:] - a) * h**2 / 2
    return scipy.interpolate.PPoly(
        np.array(
            [(6 * dx - 3 * dv + da) / h**5, (-15 * dx + 7 * dv - 2 * da) / h**4, (10 * dx - 4 * dv + da) / h**3, a / 2, v, x]
        ),
        times,
    )


def constant_jerk_path(start: MotionState, durations: Sequence[float], jerks: Sequence[float]) -> PPoly:
    """Return the path from a state through pieces of constant jerk; pieces without duration are omitted."""
    pieces = [(h, j) for h, j in zip(durations, jerks, strict=True) if h > 0] or [(0.0, 0.0)]
    coefficients, times = np.zeros((_COEFFICIENTS, len(pieces))), np.zeros(len(pieces) + 1)
    x, v, a = start
    for i, (h, j) in enumerate(pieces):
        coefficients[2:, i] = j / 6, a / 2, v, x
        times[i + 1] = times[i] + h
        x, v, a = x + h * (v + h * (a / 2 + h * j / 6)), v + h * (a + h * j / 2), a + h * j
    return scipy.interpolate.PPoly(coefficients, times)


def rest_path(position: float, duration: float) -> PPoly:
    """Return a path that rests at a position."""
    return constant_jerk_path(MotionState(position), [duration], [0.0])


def concatenate(paths: Sequence[PPoly]) -> PPoly:
    """Return the paths one after the other, each starting at the end time of the one before."""
    coefficients, times = [], [np.zeros(1)]
    for path in paths:
        if path.x[-1] > path.x[0]:
            missing = _COEFFICIENTS - len(path.c)
            coefficients.append(np.pad(path.c, ((missing, 0), (0, 0))))
            times.append(times[-1][-1] + path.x[1:] - path.x[0])
    if not coefficients:
        return paths[0]
    return scipy.interpolate.PPoly(np.concatenate(coefficients, axis=1), np.concatenate(times))


def cut(path: PPoly, duration: float) -> PPoly:
    """Return the first ``duration`` s of a path that starts at time 0."""
    count = int(np.searchsorted(path.x, duration * (1 - 1e-12)))
    return scipy.interpolate.PPoly(path.c[:, :count], np.append(path.x[:count], duration))


def extremes(path: PPoly, derivative: int = 0) -> tuple[float, float]:
    """Return the smallest and the largest value of a derivative of a path."""
    function = path.derivative(derivative)
    roots = function.derivative().roots(discontinuity=False, extrapolate=False)
    at_roots = function(roots[np.isfinite(roots)])
    # At a break both pieces count: the start of every piece, and its end by Horner's scheme.
    ends = np.zeros(len(path.x) - 1)
    for row in function.c:
        ends = ends * np.diff(path.x) + row
    values = np.concatenate([function.c[-1], ends, at_roots])
    return float(values.min()), float(values.max())


def largest_magnitude(path: PPoly, derivative: int = 0) -> float:
    """Return the largest magnitude of a derivative of a path."""
    low, high = extremes(path, derivative)
    return max(-low, high)
