"""Ride metrics and tracking."""

import numpy as np
import pytest

from mrd_control.excitations import Bump
from mrd_control.laws import LAWS
from mrd_control.loop import run_loop
from mrd_control.ride import DataSheet, ride_metrics, weighted_rms, weighting_k
from mrd_control.tracking import tracking

RATE = 1000.0


@pytest.mark.parametrize(
    ("frequency", "factor"), [(1.0, 0.482), (2.0, 0.531), (4.0, 0.967), (5.0, 1.039), (8.0, 1.036), (16.0, 0.768)]
)
def test_the_weighting_is_that_of_the_standard(frequency, factor):
    assert abs(weighting_k(np.array([frequency])))[0] == pytest.approx(factor, rel=0.01)
    time = np.arange(60_000) / RATE
    sine = np.sqrt(2) * np.sin(2 * np.pi * frequency * time)
    assert weighted_rms(sine, RATE) == pytest.approx(factor, rel=0.01)


def test_a_constant_acceleration_does_not_count():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(20_000)
    assert weighted_rms(noise + 9.81, RATE) == pytest.approx(weighted_rms(noise, RATE), rel=1e-9)


def test_metrics_are_those_of_the_signals(car, bouc_wen):
    time = np.arange(12_000) / RATE
    base = np.stack([0.01 * np.sin(8 * time), 0.08 * np.cos(8 * time)], axis=1)
    result = run_loop(car, bouc_wen, LAWS["skyhook_on_off"], base, RATE)
    ride, kept = ride_metrics(car, result, DataSheet(0.2, 3.5), 2.0), slice(2000, None)
    assert ride.acceleration == pytest.approx(result.acceleration[kept].std())
    assert ride.contact == pytest.approx(190e3 * (result.state[kept, 1] - base[kept, 0]).std())
    assert ride.peak_travel == np.abs(result.travel[kept]).max()
    assert ride.energy == pytest.approx(3.5 * (result.current[kept] ** 2).mean())
    assert ride.contact_share == pytest.approx(ride.contact / (360.0 * 9.80665))
    assert ride.peak_share == pytest.approx(ride.peak_travel / 0.1)
    assert ride.lift_off == 0.0
    high = result.commanded[kept] > 0.15
    assert ride.switching == pytest.approx(np.count_nonzero(np.diff(high.astype(int)) == 1) / 10.0)
    assert ride.switching > 1.0


def test_a_wheel_that_leaves_the_road_is_noticed(car, bouc_wen):
    """A bump of 10 cm: the tyre would have to pull for some time, and the damper reach its end."""
    base = Bump(height=0.1, length=2.0, speed=20.0).base(4000, RATE)
    result = run_loop(car, bouc_wen, LAWS["constant_current"], base, RATE)
    ride = ride_metrics(car, result, DataSheet(), 0.5)
    pulls = 190e3 * (result.state[500:, 1] - base[500:, 0]) > 360.0 * 9.80665
    assert ride.lift_off == pytest.approx(pulls.mean())
    assert 0.0 < ride.lift_off < 0.2
    assert ride.peak_share > 1.0


@pytest.mark.parametrize("delay", [-0.0035, 0.0, 0.0004, 0.0021, 0.017])
def test_tracking_finds_a_delay_and_its_errors(delay):
    period = 1 / 1024
    time = np.arange(20_480) * period

    def motion(t):
        return 3e-3 * np.sin(2 * np.pi * 1.1 * t) + 1e-3 * np.sin(2 * np.pi * 3.7 * t + 1.0)

    found = tracking(motion(time), motion(time - delay), period)
    assert found.delay == pytest.approx(delay, abs=2e-5)
    error = motion(time - delay) - motion(time)
    assert found.nrms == pytest.approx(np.sqrt(np.sum(error**2) / np.sum(motion(time) ** 2)))
    assert found.peak == pytest.approx(np.abs(error).max() / np.abs(motion(time)).max())
