"""Smoothed motion: position, velocity and acceleration, estimated together from the measured position of a whole run.

This is the one place where the software differentiates a measured position. How much to smooth is estimated from the run
itself (`mrd_runs.signals.motion_model`). A Kalman filter and a fixed-interval smoother (Durbin and Koopman 2012, §4.4 and
§6.4) then give all derivatives at every sample. `motion_errors` draws what they may be wrong by.
"""

import math
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.signals.kalman import draw_errors
from mrd_runs.signals.motion_model import (
    ORDERS,
    MotionModel,
    Segment,
    fit_accelerometer_model,
    fit_position_model,
    smooth_by_model,
)
from mrd_runs.signals.quantisation import quantisation_variance, rounding_error

Array = NDArray[np.float64]

# Resolution in m that no position sensor reaches.
_FINEST = 1e-15
# With fewer samples there is nothing to estimate the smoothing from.
_FEWEST_SAMPLES = 10


@dataclass(frozen=True)
class Motion:
    """Smoothed motion of a rod: three series that are derivatives of each other.

    Attributes
    ----------
    position, velocity, acceleration : ndarray (n,)
        Position in m, velocity in m/s, acceleration in m/s².
    position_noise : float
        Standard deviation of the position readings in m.
    order : int
        Order of the derivative of the position that the model takes for white noise.
    time_constant : float
        Time in s over which the weights of the smoother decrease.
    accelerometer : tuple of float or None
        Gain and offset (m/s²) of the accelerometer; None where it was not used.
    note : str
        Why a recorded accelerometer was not used; empty otherwise.
    model : MotionModel or None
        The fitted model; None where the rod stood still.
    """

    position: Array
    velocity: Array
    acceleration: Array
    position_noise: float
    order: int
    time_constant: float
    accelerometer: tuple[float, float] | None = None
    note: str = ""
    model: MotionModel | None = field(default=None, repr=False)


def smooth_motion(time: Array, position: Array, acceleration: Array | None = None) -> Motion:
    """Smooth and differentiate a measured position.

    Parameters
    ----------
    time : ndarray (n,)
        Time in s, strictly increasing; the intervals may vary.
    position : ndarray (n,)
        Measured position in m.
    acceleration : ndarray (n,), optional
        Measured acceleration in m/s² with unknown gain (0.8 to 1.25) and offset. It is not used where it is constant, where
        its gain is outside of that range, or where it makes the positions less likely.

    Raises
    ------
    InputError
        For fewer than ten samples.

    Notes
    -----
    The noise variance is at least that of the quantisation error (`quantisation_variance`), so that the estimate stays
    well-posed for positions without noise.
    """
    time, position = np.ascontiguousarray(time, np.float64), np.ascontiguousarray(position, np.float64)
    if len(time) < _FEWEST_SAMPLES:
        raise InputError(f"{len(time)} samples, expected at least {_FEWEST_SAMPLES} to differentiate a motion")
    if np.ptp(position) == 0.0:
        zeros = np.zeros_like(position)
        return Motion(position.copy(), zeros, zeros.copy(), 0.0, ORDERS[0], math.inf)
    intervals, interval = _relative_intervals(time)
    # Positions count from the first one, so that a large offset costs no digits.
    readings = Segment(intervals, position - position[0], np.zeros_like(position))
    least_noise = quantisation_variance(position, max(rounding_error(position), _FINEST))
    model, note = fit_position_model(readings, least_noise), ""
    if acceleration is not None:
        readings.acceleration = np.asarray(acceleration, np.float64) * interval**2
        model, note = fit_accelerometer_model(readings, least_noise, model)
        readings.acceleration = readings.acceleration - model.offset
    return _motion(readings, interval, position[0], model, note)


def subdivided_indices(samples: int, parts: int | NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the indices (n,) of the samples after every sampling interval is divided into parts.

    ``parts`` is the number of parts of every interval, or that of each interval (n - 1,).
    """
    return np.concatenate([[0], np.cumsum(np.broadcast_to(parts, samples - 1))])


def subdivide(series: Array, parts: int | NDArray[np.intp]) -> Array:
    """Interpolate a series (n,), such as the time, linearly at the points of `subdivided_indices`; return it (m,)."""
    indices = subdivided_indices(len(series), parts)
    return np.interp(np.arange(indices[-1] + 1), indices, series)


def motion_between_samples(time: Array, motion: Motion, parts: int | NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Return smoothed position, velocity and acceleration (m,) on a subdivided ``time`` (n,), see `subdivided_indices`.

    Between two samples the smoother (order 3) expects the polynomial of fifth degree that matches all three series there.
    """
    x, v, a = motion.position, motion.velocity, motion.acceleration
    if np.all(parts == 1):
        return x, v, a
    step = np.diff(time)
    # The same as BPoly.from_derivatives, which works interval by interval and takes as long as a fit.
    leaving = x[:-1], x[:-1] + step * v[:-1] / 5, x[:-1] + step * (2 * v[:-1] / 5 + step * a[:-1] / 20)
    arriving = x[1:] - step * (2 * v[1:] / 5 - step * a[1:] / 20), x[1:] - step * v[1:] / 5, x[1:]
    position = scipy.interpolate.BPoly(np.stack([*leaving, *arriving]), time)
    fine = subdivide(time, parts)
    return position(fine), position(fine, 1), position(fine, 2)


def motion_errors(
    time: Array, motion: Motion, rng: np.random.Generator, count: int, parts: int = 1
) -> tuple[Array, Array, Array]:
    """Draw errors (smoothed minus true) of a smoothed motion.

    Parameters
    ----------
    time : ndarray (n,)
        Time of the samples in s.
    motion : Motion
    rng : numpy Generator
    count : int
        Number of draws.
    parts : int
        Number of parts into which every sampling interval is divided, see `subdivided_indices`.

    Returns
    -------
    position, velocity, acceleration : ndarray (count, m)
        Errors in m, m/s and m/s²; in each draw they are derivatives of each other. They are 0 where the rod stood still.

    Notes
    -----
    The draws follow exactly the distribution of the errors under the model. They run backwards in time, each state given the
    next one (Frühwirth-Schnatter 1994), so that nothing grows with the length of the run. Gain and offset of the
    accelerometer are taken as known.
    """
    model = motion.model
    instants = (len(time) - 1) * parts + 1
    if model is None:
        return np.zeros((count, instants)), np.zeros((count, instants)), np.zeros((count, instants))
    intervals, interval = _relative_intervals(time)
    intervals = np.append(np.repeat(intervals[:-1] / parts, parts), 1.0)
    normal = rng.standard_normal((instants, count, model.order))
    h = model.relative_interval
    drawn = draw_errors(intervals * h, parts, normal, h, model.gain, model.kernel_variance)
    position, velocity, acceleration = drawn * math.sqrt(model.noise)
    return position, velocity * (h / interval), acceleration * (h / interval) ** 2


def remeasured_motion(
    time: Array, motion: Motion, acceleration: Array | None, rng: np.random.Generator
) -> tuple[Array, Array | None, Motion]:
    """Draw new readings along a smoothed motion and smooth them by the same model.

    Parameters
    ----------
    time : ndarray (n,)
        Time in s.
    motion : Motion
    acceleration : ndarray (n,) or None
        Measured acceleration in m/s²; new readings replace it where the accelerometer was used.
    rng : numpy Generator

    Returns
    -------
    position : ndarray (n,)
        New readings in m.
    acceleration : ndarray (n,) or None
        New readings in m/s².
    motion : Motion
        Smoothed from the new readings.
    """
    model = motion.model
    if model is None:
        return motion.position, acceleration, motion
    intervals, interval = _relative_intervals(time)
    position = motion.position + rng.normal(0.0, math.sqrt(model.noise), len(time))
    readings = Segment(intervals, position - position[0], np.zeros(len(time)))
    if model.gain:
        noise = rng.normal(0.0, math.sqrt(model.noise * model.relative_variance), len(time))
        readings.acceleration = model.gain * motion.acceleration * interval**2 + noise
        acceleration = (readings.acceleration + model.offset) / interval**2
    return position, acceleration, _motion(readings, interval, position[0], model)


def _relative_intervals(time: Array) -> tuple[Array, float]:
    """Return the intervals (n,) in units of their median (the last one is not used), and the median in s."""
    interval = float(np.median(np.diff(time)))
    return np.append(np.diff(time) / interval, 1.0), interval


def _motion(readings: Segment, interval: float, origin: float, model: MotionModel, note: str = "") -> Motion:
    """Smooth readings by a model and return the motion in SI units; ``origin`` is the first position."""
    states = smooth_by_model(readings, model)
    return Motion(
        states[:, 0] + origin,
        states[:, 1] / interval,
        states[:, 2] / interval**2,
        math.sqrt(model.noise),
        model.order,
        interval / model.relative_interval,
        (model.gain, model.offset / interval**2) if model.gain else None,
        note,
        model,
    )
