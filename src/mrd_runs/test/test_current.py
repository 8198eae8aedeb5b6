"""A measured current without the noise of its sensor."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_runs.signals.current import current_noise, draw_current_noise, noise_correlation, steady_current

RATE = 500
T = np.arange(7500) / RATE
SIGMA = 4e-3


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def steps(hold: int = 50) -> np.ndarray:
    return np.repeat(np.random.default_rng(1).choice([0.0, 0.25, 0.5, 1.0], len(T) // hold), hold)


def noisy(current: np.ndarray) -> np.ndarray:
    return current + np.random.default_rng(2).normal(0, SIGMA, len(current))


@pytest.mark.parametrize("current", [np.full(len(T), 0.5), steps(), T / 15, 0.5 + 0.5 * np.sin(2 * np.pi * T)])
def test_a_third_of_the_noise_is_left(current: np.ndarray) -> None:
    assert rms(steady_current(noisy(current)) - current) < SIGMA / 3


@pytest.mark.parametrize("current", [np.full(len(T), 0.5), steps(300), T / 15, 0.5 + 0.01 * np.sin(0.6 * np.pi * T)])
def test_a_sixth_of_the_noise_is_left_on_long_levels_and_slow_waves(current: np.ndarray) -> None:
    assert rms(steady_current(noisy(current)) - current) < SIGMA / 6


def test_a_wave_in_the_noise_is_not_flattened() -> None:
    wave = 0.75 * SIGMA * np.sin(4 * np.pi * T)
    estimate = steady_current(noisy(0.5 + wave)) - 0.5
    assert (estimate @ wave) / (wave @ wave) > 0.9


@pytest.mark.parametrize("hold", [1, 2, 3])
def test_levels_of_a_few_samples_are_not_noise(hold: int) -> None:
    current = np.repeat(np.random.default_rng(1).choice([0.0, 0.5], 600 // hold), hold)
    assert 0.7 * SIGMA < current_noise(noisy(current)) < 1.35 * SIGMA
    assert rms(steady_current(noisy(current)) - current) < 1.1 * SIGMA


def test_steps_stay_sharp() -> None:
    current = steps()
    estimate = steady_current(noisy(current))
    for place in np.flatnonzero(np.diff(current)):
        assert np.abs(estimate[place : place + 2] - current[place : place + 2]).max() < 0.05


def test_fast_waves_and_exponential_rises_are_not_distorted() -> None:
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * 5 * T)
    rise = np.where(T % 0.4 < 0.2, 1 - np.exp(-(T % 0.2) / 0.02), np.exp(-(T % 0.2) / 0.02))
    for current in (wave, rise):
        error = steady_current(noisy(current)) - current
        assert rms(error) < 0.75 * SIGMA
        slope = np.gradient(current, T)
        # A delay shows as an error in proportion to the slope.
        assert abs(error @ slope / (slope @ slope)) < 2e-4


@pytest.mark.parametrize("current", [np.full(len(T), 0.5), steps(), T / 15, 0.5 + 0.5 * np.sin(2 * np.pi * T)])
def test_a_current_without_noise_comes_back(current: np.ndarray) -> None:
    np.testing.assert_allclose(steady_current(current), current, atol=1e-5)


def test_a_coarse_sine_without_noise_comes_back() -> None:
    sine = 0.5 * np.sin(2 * np.pi * np.arange(500) / 25)
    np.testing.assert_allclose(steady_current(sine), sine, atol=2e-3)


def test_single_outliers_are_gone() -> None:
    current = noisy(np.full(len(T), 0.3))
    current[100::500] += 0.2
    assert np.abs(steady_current(current) - 0.3)[100::500].max() < 0.01


@given(st.floats(1e-4, 0.05), st.floats(-2, 2), st.integers(0, 1000))
def test_noise_is_estimated_in_spite_of_steps(sigma: float, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    current = np.where(np.arange(2000) % 100 < 50, size, 0.0) + rng.normal(0, sigma, 2000)
    # One fourth difference in twelve has a step in it.
    assert 0.8 * sigma < current_noise(current) < 1.35 * sigma


@given(st.integers(0, 40))
def test_short_series(count: int) -> None:
    current = np.random.default_rng(3).normal(0.5, 0.01, count)
    assert steady_current(current).shape == (count,)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2, 0.3])
@pytest.mark.parametrize("frequency", [0.0, 0.5])
def test_noise_behind_a_filter_is_seen_and_removed_like_white_noise(share: float, frequency: float) -> None:
    rng, n = np.random.default_rng(7), 8000
    white = rng.normal(0.0, SIGMA, n + 1)
    noise = (white[1:] + share * white[:-1]) / np.sqrt(1.0 + share**2)
    true = 0.3 + 0.1 * np.sin(2 * np.pi * frequency * np.arange(n) / 500.0)
    assert noise_correlation(true + noise) == pytest.approx(share / (1.0 + share**2), abs=0.05)
    assert current_noise(true + noise) == pytest.approx(SIGMA, rel=0.08)
    if not frequency:
        assert np.std(steady_current(true + noise) - true) < 0.12 * SIGMA
    drawn = draw_current_noise(true + noise, rng, 3)
    assert np.std(drawn) == pytest.approx(SIGMA, rel=0.08)
    assert np.mean(drawn[:, 1:] * drawn[:, :-1]) / np.var(drawn) == pytest.approx(share / (1.0 + share**2), abs=0.06)
