"""Lines of the mains are estimated in spite of motion and current."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_runs import Run
from mrd_runs.signals.current import steady_current
from mrd_runs.signals.mains import MAINS_LINES, Line, mains_lines, without_mains


def recording(hum, phase, frequency=50.0, rate=500.0, seconds=10.0):
    """A damper under a switched current, with noise and hum."""
    rng = np.random.default_rng(4)
    time = np.arange(int(rate * seconds)) / rate
    position = 0.01 * np.sin(2 * np.pi * 1.3 * time)
    velocity = 0.082 * np.cos(2 * np.pi * 1.3 * time)
    current = rng.choice([0.0, 0.2, 0.3], 40)[(4 * time).astype(int)] + rng.normal(0, 0.004, len(time))
    force = (60 + 800 * current) * np.tanh(velocity / 0.01) + 800 * velocity + rng.normal(0, 1.5, len(time))
    return Run("run", time, position, velocity, current, force + hum * np.cos(2 * np.pi * frequency * time + phase))


def lines_of(run: Run) -> list[Line]:
    return mains_lines(run, steady_current(run.current))


@pytest.mark.parametrize("phase", [-3.0, -1.0, 0.0, 2.0])
@pytest.mark.parametrize("place", range(4))
def test_phase_of_a_hum(phase, place):
    line = lines_of(recording(2.0, phase, MAINS_LINES[place]))[place]
    assert np.exp(1j * (line.phase - phase)).real > 0.97
    assert line.amplitude == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(("frequency", "rate"), [(60.0, 100.0), (100.0, 200.0), (120.0, 200.0), (100.0, 160.0)])
def test_a_hum_that_slow_sampling_folds(frequency, rate):
    run = recording(20.0, 0.7, frequency, rate)
    line = lines_of(run)[MAINS_LINES.index(frequency)]
    expected = 20.0 * np.cos(2 * np.pi * frequency * run.time + 0.7)
    assert np.std(line.at(run.time) - expected) < 0.1 * np.std(expected)


@pytest.mark.parametrize("deviation", [-0.15, -0.03, 0.02, 0.1])
@pytest.mark.parametrize("frequency", [50.0, 100.0, 120.0])
def test_mains_that_deviate_from_their_frequency(frequency, deviation):
    run = recording(10.0, 2.0, frequency + deviation, rate=200.0)
    line = lines_of(run)[MAINS_LINES.index(frequency)]
    expected = 10.0 * np.cos(2 * np.pi * (frequency + deviation) * run.time + 2.0)
    assert np.std(line.at(run.time) - expected) < 0.15 * np.std(expected)


@pytest.mark.parametrize("rate", [25.0, 50.0])
def test_a_line_among_the_harmonics_of_the_motion_is_none(rate):
    assert [line.amplitude for line in lines_of(recording(2.0, 1.0, rate=rate))] == [0.0] * 4


def test_a_current_that_switches_all_the_time_shows_no_line():
    run = recording(2.0, 1.0)
    busy = Run("run", run.time, run.position, run.velocity, np.arange(len(run.time)) % 10 * 0.05, run.force)
    assert [line.amplitude for line in lines_of(busy)] == [0.0] * 4


@pytest.mark.parametrize("beat", [3.3, 5.3, 6.1])
def test_phase_of_a_hum_in_spite_of_reversals(beat):
    """The phase of a hum of 5 N is estimated although the force reverses by 1.2 kN within 5 ms."""
    run = recording(5.0, 1.0)
    damper = 600.0 * np.tanh(np.cos(2 * np.pi * beat * run.time) / 0.1)
    noise = 1.5 * np.random.default_rng(0).standard_normal(len(run))
    line = lines_of(replace(run, force=run.force + damper + noise))[0]
    assert line.phase == pytest.approx(lines_of(run)[0].phase, abs=0.1)


@pytest.mark.parametrize("rate", [100.0, 200.0, 500.0])
def test_lines_are_taken_out_of_noise_and_noise_is_not(rate):
    time = np.arange(2000) / rate
    noise = np.random.default_rng(1).standard_normal(2000)
    lines = sum(Line(frequency * 1.0003, 5.0, frequency).at(time) for frequency in (60.0, 120.0))
    assert np.std(without_mains(noise, time)) == pytest.approx(np.std(noise), rel=0.02)
    # At 100 Hz, the double of 60 Hz lies among the harmonics of the motion, and is left.
    left = np.hypot(1.0, 5.0 / np.sqrt(2)) if rate == 100.0 else 1.0
    assert np.std(without_mains(noise + lines, time)) == pytest.approx(left * np.std(noise), rel=0.03)
