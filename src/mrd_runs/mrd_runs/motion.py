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
import weakref
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import optimize
from scipy.interpolate import BPoly

from mrd_base import InputError
from mrd_runs.run import Run
from mrd_runs.steady import current_noise, steady

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
    _model: "_Model | None" = field(default=None, repr=False)


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


_MOTIONS: weakref.WeakKeyDictionary[Run, Motion] = weakref.WeakKeyDictionary()


def motion(run: Run) -> Motion:
    """Smoothed motion of a run, computed once: what models take as input (`Run.position` stays as measured)."""
    if run not in _MOTIONS:
        remember(run, smooth_motion(run.time, run.position, run.acceleration))
    return _MOTIONS[run]


def remember(run: Run, smoothed: Motion) -> None:
    """Let `motion` answer for this run with what has been computed already."""
    _MOTIONS[run] = smoothed


def carry_over(run: Run, other: Run) -> None:
    """Let `motion` answer for ``other``, the same recording, with what has been computed for ``run``."""
    if run in _MOTIONS:
        remember(other, _MOTIONS[run])


def divided(samples: int, parts: int | NDArray[np.intp]) -> NDArray[np.intp]:
    """Where samples (n,) are once every interval is divided into so many parts, all alike or each (n - 1,) as it says."""
    return np.concatenate([[0], np.cumsum(np.broadcast_to(parts, samples - 1))])


def finer(series: Array, parts: int | NDArray[np.intp]) -> Array:
    """A series (n,), the clock itself among them, with every interval `divided`: (m,), straight between."""
    places = divided(len(series), parts)
    return np.interp(np.arange(places[-1] + 1), places, series)


def between_samples(run: Run, parts: int | NDArray[np.intp]) -> tuple[Array, Array, Array]:
    """Smoothed position, velocity and acceleration (m,) of a run with its intervals `divided`.

    The polynomials of fifth degree that match all three at the samples are what the smoother expects there (order 3).
    """
    moved = motion(run)
    if np.all(parts == 1):
        return moved.position, moved.velocity, moved.acceleration
    step = np.diff(run.time)
    x, v, a = moved.position, moved.velocity, moved.acceleration
    # What BPoly.from_derivatives gives too, interval by interval: as slow as a fit.
    leaving = x[:-1], x[:-1] + step * v[:-1] / 5, x[:-1] + step * (2 * v[:-1] / 5 + step * a[:-1] / 20)
    arriving = x[1:] - step * (2 * v[1:] / 5 - step * a[1:] / 20), x[1:] - step * v[1:] / 5, x[1:]
    position = BPoly(np.stack([*leaving, *arriving]), run.time)
    time = finer(run.time, parts)
    return position(time), position(time, 1), position(time, 2)


def motion_errors(run: Run, rng: np.random.Generator, count: int, parts: int = 1) -> tuple[Array, Array, Array]:
    """Draw what the smoothed motion of a run may be wrong by (smoothed minus true).

    Parameters
    ----------
    run : Run
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
    model = motion(run)._model
    many = (len(run) - 1) * parts + 1
    if model is None:
        return np.zeros((count, many)), np.zeros((count, many)), np.zeros((count, many))
    steps, interval = _clock(run.time)
    steps = np.append(np.repeat(steps[:-1] / parts, parts), 1.0)
    normal = rng.standard_normal((many, count, model.order))
    pace = model.pace
    drawn = _draw_errors(steps * pace, parts, normal, pace, model.gain, model.second_noise / pace**4)
    position, velocity, acceleration = drawn * math.sqrt(model.noise)
    return position, velocity * (pace / interval), acceleration * (pace / interval) ** 2


def redrawn(run: Run, rng: np.random.Generator) -> Run:
    """The run as it might have been measured again: along its smoothed motion and steady current, with new noise.

    Its motion is smoothed by the model that was fitted to ``run``. The force stays.
    """
    moved, current = motion(run), steady(run)
    position, acceleration = moved.position, run.acceleration
    steps, interval = _clock(run.time)
    again = moved
    if moved._model is not None:
        model = moved._model
        position = position + rng.normal(0.0, math.sqrt(model.noise), len(run))
        second = np.zeros(len(run))
        if model.gain:
            noise = rng.normal(0.0, math.sqrt(model.noise * model.second_noise), len(run))
            second = model.gain * moved.acceleration * interval**2 + noise
            acceleration = (second + model.offset) / interval**2
        again = _motion(steps, interval, position[0], position - position[0], second, model)
    measured = replace(
        run,
        position=position,
        velocity=again.velocity,
        acceleration=acceleration,
        current=current + rng.normal(0.0, current_noise(run.current), len(run)),
    )
    remember(measured, again)
    return measured


def _clock(time: Array) -> tuple[Array, float]:
    """Steps between samples, in sampling intervals (the last one is not used), and that interval in s."""
    interval = float(np.median(np.diff(time)))
    return np.append(np.diff(time) / interval, 1.0), interval


@dataclass(frozen=True)
class _Model:
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


def _evaluate(parts: list[_Stretch], floor: float, model: _Model) -> _Model:
    """The model with its noise variance, offset and likelihood."""
    sums, pace = np.zeros((2, 5)), model.pace
    for part in parts:
        sums += _innovations(
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


def _fit_position(steps: Array, reading: Array, floor: float, order: int) -> _Model:
    parts = _stretches(steps, reading, np.zeros_like(reading), _STRETCH)

    def model(log_pace: float) -> _Model:
        return _evaluate(parts, floor, _Model(order, math.exp(log_pace)))

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


def _fit_both(steps: Array, reading: Array, second: Array, floor: float, alone: _Model) -> tuple[_Model, str]:
    """Model of position and accelerometer together; the model without it, and why, where it does not help."""
    if np.ptp(second) == 0.0:
        return alone, "accelerometer not used: its reading is constant"
    # The accelerometer tells more than the position: half of each stretch is enough.
    parts = _stretches(steps, reading, second, _STRETCH // 2)

    def model(order: int, point: Array, of: list[_Stretch] = parts) -> _Model:
        pace = math.exp(float(np.clip(point[0], *_pace_bounds(order))))
        return _evaluate(of, floor, _Model(order, pace, gain=float(point[2]), second_noise=math.exp(float(point[1]))))

    def fit(order: int) -> _Model:
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
    steps: Array, interval: float, origin: float, reading: Array, second: Array, model: _Model, note: str = ""
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


def _smooth(steps: Array, reading: Array, second: Array, model: _Model) -> tuple[Array, Array]:
    """Smoothed (x, ẋ, ẍ) and variance of ẋ; lengths in m, times in sampling intervals."""
    pace, order = model.pace, model.order
    start = _Stretch(steps, reading, second).start(order, pace)
    states, variance = _smoother(
        steps * pace, reading, second / pace**2, start, pace, model.gain, model.second_noise / pace**4
    )
    # The first samples' variances drown in the digits of the prior. They are those of the last ones: the model is the same
    # backwards in time.
    count = min(2 * order, len(variance) // 2)
    variance[:count] = variance[: -count - 1 : -1]
    return states * pace ** np.arange(3.0), variance * model.noise * pace**2


# The kernels count time in time constants of the smoother, which makes all elements of the state about equally large, and
# variances in units of the position's noise variance. In these units the spectral density of the white derivative is the
# sampling interval. The state has 3 to 5 elements; its small matrices are worked on in place.


@njit(cache=True, nogil=True)
def _prior(order, density):  # type: ignore[no-untyped-def]
    """Covariance of the first state: far wider than its error, narrow enough to keep the digits of what follows."""
    P = np.zeros((order, order))
    for i in range(order):
        P[i, i] = 1e4 * max(1.0, density) ** (2 * (order - i))
    return P


@njit(cache=True, nogil=True)
def _shares(order):  # type: ignore[no-untyped-def]
    """Covariance that the white derivative adds to the state in unit time at unit density."""
    Q = np.empty((order, order))
    for i in range(order):
        for j in range(order):
            a, b = order - 1 - i, order - 1 - j
            Q[i, j] = 1 / ((a + b + 1) * math.gamma(a + 1.0) * math.gamma(b + 1.0))
    return Q


@njit(cache=True, nogil=True)
def _set_interval(h, density, shares, F, Q):  # type: ignore[no-untyped-def]
    """Fill the transition ``F`` over ``h`` and the covariance ``Q`` added meanwhile."""
    order = F.shape[0]
    for i in range(order):
        F[i, i] = 1.0
        for j in range(i + 1, order):
            F[i, j] = F[i, j - 1] * h / (j - i)
    for i in range(order):
        power = density * h
        for _ in range(order - 1 - i):
            power *= h
        for j in range(order - 1, -1, -1):
            Q[i, j] = shares[i, j] * power
            power *= h


@njit(cache=True, nogil=True)
def _read(P, element, gain, noise, K):  # type: ignore[no-untyped-def]
    """Reduce ``P`` by one reading of gain·state[element]; fill the gains ``K``, return the variance of its prediction."""
    order = len(K)
    variance = gain * gain * P[element, element] + noise
    for i in range(order):
        K[i] = gain * P[i, element] / variance
    for i in range(order):
        if i != element:
            for j in range(order):
                if j != element:
                    P[i, j] -= K[i] * K[j] * variance
    # What the reading leaves of its own element, without the difference of two large numbers.
    for i in range(order):
        rest = K[i] * noise / gain
        P[i, element] = rest
        P[element, i] = rest
    return variance


@njit(cache=True, nogil=True)
def _advance(P, F, Q, work):  # type: ignore[no-untyped-def]
    """P ← F P Fᵀ + Q, in place; F is upper triangular."""
    order = P.shape[0]
    for i in range(order):
        for j in range(order):
            value = P[i, j]
            for k in range(i + 1, order):
                value += F[i, k] * P[k, j]
            work[i, j] = value
    for i in range(order):
        for j in range(i, order):
            value = work[i, j]
            for k in range(j + 1, order):
                value += work[i, k] * F[j, k]
            P[i, j] = value + Q[i, j]
            P[j, i] = P[i, j]


@njit(cache=True, nogil=True)
def _move(state, F):  # type: ignore[no-untyped-def]
    order = len(state)
    for i in range(order - 1):
        value = state[i]
        for j in range(i + 1, order):
            value += F[i, j] * state[j]
        state[i] = value


@njit(cache=True, nogil=True)
def _settled(P, before):  # type: ignore[no-untyped-def]
    """Whether the diagonal is still that of ``before``; ``before`` takes its values."""
    same = True
    for i in range(len(before)):
        same &= abs(P[i, i] - before[i]) <= 1e-12 * P[i, i]
        before[i] = P[i, i]
    return same


@njit(cache=True, nogil=True)
def _innovations(steps, reading, second, start, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Sums over the one-step prediction errors e with variance V, rows position and accelerometer.

    Columns: count, Σe²/V, Σe·o/V, Σo²/V, Σ log V, where o is the response of the errors to an accelerometer offset of 1.
    With ``gain`` 0 there is no accelerometer.
    """
    n, order = len(reading), len(start)
    sums = np.zeros((2, 5))
    state, response = start.copy(), np.zeros(order)
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    f = g = 1.0  # inverse variances of the predictions
    log_f = log_g = 0.0
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            f = 1 / _read(P, 0, 1.0, 1.0, K)
            log_f = -math.log(f)
            if gain != 0.0:
                g = 1 / _read(P, 2, gain, second_noise, C)
                log_g = -math.log(g)
        counts = k >= order  # the first readings only find the state
        e = reading[k] - state[0]
        for i in range(order):
            state[i] += K[i] * e
        if counts:
            sums[0, 0] += 1
            sums[0, 1] += e * e * f
            sums[0, 4] += log_f
        if gain != 0.0:
            o = -response[0]
            if counts:
                sums[0, 2] += e * o * f
                sums[0, 3] += o * o * f
            for i in range(order):
                response[i] += K[i] * o
            e, o = second[k] - gain * state[2], 1.0 - gain * response[2]
            for i in range(order):
                state[i] += C[i] * e
                response[i] += C[i] * o
            if counts:
                sums[1, 0] += 1
                sums[1, 1] += e * e * g
                sums[1, 2] += e * o * g
                sums[1, 3] += o * o * g
                sums[1, 4] += log_g
        # On a uniform clock the gains settle; from there only the state is computed.
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even
        _move(state, F)
        if gain != 0.0:
            _move(response, F)
    return sums


@njit(cache=True, nogil=True)
def _smoother(steps, reading, second, start, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Smoothed x, ẋ, ẍ, shape (n, 3), and variance of ẋ, shape (n,), in the units of the kernels."""
    n, order = len(reading), len(start)
    states, errors = np.empty((n, order)), np.zeros((n, 2))
    # Covariances of the predictions, each stored once: that of sample k is kept[which[k]].
    which, kept, held = np.empty(n, np.int64), np.empty((n, order, order)), -1
    state = start.copy()
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K, C = np.zeros(order), np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            held += 1
            kept[held] = P
            _read(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                _read(P, 2, gain, second_noise, C)
        which[k] = held
        states[k] = state
        errors[k, 0] = reading[k] - state[0]
        for i in range(order):
            state[i] += K[i] * errors[k, 0]
        if gain != 0.0:
            errors[k, 1] = second[k] - gain * state[2]
            for i in range(order):
                state[i] += C[i] * errors[k, 1]
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even
        _move(state, F)

    smooth, variance = np.empty((n, 3)), np.empty(n)
    r, N = np.zeros(order), np.zeros((order, order))
    before[:] = 0.0
    f = g = 1.0
    spread = 0.0
    steady, last = False, 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            if abs(steps[k] - last) > 1e-6 * last:
                last = steps[k]
                _set_interval(last, density, shares, F, Q)
                steady = False
            for i in range(order - 1, 0, -1):  # r ← Fᵀ r
                for j in range(i):
                    r[i] += F[j, i] * r[j]
        predicted = kept[which[k]]
        same = k < n - 1 and which[k] == which[k + 1]
        steady = steady and same
        if not same:
            P[:, :] = predicted
            f = 1 / _read(P, 0, 1.0, 1.0, K)
            if gain != 0.0:
                g = 1 / _read(P, 2, gain, second_noise, C)
        if gain != 0.0:
            _unread(r, 2, gain, errors[k, 1] * g, C)
        _unread(r, 0, 1.0, errors[k, 0] * f, K)
        if not steady:
            if k < n - 1:
                _retreat(N, F, work)
            if gain != 0.0:
                _unread_variance(N, 2, gain, g, C, work)
            _unread_variance(N, 0, 1.0, f, K, work)
            spread = predicted[1, 1]
            for i in range(order):
                for j in range(order):
                    spread -= predicted[1, i] * N[i, j] * predicted[j, 1]
            steady = _settled(N, before) and same
        for i in range(3):
            value = states[k, i]
            for j in range(order):
                value += predicted[i, j] * r[j]
            smooth[k, i] = value
        variance[k] = spread
    return smooth, variance


@njit(cache=True, nogil=True)
def _unread(r, element, gain, weighted_error, K):  # type: ignore[no-untyped-def]
    """r ← Lᵀ r + H e/V of one reading, L = I - K H."""
    inner = 0.0
    for i in range(len(r)):
        inner += K[i] * r[i]
    r[element] += gain * (weighted_error - inner)


@njit(cache=True, nogil=True)
def _retreat(N, F, work):  # type: ignore[no-untyped-def]
    """N ← Fᵀ N F, in place."""
    order = N.shape[0]
    for i in range(order):
        for j in range(order):
            value = N[i, j]
            for k in range(i):
                value += F[k, i] * N[k, j]
            work[i, j] = value
    for i in range(order):
        for j in range(order):
            value = work[i, j]
            for k in range(j):
                value += work[i, k] * F[k, j]
            N[i, j] = value


@njit(cache=True, nogil=True)
def _unread_variance(N, element, gain, weight, K, work):  # type: ignore[no-untyped-def]
    """N ← Lᵀ N L + Hᵀ H/V of one reading, ``weight`` = 1/V."""
    order = len(K)
    total = 0.0
    for i in range(order):
        value = 0.0
        for j in range(order):
            value += N[i, j] * K[j]
        work[0, i] = value
        total += K[i] * value
    for i in range(order):
        N[i, element] -= gain * work[0, i]
        N[element, i] -= gain * work[0, i]
    N[element, element] += gain * gain * (total + weight)


@njit(cache=True, nogil=True)
def _draw_errors(steps, parts, normal, density, gain, second_noise):  # type: ignore[no-untyped-def]
    """Errors of the smoothed x, ẋ, ẍ from standard normal numbers (n, count, order): (3, count, n), in the kernels' units.

    Of ``parts`` instants, the first one is read.
    Given the next state, the error of a state is J·(that of the next) + (I - J F) a - J w with J = P Fᵀ (F P Fᵀ + Q)⁻¹. The
    error of its filtered estimate, a, has covariance P; what the white derivative adds, w, has covariance Q.
    """
    n, count, order = normal.shape
    which, kept, held = np.empty(n, np.int64), np.empty((n, order, order)), -1
    P, work, before = _prior(order, density), np.empty((order, order)), np.zeros(order)
    K = np.zeros(order)
    F, Q, shares = np.zeros((order, order)), np.zeros((order, order)), _shares(order)
    steady, last = False, 0.0
    for k in range(n):
        if not steady:
            held += 1
            if k % parts == 0:
                _read(P, 0, 1.0, 1.0, K)
                if gain != 0.0:
                    _read(P, 2, gain, second_noise, K)
            kept[held] = P
        which[k] = held
        even = abs(steps[k] - last) <= 1e-6 * last
        if not even:
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
        if not (steady and even):
            _advance(P, F, Q, work)
            steady = _settled(P, before) and even and parts == 1

    drawn = np.empty((3, count, n))
    J, root = np.zeros((order, order)), _root(kept[which[n - 1]])
    errors = np.zeros((count, order))
    last = 0.0
    for k in range(n - 1, -1, -1):
        if k < n - 1 and (which[k] != which[k + 1] or k == n - 2 or abs(steps[k] - last) > 1e-6 * last):
            last = steps[k]
            _set_interval(last, density, shares, F, Q)
            P[:, :] = kept[which[k]]
            _advance(P, F, Q, work)
            scale = np.sqrt(np.diag(P))
            J[:, :] = (np.linalg.solve(P / np.outer(scale, scale), (F @ kept[which[k]]) / scale.reshape(-1, 1))).T / scale
            rest = np.eye(order) - J @ F
            root = _root(rest @ kept[which[k]] @ rest.T + J @ Q @ J.T)
        errors = errors @ J.T + normal[k] @ root.T
        drawn[0, :, k], drawn[1, :, k], drawn[2, :, k] = errors[:, 0], errors[:, 1], errors[:, 2]
    return drawn


@njit(cache=True, nogil=True)
def _root(covariance):  # type: ignore[no-untyped-def]
    """Lower triangular root of a covariance that rounding may have left slightly indefinite."""
    order = len(covariance)
    root = np.zeros((order, order))
    for i in range(order):
        for j in range(i + 1):
            rest = covariance[i, j]
            for k in range(j):
                rest -= root[i, k] * root[j, k]
            if i == j:
                root[i, i] = math.sqrt(max(rest, 0.0))
            elif root[j, j] > 0.0:
                root[i, j] = rest / root[j, j]
    return root
