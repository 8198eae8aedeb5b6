"""From measured position to position, velocity and acceleration that fit together: the bench's one differentiator.

The rod's motion is taken as white noise integrated `order` times: the third derivative, the jerk, is white for order 3, and
orders 4 and 5 are smoother motions. The state (x, ẋ, ẍ, …) is advanced exactly over each sampling interval (Bar-Shalom, Li
and Kirubarajan 2001, §6.2), the position is read with white noise. A Kalman filter and a fixed-interval smoother (Durbin and
Koopman 2012, §4.4 and §6.4: no matrix is inverted) give all derivatives at every sample from the whole run, with their
variances. How much to smooth is not chosen but estimated: order and time constant maximise the likelihood of the run itself
(Harvey 1989, §3.4). Where an accelerometer was recorded, it is a second reading of the same motion, its gain and offset
estimated too.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.interpolate import BPoly

from mrd_base import InputError
from mrd_runs.signals.kalman import draw_errors, innovations, smoother

Array = NDArray[np.float64]

# The likelihood of long runs is summed over this many evenly spread stretches of this many samples.
_STRETCHES, _STRETCH = 8, 2048
_ORDERS = (3, 4, 5)
# Time constants of the smoother: up to this many sampling intervals, down to where it interpolates.
_LONGEST, _INTERPOLATION = 1000.0, 1e8
# m; no reading of a position is finer.
_FINEST = 1e-15
# An accelerometer that disagrees more than this with the position is not one of the rod in m/s² (MMA7361L: ±7.5 %).
_GAIN_BOUNDS = (0.8, 1.25)


@dataclass(frozen=True)
class Motion:
    """A rod's motion, smoothed: three series that are derivatives of each other.

    Attributes
    ----------
    position, velocity, acceleration : ndarray (n,)
        m, m/s, m/s².
    velocity_std : ndarray (n,)
        Standard deviation of `velocity`, m/s, as the model has it.
    position_noise : float
        Standard deviation of the position readings, m.
    order : int
        Which derivative of the position is white.
    time_constant : float
        s; the weights of the smoother fall off within about this time.
    accelerometer : tuple of float or None
        Gain and offset (m/s²) of the accelerometer where it was used.
    note : str
        Why a recorded accelerometer was not used; empty otherwise.
    model : MotionModel or None
        The fitted stochastic model; None where the rod stood still.
    """

    position: Array
    velocity: Array
    acceleration: Array
    velocity_std: Array
    position_noise: float
    order: int
    time_constant: float
    accelerometer: tuple[float, float] | None = None
    note: str = ""
    model: "MotionModel | None" = field(default=None, repr=False)


def smooth_motion(time: Array, position: Array, acceleration: Array | None = None) -> Motion:
    """Smooth and differentiate a measured position.

    Parameters
    ----------
    time : ndarray (n,)
        s, strictly increasing; intervals may vary.
    position : ndarray (n,)
        m, as measured.
    acceleration : ndarray (n,), optional
        m/s², as measured, with unknown gain (0.8 to 1.25) and offset. It is left out where it is constant, where its gain
        leaves that range, or where it makes the positions less likely than they are without it.

    Returns
    -------
    Motion

    Raises
    ------
    InputError
        For fewer than ten samples.

    Notes
    -----
    The noise variance has a lower bound: the variance of the quantisation error (step²/12, times the mean number of samples
    between two changes of the reading, as the error stays while the reading does). Noise-free data so stay well-posed.
    """
    time, position = np.ascontiguousarray(time, np.float64), np.ascontiguousarray(position, np.float64)
    if len(time) < 10:
        raise InputError(f"{len(time)} samples, expected at least 10 to differentiate a motion")
    if np.ptp(position) == 0.0:
        rest = np.zeros_like(position)
        return Motion(position.copy(), rest, rest.copy(), rest.copy(), 0.0, _ORDERS[0], math.inf)
    steps, interval = _clock(time)
    # Around the first position, so that a large offset costs no digits.
    reading = position - position[0]
    floor = _quantisation_variance(position)
    model = max((_fit_position(steps, reading, floor, order) for order in _ORDERS), key=lambda fit: fit.score)
    second, note = np.zeros_like(reading), ""
    if acceleration is not None:
        scaled = np.asarray(acceleration, np.float64) * interval**2
        model, note = _fit_both(steps, reading, scaled, floor, model)
        second = scaled - model.offset
    return _motion(steps, interval, position[0], reading, second, model, note)


def divided(samples: int, parts: int | NDArray[np.intp]) -> NDArray[np.intp]:
    """Where samples (n,) are once every interval is divided into so many parts, all alike or each (n - 1,) as it says."""
    return np.concatenate([[0], np.cumsum(np.broadcast_to(parts, samples - 1))])


def finer(series: Array, parts: int | NDArray[np.intp]) -> Array:
    """A series (n,), the clock itself among them, with every interval `divided`: (m,), straight between."""
    places = divided(len(series), parts)
    return np.interp(np.arange(places[-1] + 1), places, series)


def between_samples(time: Array, motion: Motion, parts: int | NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Smoothed position, velocity and acceleration (m,) with the intervals of ``time`` (n,) `divided`.

    The polynomials of fifth degree that match all three at the samples are what the smoother expects there (order 3).
    """
    x, v, a = motion.position, motion.velocity, motion.acceleration
    if np.all(parts == 1):
        return x, v, a
    step = np.diff(time)
    # What BPoly.from_derivatives gives too, interval by interval: as slow as a fit.
    leaving = x[:-1], x[:-1] + step * v[:-1] / 5, x[:-1] + step * (2 * v[:-1] / 5 + step * a[:-1] / 20)
    arriving = x[1:] - step * (2 * v[1:] / 5 - step * a[1:] / 20), x[1:] - step * v[1:] / 5, x[1:]
    position = BPoly(np.stack([*leaving, *arriving]), time)
    fine = finer(time, parts)
    return position(fine), position(fine, 1), position(fine, 2)


def motion_errors(
    time: Array, motion: Motion, rng: np.random.Generator, count: int, parts: int = 1
) -> tuple[Array, Array, Array]:
    """Draw errors of a smoothed motion (smoothed minus true).

    Parameters
    ----------
    time : ndarray (n,)
        s, of the samples.
    motion : Motion
    rng : numpy Generator
    count : int
        Number of draws.
    parts : int
        Also between the samples, on a clock (m,) finer by so much; see `between_samples`.

    Returns
    -------
    position, velocity, acceleration : ndarray (count, m)
        m, m/s, m/s²; in each draw derivatives of each other. Zero where the rod stood still.

    Notes
    -----
    Drawn exactly from the distribution that the fitted process leaves, backwards in time, each state given the next one
    (Frühwirth-Schnatter 1994), so that nothing grows with the length of the run. Gain and offset of an accelerometer count
    as known.
    """
    model = motion.model
    many = (len(time) - 1) * parts + 1
    if model is None:
        return np.zeros((count, many)), np.zeros((count, many)), np.zeros((count, many))
    steps, interval = _clock(time)
    steps = np.append(np.repeat(steps[:-1] / parts, parts), 1.0)
    normal = rng.standard_normal((many, count, model.order))
    pace = model.pace
    drawn = draw_errors(steps * pace, parts, normal, pace, model.gain, model.second_noise / pace**4)
    position, velocity, acceleration = drawn * math.sqrt(model.noise)
    return position, velocity * (pace / interval), acceleration * (pace / interval) ** 2


def remeasured_motion(
    time: Array, motion: Motion, acceleration: Array | None, rng: np.random.Generator
) -> tuple[Array, Array | None, Motion]:
    """Draw new readings along a smoothed motion and smooth them by the same motion model.

    Parameters
    ----------
    time : ndarray (n,)
        s.
    motion : Motion
    acceleration : ndarray (n,) or None
        As measured; replaced by new readings where the accelerometer was used.
    rng : numpy Generator

    Returns
    -------
    position : ndarray (n,)
        m, new readings.
    acceleration : ndarray (n,) or None
        m/s², new readings.
    motion : Motion
        Smoothed from the new readings.
    """
    model = motion.model
    if model is None:
        return motion.position, acceleration, motion
    steps, interval = _clock(time)
    position = motion.position + rng.normal(0.0, math.sqrt(model.noise), len(time))
    second = np.zeros(len(time))
    if model.gain:
        noise = rng.normal(0.0, math.sqrt(model.noise * model.second_noise), len(time))
        second = model.gain * motion.acceleration * interval**2 + noise
        acceleration = (second + model.offset) / interval**2
    again = _motion(steps, interval, position[0], position - position[0], second, model)
    return position, acceleration, again


def _clock(time: Array) -> tuple[Array, float]:
    """Steps between samples, in sampling intervals (the last one is not used), and that interval in s."""
    interval = float(np.median(np.diff(time)))
    return np.append(np.diff(time) / interval, 1.0), interval


@dataclass(frozen=True)
class MotionModel:
    """Stochastic model of a run; lengths in m, times in sampling intervals.

    `pace` is the sampling interval over the smoother's time constant; it stands for the intensity of the white derivative.
    """

    order: int
    pace: float
    noise: float = 1.0  # variance of a position reading
    score: float = -math.inf  # log-likelihood of everything read
    position_score: float = -math.inf  # of the positions, each predicted from all earlier readings
    gain: float = 0.0  # of the accelerometer; 0: not used
    offset: float = 0.0
    second_noise: float = 1.0  # variance of the accelerometer over `noise`


def _quantisation_variance(position: Array) -> float:
    """Least variance of the reading's error, from the step of its digits."""
    rounding = max(8 * np.finfo(float).eps * float(np.abs(position).max()), _FINEST)
    gaps = np.diff(np.unique(position))
    gaps = gaps[gaps > rounding]
    if len(gaps) == 0:
        return rounding**2
    step = float(gaps.min())
    remainder = np.abs(gaps / step - np.round(gaps / step))
    if np.mean(remainder < 1e-3) < 0.99:  # no common step: not quantised, or averaged
        return rounding**2
    held = len(position) / (1 + np.count_nonzero(np.diff(position)))
    return max(step**2 / 12 * held, rounding**2)


class _Stretch:
    """A contiguous part of a run: lengths in m, times in sampling intervals."""

    def __init__(self, steps: Array, reading: Array, second: Array) -> None:
        self.steps, self.reading, self.second = steps, reading, second
        self._starts: dict[tuple[int, int], Array] = {}

    def start(self, order: int, pace: float) -> Array:
        """State at the first sample from a polynomial over two to four time constants: the centre of a wide prior."""
        # Powers of two, so that a search over the pace needs few polynomials.
        count = min(max(2 * order, 2 ** math.ceil(math.log2(2 / pace))), len(self.reading))
        if (order, count) not in self._starts:
            chosen = np.unique(np.linspace(0, count - 1, min(count, 50)).astype(int))
            at = (np.cumsum(self.steps[:count]) - self.steps[0])[chosen]
            powers = (at[:, None] / at[-1]) ** np.arange(order)
            derivatives = np.cumprod(np.append(1.0, np.arange(1.0, order) / at[-1]))
            self._starts[order, count] = np.linalg.lstsq(powers, self.reading[chosen], rcond=None)[0] * derivatives
        return self._starts[order, count] / pace ** np.arange(order)


def _stretches(steps: Array, reading: Array, second: Array, length: int) -> list[_Stretch]:
    if len(reading) <= _STRETCHES * length:
        return [_Stretch(steps, reading, second)]
    starts = np.linspace(0, len(reading) - length, _STRETCHES).astype(int)
    cuts = [slice(start, start + length) for start in starts]
    return [_Stretch(steps[cut], reading[cut], second[cut]) for cut in cuts]


def _likelihood(n: float, squares: float, logs: float, floor: float) -> tuple[float, float]:
    """Log-likelihood at the best noise variance not below ``floor``, and that variance."""
    noise = max(squares / n, floor)
    return -0.5 * (n * math.log(noise) + logs + squares / noise), noise


def _evaluate(parts: list[_Stretch], floor: float, model: MotionModel) -> MotionModel:
    """The model with its noise variance, offset and likelihood."""
    sums, pace = np.zeros((2, 5)), model.pace
    for part in parts:
        sums += innovations(
            part.steps * pace,
            part.reading,
            part.second / pace**2,
            part.start(model.order, pace),
            pace,
            model.gain,
            model.second_noise / pace**4,
        )
    total = sums.sum(axis=0)
    # An offset of the accelerometer enters the prediction errors linearly: its best value is a weighted mean.
    offset = total[2] / total[3] if total[3] > 0 else 0.0
    squares = sums[:, 1] - 2 * offset * sums[:, 2] + offset**2 * sums[:, 3]
    score, noise = _likelihood(total[0], squares.sum(), total[4], floor)
    # The accelerometer's Jacobian: its readings were scaled by the time constant.
    score -= 2 * sums[1, 0] * math.log(model.pace)
    position_score, _ = _likelihood(sums[0, 0], squares[0], sums[0, 4], floor)
    return replace(model, noise=noise, score=score, position_score=position_score, offset=offset * model.pace**2)


def _fit_position(steps: Array, reading: Array, floor: float, order: int) -> MotionModel:
    parts = _stretches(steps, reading, np.zeros_like(reading), _STRETCH)

    def model(log_pace: float) -> MotionModel:
        return _evaluate(parts, floor, MotionModel(order, math.exp(log_pace)))

    lower, upper = _pace_bounds(order)
    grid = np.linspace(lower, upper, 10)
    best = int(np.argmax([model(value).score for value in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)])
    found = optimize.minimize_scalar(
        lambda value: -model(value).score, bounds=bounds, method="bounded", options={"xatol": 0.01}
    )
    return model(float(found.x))


def _pace_bounds(order: int) -> tuple[float, float]:
    return -math.log(_LONGEST), math.log(_INTERPOLATION) / (2 * order)


def _fit_both(steps: Array, reading: Array, second: Array, floor: float, alone: MotionModel) -> tuple[MotionModel, str]:
    """Model of position and accelerometer together; the model without it, and why, where it does not help."""
    if np.ptp(second) == 0.0:
        return alone, "accelerometer not used: its reading is constant"
    # The accelerometer tells more than the position: half of each stretch is enough.
    parts = _stretches(steps, reading, second, _STRETCH // 2)

    def model(order: int, point: Array, of: list[_Stretch] = parts) -> MotionModel:
        pace = math.exp(float(np.clip(point[0], *_pace_bounds(order))))
        return _evaluate(of, floor, MotionModel(order, pace, gain=float(point[2]), second_noise=math.exp(float(point[1]))))

    def fit(order: int) -> MotionModel:
        # The likelihood may have several maxima: start from the best point of a coarse grid over a part of the samples.
        paces, noises = np.linspace(*_pace_bounds(order), 9), np.linspace(-15.0, 15.0, 7)
        grid = [np.array([pace, noise, 1.0]) for pace in paces for noise in noises]
        start = max(grid, key=lambda point: model(order, point, parts[::4]).score)
        found = optimize.minimize(
            lambda point: -model(order, point).score,
            start,
            method="Nelder-Mead",
            options={
                "initial_simplex": start + np.array([[0, 0, 0], [0.7, 0, 0], [0, 3.0, 0], [0, 0, 0.05]]),
                "xatol": 1e-3,
                "fatol": 0.3,
                "maxfev": 80,
            },
        )
        return model(order, found.x)

    both = max((fit(order) for order in _ORDERS), key=lambda fit: fit.score)
    if not _GAIN_BOUNDS[0] <= both.gain <= _GAIN_BOUNDS[1]:
        return alone, (
            f"accelerometer not used: its gain against the position is {both.gain:.3g}, "
            f"expected {_GAIN_BOUNDS[0]} to {_GAIN_BOUNDS[1]} (is it the rod's, in m/s²?)"
        )
    if both.position_score < _evaluate(parts, floor, alone).position_score:
        return alone, "accelerometer not used: the positions are less likely with it than without"
    return both, ""


def _motion(
    steps: Array, interval: float, origin: float, reading: Array, second: Array, model: MotionModel, note: str = ""
) -> Motion:
    """The motion as this model has it; positions around ``origin``, times in sampling intervals."""
    states, variance = _smooth(steps, reading, second, model)
    return Motion(
        states[:, 0] + origin,
        states[:, 1] / interval,
        states[:, 2] / interval**2,
        np.sqrt(np.maximum(variance, 0.0)) / interval,
        math.sqrt(model.noise),
        model.order,
        interval / model.pace,
        (model.gain, model.offset / interval**2) if model.gain else None,
        note,
        model,
    )


def _smooth(steps: Array, reading: Array, second: Array, model: MotionModel) -> tuple[Array, Array]:
    """Smoothed (x, ẋ, ẍ) and variance of ẋ; lengths in m, times in sampling intervals."""
    pace, order = model.pace, model.order
    start = _Stretch(steps, reading, second).start(order, pace)
    states, variance = smoother(
        steps * pace, reading, second / pace**2, start, pace, model.gain, model.second_noise / pace**4
    )
    # The first samples' variances drown in the digits of the prior. They are those of the last ones: the model is the same
    # backwards in time.
    count = min(2 * order, len(variance) // 2)
    variance[:count] = variance[: -count - 1 : -1]
    return states * pace ** np.arange(3.0), variance * model.noise * pace**2
