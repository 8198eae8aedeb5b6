"""Errors of the smoothed motion."""

import numpy as np
import pytest
from scipy.interpolate import BPoly
from scipy.signal import lfilter

from mrd_runs import Run, make_run
from mrd_runs.signals.motion import motion_between_samples, motion_errors, subdivide
from mrd_runs.signals.smoothed_run import remeasure, smooth_run

FREQUENCIES = 0.5 * np.arange(1, 16, 2)
AMPLITUDES = 2.5e-3 / FREQUENCIES
NOISE, ACCELEROMETER_NOISE = 8e-6, 0.05


def multisine(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration of an odd multisine of 0.5 to 7.5 Hz."""
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, len(FREQUENCIES))
    omega, amplitude = 2 * np.pi * FREQUENCIES[:, None], AMPLITUDES[:, None]
    angle = omega * t + phases[:, None]
    return (
        (amplitude * np.sin(angle)).sum(axis=0),
        (amplitude * omega * np.cos(angle)).sum(axis=0),
        -(amplitude * omega**2 * np.sin(angle)).sum(axis=0),
    )


def measured(accelerometer: bool, n: int = 7500, noise: float = NOISE, jitter: float = 0.0) -> Run:
    rng = np.random.default_rng(2)
    t = np.arange(n) / 500 + rng.uniform(0, jitter, n)
    x, _, a = multisine(t)
    columns = {"time_s": t, "position_m": x + rng.normal(0, noise, n), "force_N": 100 * np.sin(t)}
    columns["current_A"] = 0.5 + rng.normal(0, 4e-3, n)
    if accelerometer:
        columns["acceleration_mps2"] = 1.03 * a - 0.2 + rng.normal(0, ACCELEROMETER_NOISE, n)
    return make_run("run", columns)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("accelerometer", [False, True])
def test_spread_is_that_of_the_actual_errors(accelerometer: bool) -> None:
    run = measured(accelerometer)
    smoothed = smooth_run(run).motion
    assert (smoothed.accelerometer is not None) == accelerometer
    series = smoothed.position, smoothed.velocity, smoothed.acceleration
    drawn = motion_errors(run.time, smoothed, np.random.default_rng(4), 8)
    for values, true, errors in zip(series, multisine(run.time), drawn, strict=True):
        assert 1 / 1.5 < rms(values - true) / rms(errors) < 1.5


def test_drawn_errors_are_derivatives_of_each_other() -> None:
    run = measured(accelerometer=False)
    position, velocity, acceleration = motion_errors(run.time, smooth_run(run).motion, np.random.default_rng(5), 3)
    for values, slopes in ((position, velocity), (velocity, acceleration)):
        assert rms((np.gradient(values, run.time, axis=1) - slopes)[:, 1:-1]) < 0.1 * rms(slopes)


@pytest.mark.parametrize("seed", [6, 7])
def test_measuring_again_differs_by_as_much_as_errors_do(seed: int) -> None:
    run = measured(accelerometer=True)
    smoothed = smooth_run(run)
    rng = np.random.default_rng(seed)
    remeasured = remeasure(smoothed, rng)
    again = remeasured.run
    assert remeasured.motion.order == smoothed.motion.order
    assert rms(again.position - smoothed.motion.position) == pytest.approx(NOISE, rel=0.1)
    assert np.std(again.acceleration - run.acceleration) == pytest.approx(np.sqrt(2) * ACCELEROMETER_NOISE, rel=0.1)
    assert np.std(again.current) == pytest.approx(4e-3, rel=0.1)
    difference = remeasured.motion.velocity - smoothed.motion.velocity
    assert rms(difference) == pytest.approx(rms(motion_errors(run.time, smoothed.motion, rng, 8)[1]), rel=0.2)


def test_without_noise_there_is_hardly_an_error() -> None:
    run = measured(accelerometer=False, noise=0.0)
    smoothed = smooth_run(run)
    assert rms(motion_errors(run.time, smoothed.motion, np.random.default_rng(8), 2)[1]) < 1e-7
    assert rms(remeasure(smoothed, np.random.default_rng(9)).motion.velocity - smoothed.motion.velocity) < 1e-7


def test_standstill_has_no_error() -> None:
    t = np.arange(100) / 25
    run = make_run("still", {"time_s": t, "position_m": np.full(100, 0.01), "current_A": t, "force_N": np.sin(t)})
    assert not np.any(motion_errors(run.time, smooth_run(run).motion, np.random.default_rng(10), 2))
    np.testing.assert_array_equal(remeasure(smooth_run(run), np.random.default_rng(11)).run.position, run.position)


def test_between_few_samples_errors_are_larger_and_as_drawn() -> None:
    # White noise, filtered to third order above 0.3 Hz: what the smoother takes a motion for, read at 25 Hz.
    rng = np.random.default_rng(2)
    keep = np.exp(-2 * np.pi * 0.3 / 1600)
    exact = lfilter([1.0], np.poly([keep] * 3), rng.standard_normal(40 * 1600))
    exact *= 0.01 / np.std(exact)
    t, every = np.arange(1000) / 25, 64
    read = exact[::every] + rng.normal(0, 5e-7, len(t))
    run = make_run("few", {"time_s": t, "position_m": read, "current_A": t / 60, "force_N": np.sin(t)})
    motion = smooth_run(run).motion
    values, errors = motion_between_samples(run.time, motion, 8), motion_errors(run.time, motion, rng, 8, 8)
    true = exact, np.gradient(exact, 1 / 1600)
    for estimate, right, drawn in zip(values, true, errors, strict=False):
        wrong = estimate - right[: len(exact) - every + 1 : every // 8]
        assert drawn.shape == (8, len(subdivide(t, 8)))
        assert 1 / 1.5 < rms(wrong[4::8]) / rms(drawn[:, 4::8]) < 1.5
    assert rms(errors[0][:, 4::8]) > 1.2 * rms(errors[0][:, ::8])


def test_between_samples_nothing_changes_at_the_samples() -> None:
    run = measured(accelerometer=True, n=300)
    motion = smooth_run(run).motion
    for fine, values in zip(motion_between_samples(run.time, motion, 4), (motion.position, motion.velocity), strict=False):
        np.testing.assert_allclose(fine[::4], values, rtol=1e-6, atol=1e-9)
    coarse, fine = (motion_errors(run.time, motion, np.random.default_rng(3), 400, parts)[1] for parts in (1, 4))
    assert rms(fine[:, ::4]) == pytest.approx(rms(coarse), rel=0.05)


def test_between_samples_position_is_the_polynomial_of_its_derivatives_at_both_ends() -> None:
    run = measured(accelerometer=True, n=300, jitter=5e-4)
    parts = np.random.default_rng(4).integers(1, 9, 299)
    at = smooth_run(run).motion
    expected = BPoly.from_derivatives(run.time, np.stack([at.position, at.velocity, at.acceleration], axis=1))
    for order, fine in enumerate(motion_between_samples(run.time, at, parts)):
        right = expected(subdivide(run.time, parts), order)
        np.testing.assert_allclose(fine, right, atol=1e-9 * np.abs(right).max())
