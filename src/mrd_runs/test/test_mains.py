"""The phase of the mains hum is estimated in spite of motion and current."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_runs import Run
from mrd_runs.signals.current import steady_current
from mrd_runs.signals.mains import MAINS, mains_phase


def recording(hum, phase, frequency=50.0, rate=500.0, seconds=10.0):
    """A damper under a switched current, with noise and hum."""
    rng = np.random.default_rng(4)
    time = np.arange(int(rate * seconds)) / rate
    position = 0.01 * np.sin(2 * np.pi * 1.3 * time)
    velocity = 0.082 * np.cos(2 * np.pi * 1.3 * time)
    current = rng.choice([0.0, 0.2, 0.3], 40)[(4 * time).astype(int)] + rng.normal(0, 0.004, len(time))
    force = (60 + 800 * current) * np.tanh(velocity / 0.01) + 800 * velocity + rng.normal(0, 1.5, len(time))
    return Run("run", time, position, velocity, current, force + hum * np.cos(2 * np.pi * frequency * time + phase))


def phase_of(run: Run) -> np.ndarray:
    return mains_phase(run, steady_current(run.current))


@pytest.mark.parametrize("phase", [-3.0, -1.0, 0.0, 2.0])
@pytest.mark.parametrize("place", [0, 1])
def test_phase_of_a_hum(phase, place):
    estimate = phase_of(recording(2.0, phase, MAINS[place]))[place]
    assert np.exp(1j * (estimate - phase)).real > 0.97


@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_a_low_rate_gives_phase_zero(rate):
    assert np.array_equal(phase_of(recording(2.0, 1.0, rate=rate)), [0.0, 0.0])


def test_a_current_that_switches_all_the_time_gives_phase_zero():
    run = recording(2.0, 1.0)
    busy = Run("run", run.time, run.position, run.velocity, np.arange(len(run.time)) % 10 * 0.05, run.force)
    assert np.array_equal(phase_of(busy), [0.0, 0.0])


@pytest.mark.parametrize("beat", [3.3, 5.3, 6.1])
def test_phase_of_a_hum_in_spite_of_reversals(beat):
    """The phase of a hum of 5 N is estimated although the force reverses by 1.2 kN within 5 ms."""
    run = recording(5.0, 1.0)
    damper = 600.0 * np.tanh(np.cos(2 * np.pi * beat * run.time) / 0.1)
    noise = 1.5 * np.random.default_rng(0).standard_normal(len(run))
    estimate = phase_of(replace(run, force=run.force + damper + noise))[0]
    assert estimate == pytest.approx(phase_of(run)[0], abs=0.1)
