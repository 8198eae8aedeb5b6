"""How many coil currents recordings have, and whether one of them changes within a recording."""

import numpy as np
import pytest

from mrd_identification.preflight import preflight
from mrd_identification.recording import current_levels, current_varies
from mrd_runs import Run

TIME = np.arange(4000) / 500.0
W = 2 * np.pi * 1.5


def run_of(current: np.ndarray | float, time: np.ndarray = TIME, noise: float = 0.0) -> Run:
    velocity = 0.01 * W * np.cos(W * time)
    current = np.broadcast_to(current, len(time)) + noise * np.random.default_rng(0).standard_normal(len(time))
    force = 200 * np.tanh(20 * velocity) + np.random.default_rng(1).normal(0, 1, len(time))
    return Run("a", time, 0.01 * np.sin(W * time), velocity, current, force)


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.019, 0.04, 0.2])
@pytest.mark.parametrize("level", [0.0, 0.2, 5.0])
def test_noise_is_no_change_whatever_its_size(level: float, noise: float) -> None:
    assert not current_varies(run_of(level, noise=noise))


def test_hum_of_a_clamp_is_no_change_of_a_large_current() -> None:
    assert not current_varies(run_of(5.0 + 0.04 * np.sqrt(2) * np.sin(2 * np.pi * 50.0 * TIME), noise=0.004))


@pytest.mark.parametrize("frequency", [0.2, 1.0, 10.0, 20.0])
@pytest.mark.parametrize("rate", [100.0, 500.0, 2000.0])
def test_a_wave_is_a_change(frequency: float, rate: float) -> None:
    time = np.arange(int(8 * rate)) / rate
    assert current_varies(run_of(1.0 + 0.5 * np.sin(2 * np.pi * frequency * time), time, noise=0.02))


@pytest.mark.parametrize("frequency", [20.0, 40.0, 60.0])
def test_a_small_current_that_is_switched_fast_is_a_change(frequency: float) -> None:
    square = np.where(np.sin(2 * np.pi * frequency * TIME + 0.1) > 0, 0.04, 0.0)
    assert current_varies(run_of(square, noise=0.001))


@pytest.mark.parametrize("level", [0.0, 0.1])
def test_hum_of_a_sensor_is_no_change_of_a_small_current(level: float) -> None:
    assert not current_varies(run_of(level + 0.02 * np.sin(2 * np.pi * 60.0 * TIME), noise=0.001))


def test_a_step_is_a_change() -> None:
    assert current_varies(run_of(np.where(TIME > 7.0, 0.1, 0.05), noise=0.004))


@pytest.mark.parametrize(
    ("currents", "levels"),
    [
        ((1.0, 1.015), 1),
        ((1.0, 1.04), 2),
        ((0.0, 0.004), 1),  # the offset of a sensor
        ((0.02, 0.028), 2),
        ((0.02, 0.04, 0.06), 3),
        ((0.0, 0.006, 0.01), 3),  # a coil of very many turns
    ],
)
def test_currents_count_as_several_by_one_rule(currents: tuple[float, ...], levels: int) -> None:
    runs = [run_of(level, noise=0.0001) for level in currents]
    assert current_levels(runs) == (levels, False)
    (text,) = (finding.text for finding in preflight(runs) if finding.channel == "current")
    assert ("never changes" in text) == (levels == 1)
