"""Stochastic model of a rod's motion, estimated from the readings by maximum likelihood.

The motion is white noise integrated `order` times: the third derivative of the position, the jerk, is white for order 3, and
orders 4 and 5 are smoother motions. The state (x, ẋ, ẍ, …) is advanced exactly over each sampling interval (Bar-Shalom, Li
and Kirubarajan 2001, §6.2). The position is read with white noise; an accelerometer, where there is one, is a second reading
with unknown gain and offset. Order, time constant, gain and noise maximise the likelihood of the run (Harvey 1989, §3.4).

Lengths are in m and times in sampling intervals, so that accelerations are in m too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_runs.signals.kalman import innovation_sums, smooth_states

Array = NDArray[np.float64]

# The likelihood of a long run is summed over this number of evenly spread segments, each of this number of samples.
_SEGMENTS, _SEGMENT_LENGTH = 8, 2048
# Where the errors of prediction have this times the variance in the whole run, the segments do not stand for it.
_UNSEEN = 2.0
ORDERS = (3, 4, 5)
# Longest time constant of the smoother, in sampling intervals.
_LONGEST_TIME_CONSTANT = 1000.0
# Largest density of the white derivative over the noise variance; the smoother interpolates the readings there.
_LARGEST_DENSITY = 1e8
# Plausible gains of the accelerometer against the position. One outside does not measure the rod in m/s² (MMA7361L: ±7.5 %).
_GAIN_BOUNDS = (0.8, 1.25)


@dataclass(frozen=True)
class MotionModel:
    """Stochastic model of the motion and of its readings.

    Attributes
    ----------
    order : int
        Order of the derivative of the position that is white.
    relative_interval : float
        Sampling interval over the time constant of the smoother; it stands for the density of the white derivative.
    noise : float
        Variance of a position reading.
    log_likelihood : float
        Log-likelihood of all readings.
    position_log_likelihood : float
        Log-likelihood of the positions, each predicted from all earlier readings.
    gain, offset : float
        Gain and offset of the accelerometer; gain 0 when it is not used.
    relative_variance : float
        Variance of an accelerometer reading over `noise`.
    """

    order: int
    relative_interval: float
    noise: float = 1.0
    log_likelihood: float = -math.inf
    position_log_likelihood: float = -math.inf
    gain: float = 0.0
    offset: float = 0.0
    relative_variance: float = 1.0

    @property
    def kernel_variance(self) -> float:
        """Variance of the accelerometer in the units of the kernels."""
        return self.relative_variance / self.relative_interval**4


class Segment:
    """Contiguous readings: their intervals, positions around the first one, and accelerations."""

    def __init__(self, intervals: Array, position: Array, acceleration: Array) -> None:
        self.intervals, self.position, self.acceleration = intervals, position, acceleration
        self._fits: dict[tuple[int, int], Array] = {}

    def start(self, order: int, relative_interval: float) -> Array:
        """Return the state at the first sample, from a polynomial over two to four time constants."""
        # The length is a power of two, so that a search over the time constant needs few polynomials.
        count = min(max(2 * order, 2 ** math.ceil(math.log2(2 / relative_interval))), len(self.position))
        if (order, count) not in self._fits:
            self._fits[order, count] = self._polynomial(order, count)
        return self._fits[order, count] / relative_interval ** np.arange(order)

    def _polynomial(self, order: int, count: int) -> Array:
        """Return the derivatives at the first sample of a polynomial through the first samples."""
        chosen = np.unique(np.linspace(0, count - 1, min(count, 50)).astype(int))
        time = (np.cumsum(self.intervals[:count]) - self.intervals[0])[chosen]
        powers = (time[:, None] / time[-1]) ** np.arange(order)
        derivatives = np.cumprod(np.append(1.0, np.arange(1.0, order) / time[-1]))
        fit: Array = np.linalg.lstsq(powers, self.position[chosen], rcond=None)[0] * derivatives
        return fit

    def kernel_arguments(self, model: MotionModel) -> tuple[Array, Array, Array, Array, float, float, float]:
        """Return the arguments that the kernels share, in their units."""
        h = model.relative_interval
        start = self.start(model.order, h)
        return self.intervals * h, self.position, self.acceleration / h**2, start, h, model.gain, model.kernel_variance

    def spread(self, length: int) -> list["Segment"]:
        """Return evenly spread segments of a length, or this one where they would cover it."""
        if len(self.position) <= _SEGMENTS * length:
            return [self]
        starts = np.linspace(0, len(self.position) - length, _SEGMENTS).astype(int)
        cuts = [slice(start, start + length) for start in starts]
        return [Segment(self.intervals[cut], self.position[cut], self.acceleration[cut]) for cut in cuts]


def fit_position_model(readings: Segment, least_noise: float) -> MotionModel:
    """Fit the model to positions alone; their noise variance is at least ``least_noise``."""
    segments = readings.spread(_SEGMENT_LENGTH)
    model = _fit_orders(segments, least_noise)
    # The segments may miss what the rest of a long run holds, such as the few reversals of slow strokes.
    if len(segments) > 1 and _evaluate([readings], least_noise, model).noise > _UNSEEN * model.noise:
        return _fit_orders([readings], least_noise)
    return model


def _fit_orders(segments: Sequence[Segment], least_noise: float) -> MotionModel:
    return max((_fit_order(segments, least_noise, order) for order in ORDERS), key=lambda model: model.log_likelihood)


def fit_accelerometer_model(readings: Segment, least_noise: float, position_model: MotionModel) -> tuple[MotionModel, str]:
    """Fit the model to positions and accelerations.

    Returns
    -------
    model : MotionModel
        ``position_model`` where the accelerometer does not help.
    note : str
        Why the accelerometer is not used; empty when it is used.
    """
    if np.ptp(readings.acceleration) == 0.0:
        return position_model, "accelerometer not used: its reading is constant"
    # An accelerometer tells more than the position, so half of each segment is enough.
    segments = readings.spread(_SEGMENT_LENGTH // 2)
    fits = [_fit_order_with_accelerometer(segments, least_noise, order) for order in ORDERS]
    model = max(fits, key=lambda fit: fit.log_likelihood)
    if not _GAIN_BOUNDS[0] <= model.gain <= _GAIN_BOUNDS[1]:
        return position_model, (
            f"accelerometer not used: its gain against the position is {model.gain:.3g}, "
            f"expected {_GAIN_BOUNDS[0]} to {_GAIN_BOUNDS[1]} (is it the rod's, in m/s²?)"
        )
    without = _evaluate(segments, least_noise, position_model)
    if model.position_log_likelihood < without.position_log_likelihood:
        return position_model, "accelerometer not used: the positions are less likely with it than without"
    return model, ""


def smooth_by_model(readings: Segment, model: MotionModel) -> Array:
    """Return the smoothed x, ẋ, ẍ (n, 3)."""
    states: Array = smooth_states(*readings.kernel_arguments(model)) * model.relative_interval ** np.arange(3.0)
    return states


def _log_likelihood(n: float, squares: float, logs: float, least_noise: float) -> tuple[float, float]:
    """Return the log-likelihood at the best noise variance that is at least ``least_noise``, and that variance."""
    noise = max(squares / n, least_noise)
    return -0.5 * (n * math.log(noise) + logs + squares / noise), noise


def _evaluate(segments: Sequence[Segment], least_noise: float, model: MotionModel) -> MotionModel:
    """Return the model with its noise variance, offset and likelihood."""
    sums, h = np.zeros((2, 5)), model.relative_interval
    for segment in segments:
        sums += innovation_sums(*segment.kernel_arguments(model))
    total = sums.sum(axis=0)
    # The innovations depend linearly on the offset of the accelerometer, so its best value is a weighted mean.
    offset = total[2] / total[3] if total[3] > 0 else 0.0
    squares = sums[:, 1] - 2 * offset * sums[:, 2] + offset**2 * sums[:, 3]
    log_likelihood, noise = _log_likelihood(total[0], squares.sum(), total[4], least_noise)
    # The accelerations were scaled by the time constant, which changes their density.
    log_likelihood -= 2 * sums[1, 0] * math.log(h)
    position_log_likelihood, _ = _log_likelihood(sums[0, 0], squares[0], sums[0, 4], least_noise)
    return replace(
        model,
        noise=noise,
        log_likelihood=log_likelihood,
        position_log_likelihood=position_log_likelihood,
        offset=offset * h**2,
    )


def _log_interval_bounds(order: int) -> tuple[float, float]:
    """Return the bounds of the logarithm of the relative interval."""
    return -math.log(_LONGEST_TIME_CONSTANT), math.log(_LARGEST_DENSITY) / (2 * order)


def _fit_order(segments: Sequence[Segment], least_noise: float, order: int) -> MotionModel:
    """Fit the relative interval of a model of positions."""

    def model(log_interval: float) -> MotionModel:
        return _evaluate(segments, least_noise, MotionModel(order, math.exp(log_interval)))

    grid = np.linspace(*_log_interval_bounds(order), 10)
    best = int(np.argmax([model(value).log_likelihood for value in grid]))
    optimum = scipy.optimize.minimize_scalar(
        lambda value: -model(value).log_likelihood,
        bounds=(grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]),
        method="bounded",
        options={"xatol": 0.01},
    )
    return model(float(optimum.x))


def _fit_order_with_accelerometer(segments: Sequence[Segment], least_noise: float, order: int) -> MotionModel:
    """Fit relative interval, accelerometer noise and gain of a model of positions and accelerations."""
    bounds = _log_interval_bounds(order)

    def model(point: Array, segments: Sequence[Segment] = segments) -> MotionModel:
        log_interval, log_variance, gain = point
        h = math.exp(float(np.clip(log_interval, *bounds)))
        variance = math.exp(float(log_variance))
        return _evaluate(segments, least_noise, MotionModel(order, h, gain=float(gain), relative_variance=variance))

    # The likelihood may have several maxima, so the search starts at the best point of a coarse grid on a few segments.
    log_intervals, log_variances = np.linspace(*bounds, 9), np.linspace(-15.0, 15.0, 7)
    grid = [np.array([interval, variance, 1.0]) for interval in log_intervals for variance in log_variances]
    start = max(grid, key=lambda point: model(point, segments[::4]).log_likelihood)
    optimum = scipy.optimize.minimize(
        lambda point: -model(point).log_likelihood,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": start + np.array([[0, 0, 0], [0.7, 0, 0], [0, 3.0, 0], [0, 0, 0.05]]),
            "xatol": 1e-3,
            "fatol": 0.3,
            "maxfev": 80,
        },
    )
    return model(optimum.x)
