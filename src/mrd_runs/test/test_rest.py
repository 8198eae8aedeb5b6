"""Rest: seen through the noise of the sensors, and not taken for a reversal."""

import numpy as np
import pytest

from mrd_runs.blocks import Blocks
from mrd_runs.rest import RestLimits, RestMonitor

LIMITS = RestLimits(speed=2e-3, current=0.05, duration=0.5)


def blocks(position: np.ndarray, current: np.ndarray, rate: float, size: int) -> Blocks:
    first = np.arange(0, len(position), size)
    zeros = np.zeros(len(position))
    return Blocks(
        np.round(1e9 * (100 + first / rate)).astype(np.int64),
        np.full(len(first), 1 / rate),
        first,
        np.diff([*first, len(position)]),
        {"position": position, "coil_current": current, "force": zeros, "acceleration": zeros},
    )


def rested_at(position: np.ndarray, current: np.ndarray, rate: float = 1000.0, size: int = 20) -> float | None:
    """Time in s after the start at which the monitor has seen enough rest."""
    monitor, all_blocks = RestMonitor(LIMITS), blocks(position, current, rate, size)
    for index in range(len(all_blocks.stamp)):
        part = slice(index * size, (index + 1) * size)
        series = {name: values[part] for name, values in all_blocks.series.items()}
        one = slice(index, index + 1)
        monitor.add_samples(
            Blocks(all_blocks.stamp[one], all_blocks.period[one], all_blocks.sequence[one], all_blocks.count[one], series)
        )
        if monitor.rested:
            return (index + 1) * size / rate
    return None


@pytest.mark.parametrize(("rate", "size"), [(25.0, 1), (1000.0, 20), (1000.0, 2), (2000.0, 40)])
def test_braking_rod(rate: float, size: int) -> None:
    """The rod brakes from 45 mm/s within 0.2 s; noise of 8 µm and hum of 20 µm are not motion."""
    time = np.arange(0, 3, 1 / rate)
    random = np.random.default_rng(0)
    braking = np.minimum(time, 0.2)
    position = 0.045 * (braking - braking**2 / 0.4) + random.normal(0, 8e-6, len(time))
    position += 2e-5 * np.sin(2 * np.pi * 50 * time)
    current = random.normal(0, 4e-3, len(time))
    at = rested_at(position, current, rate, size)
    assert at is not None
    assert 0.65 < at < 0.9


def test_coil_is_not_at_rest_with_a_current() -> None:
    time = np.arange(0, 3, 1e-3)
    at = rested_at(np.zeros(3000), np.exp(-time / 0.3))
    assert at == pytest.approx(0.3 * np.log(20) + 0.5, abs=0.05)
    assert rested_at(np.zeros(3000), np.full(3000, 0.06)) is None


def test_reversals_are_no_rest() -> None:
    assert rested_at(0.01 * np.sin(2 * np.pi * 0.5 * np.arange(0, 6, 1e-3)), np.zeros(6000)) is None


def test_values_that_are_no_numbers_are_no_rest() -> None:
    assert rested_at(np.full(2000, np.nan), np.zeros(2000)) is None
    assert rested_at(np.zeros(2000), np.full(2000, np.nan)) is None


def test_the_servo_may_object() -> None:
    """An LVDT that is stuck shows no motion; the encoder does."""
    still = blocks(np.zeros(600), np.zeros(600), 1000.0, 20)
    monitor = RestMonitor(LIMITS)
    monitor.add_samples(still)
    assert monitor.rested
    monitor.add_speed(100.6, -1e-3)
    assert monitor.rested
    monitor.add_speed(100.6, -0.04)
    assert not monitor.rested
    assert monitor.describe() == "40.0 mm/s, 0.00 A"
