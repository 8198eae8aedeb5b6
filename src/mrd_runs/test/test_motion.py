"""Smoothed motion."""

import math
import time

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import expm
from scipy.signal import savgol_filter

from mrd_base import InputError
from mrd_runs import make_run
from mrd_runs.signals.motion import Motion, motion_errors, smooth_motion
from mrd_runs.signals.motion_model import MotionModel, Segment, smooth_by_model
from mrd_runs.signals.quantisation import quantisation_step, quantisation_variance, rounding_error
from mrd_runs.signals.smoothed_run import smooth_run

FREQUENCIES = 0.5 * np.arange(1, 16, 2)
AMPLITUDES = 2.5e-3 / FREQUENCIES


def multisine(t: np.ndarray, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration of a random-phase odd multisine of 0.5 to 7.5 Hz."""
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(FREQUENCIES))
    omega = 2 * np.pi * FREQUENCIES[:, None]
    angle = omega * t + phases[:, None]
    amplitude = AMPLITUDES[:, None]
    return (
        (amplitude * np.sin(angle)).sum(axis=0),
        (amplitude * omega * np.cos(angle)).sum(axis=0),
        -(amplitude * omega**2 * np.sin(angle)).sum(axis=0),
    )


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(("rate", "n", "windows"), [(1000, 20_000, (9, 25, 41)), (25, 1500, (5, 7, 9))])
def test_better_than_savitzky_golay_at_every_usual_window(rate: int, n: int, windows: tuple[int, ...]) -> None:
    t = np.arange(n) / rate
    x, v, _ = multisine(t)
    measured = x + np.random.default_rng(2).normal(0, 5e-6, n)
    ours = rms(smooth_motion(t, measured).velocity - v)
    theirs = [
        rms(savgol_filter(measured, window, order, deriv=1, delta=1 / rate) - v) for window in windows for order in (2, 3, 4)
    ]
    assert ours < min(theirs)


@pytest.mark.parametrize(("rate", "error"), [(25, 1e-3), (100, 1e-5), (1000, 1e-8)])
def test_noise_free_sine(rate: int, error: float) -> None:
    t = np.arange(20 * rate) / rate
    omega = 2 * np.pi * 1.5
    smoothed = smooth_motion(t, 0.01 * np.sin(omega * t))
    assert rms(smoothed.velocity / (0.01 * omega) - np.cos(omega * t)) < error
    assert rms(smoothed.acceleration / (0.01 * omega**2) + np.sin(omega * t)) < 20 * error


def test_less_is_known_at_the_ends() -> None:
    t = np.arange(2000) / 1000
    smoothed = smooth_motion(t, multisine(t)[0] + np.random.default_rng(3).normal(0, 5e-6, len(t)))
    spread = motion_errors(t, smoothed, np.random.default_rng(0), 100)[1].std(axis=0)
    assert spread[0] > 2 * spread[len(t) // 2]
    assert smoothed.position_noise == pytest.approx(5e-6, rel=0.1)


def test_steady_gains_are_those_of_the_full_recursion() -> None:
    """With a slightly uneven clock, the kernels never use settled gains."""
    t = np.arange(3000) / 1000
    x, _, a = multisine(t)
    rng = np.random.default_rng(4)
    x, a = x + rng.normal(0, 5e-6, len(t)), a + rng.normal(0, 0.05, len(t))
    uneven = t + np.where(np.arange(len(t)) % 2, 2e-9, 0.0)
    steady, full = smooth_motion(t, x, a), smooth_motion(uneven, x, a)
    assert steady.accelerometer is not None
    steady_errors, full_errors = (
        motion_errors(time, motion, np.random.default_rng(0), 20)[1] for time, motion in ((t, steady), (uneven, full))
    )
    np.testing.assert_allclose(steady.velocity, full.velocity, atol=1e-2 * rms(full_errors))
    np.testing.assert_allclose(steady_errors, full_errors, atol=2e-2 * rms(full_errors))


@pytest.mark.parametrize("gain", [0.0, 1.1])
def test_matches_the_direct_solution(gain: float) -> None:
    """The smoothed states are the best linear estimate: solved here as one dense least-squares problem."""
    rng = np.random.default_rng(5)
    n, order, h = 41, 4, 0.3
    intervals = rng.uniform(0.5, 1.5, n - 1)
    intervals /= np.median(intervals)
    position, acceleration = np.cumsum(rng.normal(size=n)), 0.1 * rng.normal(size=n)
    model = MotionModel(order, h, noise=2.0, gain=gain, relative_variance=0.01)
    states = smooth_by_model(Segment(np.append(intervals, 1.0), position, acceleration), model)
    precision, rhs = np.zeros((n * order, n * order)), np.zeros(n * order)
    for k in range(n - 1):
        F = expm(np.eye(order, k=1) * intervals[k] * h)
        # Simpson's rule, composite: exact enough and independent of the closed form.
        at = np.linspace(0, intervals[k] * h, 201)
        columns = np.array([expm(np.eye(order, k=1) * s)[:, -1] for s in at])
        Q = h * simpson(columns[:, :, None] * columns[:, None, :], x=at, axis=0)
        both = np.hstack([-F, np.eye(order)])
        part = slice(k * order, (k + 2) * order)
        precision[part, part] += both.T @ np.linalg.solve(Q, both)
    for k in range(n):
        precision[k * order, k * order] += 1.0
        precision[k * order + 2, k * order + 2] += gain**2 / model.kernel_variance
        rhs[k * order] += position[k]
        rhs[k * order + 2] += gain * acceleration[k] / h**2 / model.kernel_variance
    covariance = np.linalg.inv(precision)
    expected = (covariance @ rhs).reshape(n, order)
    # To a hundredth of the noise: as far as the prior of the first state is felt.
    np.testing.assert_allclose(states[:, 0], expected[:, 0], atol=1e-2)
    np.testing.assert_allclose(states[:, 1], expected[:, 1] * h, atol=1e-2)
    # 20 000 draws tell a standard deviation to half a per cent.
    time = np.concatenate([[0.0], np.cumsum(intervals)])
    motion = Motion(*states.T, math.sqrt(2.0), order, 1 / h, model=model)
    drawn = motion_errors(time, motion, np.random.default_rng(6), 20_000)
    variances = np.diag(covariance).reshape(n, order)
    for derivative, errors in enumerate(drawn):
        std = np.sqrt(2.0 * variances[:, derivative]) * h**derivative
        np.testing.assert_allclose(errors.std(axis=0)[1:], std[1:], rtol=0.03)


def test_accelerometer_helps_and_its_gain_and_offset_are_found() -> None:
    t = np.arange(20_000) / 1000
    x, v, a = multisine(t)
    rng = np.random.default_rng(6)
    measured = x + rng.normal(0, 20e-6, len(t))
    accelerometer = 1.06 * a - 0.4 + rng.normal(0, 0.05, len(t))
    alone, both = smooth_motion(t, measured), smooth_motion(t, measured, accelerometer)
    assert both.accelerometer == pytest.approx((1.06, -0.4), abs=0.01)
    assert rms(both.velocity - v) < 0.7 * rms(alone.velocity - v)


@pytest.mark.parametrize(
    ("spoil", "word"),
    [
        (lambda a, rng: np.full_like(a, 0.3), "constant"),
        (lambda a, rng: a / 9.80665, "gain"),
        (lambda a, rng: rng.normal(0, 1.0, len(a)), "accelerometer not used"),
    ],
)
def test_useless_accelerometer_is_not_used(spoil, word: str) -> None:  # type: ignore[no-untyped-def]
    t = np.arange(8000) / 1000
    x, _, a = multisine(t)
    rng = np.random.default_rng(7)
    measured = x + rng.normal(0, 5e-6, len(t))
    both, alone = smooth_motion(t, measured, spoil(a, rng)), smooth_motion(t, measured)
    assert word in both.note
    assert both.accelerometer is None
    np.testing.assert_array_equal(both.velocity, alone.velocity)


def test_standstill() -> None:
    smoothed = smooth_motion(np.arange(100) / 25, np.full(100, 0.003))
    assert not smoothed.velocity.any()
    np.testing.assert_array_equal(smoothed.position, 0.003)


def test_standstill_with_noise_has_no_velocity() -> None:
    t = np.arange(5000) / 1000
    noise = np.round(np.random.default_rng(8).normal(0, 5e-6, len(t)) / 1.6e-6) * 1.6e-6
    smoothed = smooth_motion(t, 0.02 + noise)
    assert np.abs(smoothed.velocity).max() < 5e-4


def test_slow_ramp_of_coarse_steps_is_smooth() -> None:
    t = np.arange(4000) / 1000
    step = 20e-6
    smoothed = smooth_motion(t, np.round(1e-3 * t / step) * step)
    np.testing.assert_allclose(smoothed.velocity[200:-200], 1e-3, rtol=0.05)


def test_few_reversals_of_a_long_run_are_not_rounded() -> None:
    """Most of the run is straight, so that only a look at all of it shows how little may be smoothed."""
    time = np.arange(100_000) / 1000.0
    triangle = 0.01 * np.abs((time / 25.0 + 0.5) % 2 - 1)
    noise = 1e-6
    motion = smooth_motion(time, triangle + np.random.default_rng(2).normal(0.0, noise, len(time)))
    assert np.abs(motion.position - triangle).max() < 10 * noise
    assert np.median(np.abs(motion.velocity)) == pytest.approx(0.01 / 25.0, rel=1e-3)


def test_gap_in_time() -> None:
    t = np.arange(4000) / 1000
    kept = (t < 1.5) | (t > 1.55)
    x, v, _ = multisine(t)
    smoothed = smooth_motion(t[kept], (x + np.random.default_rng(9).normal(0, 5e-6, len(t)))[kept])
    assert rms(smoothed.velocity - v[kept]) < 3e-4
    assert np.isfinite(motion_errors(t[kept], smoothed, np.random.default_rng(0), 2)).all()


def test_step_of_a_quantised_channel() -> None:
    rng = np.random.default_rng(10)
    values = 0.01 * np.sin(np.arange(5000) / 50)
    quantised, noisy = np.round(values / 5e-6) * 5e-6 + 0.0123, values + rng.normal(0, 5e-6, 5000)
    assert quantisation_step(quantised, rounding_error(quantised)) == pytest.approx(5e-6, rel=1e-6)
    assert quantisation_variance(quantised, 1e-15) == pytest.approx((5e-6) ** 2 / 12, rel=0.2)
    for jitter in (0.0, 1.5e-6):  # it flips between two readings now and then, also at rest
        rest = np.round((values[-1] + jitter * rng.standard_normal(45000)) / 5e-6) * 5e-6 + 0.0123
        at_rest = quantisation_variance(np.concatenate([quantised, rest]), 1e-15)
        assert at_rest == pytest.approx((5e-6) ** 2 / 12, rel=0.25)
    assert quantisation_step(noisy, rounding_error(noisy)) == 0.0
    assert quantisation_variance(noisy, 1e-15) < 1e-29


@pytest.mark.parametrize(
    ("readings", "step"), [(np.full(100, 3.0), 0.0), (np.arange(100) * 0.8, 0.8), (np.repeat([0.0, 0.5, 2.0], 40), 0.5)]
)
def test_step_of_any_channel(readings: np.ndarray, step: float) -> None:
    assert quantisation_step(readings, rounding_error(readings)) == pytest.approx(step, rel=1e-9)


def test_too_short() -> None:
    with pytest.raises(InputError, match="4 samples"):
        smooth_motion(np.arange(4.0), np.arange(4.0))


def test_the_velocity_of_a_run_is_that_of_its_smoothed_motion(columns: dict[str, np.ndarray]) -> None:
    run = make_run("run", columns)
    np.testing.assert_array_equal(smooth_run(run).motion.velocity, run.velocity)
    np.testing.assert_array_equal(run.position, columns["position_m"])


def test_the_time_grows_with_the_samples_and_no_faster() -> None:
    t = np.arange(60_000) / 1000
    x = multisine(t)[0] + np.random.default_rng(11).normal(0, 5e-6, len(t))

    def seconds(samples: int) -> float:
        taken = []
        for _ in range(3):
            start = time.process_time()
            smooth_motion(t[:samples], x[:samples])
            taken.append(time.process_time() - start)
        return min(taken)

    assert seconds(60_000) < 1.5 * 10 * seconds(6_000)
