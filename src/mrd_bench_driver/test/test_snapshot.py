"""What the supervisor knows of the bench at one instant, without ROS."""

import dataclasses
import math

import numpy as np
import pytest

from mrd_base import BenchClock
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.snapshot import BenchMonitor, Snapshot, SourceState


def test_nothing_is_known_before_the_first_message() -> None:
    snapshot = BenchMonitor(BenchClock()).snapshot(10.0, "generator")
    assert (snapshot.sample_age, snapshot.servo_age, snapshot.setpoint_age) == (math.inf, math.inf, 0.0)
    assert math.isnan(snapshot.position)
    assert not snapshot.servo.connected


def test_samples_give_age_extremes_speed_and_mean_current() -> None:
    monitor = BenchMonitor(BenchClock())
    for block in range(2):
        position = 1e-3 * block + np.linspace(-5e-3, -4e-3, 20)
        force = np.array([100.0, -300.0, 200.0] + [0.0] * 17)
        monitor.add_samples(10.0 + 0.02 * block, 1e-3, position, force, np.full(20, 0.5), np.linspace(300.0, 302.0, 20))
    snapshot = monitor.snapshot(10.1)
    assert snapshot.temperature == pytest.approx(301.0)
    assert snapshot.has_thermometer
    assert monitor.sample_period == 1e-3
    assert snapshot.sample_age == pytest.approx(10.1 - 10.039)
    assert snapshot.position == pytest.approx(-4e-3)
    assert snapshot.force == -300.0
    assert snapshot.speed == pytest.approx(1e-3 / 0.02)
    assert snapshot.current == pytest.approx(0.5)


def test_a_gap_in_the_samples_gives_no_speed_and_an_empty_block_nothing() -> None:
    monitor = BenchMonitor(BenchClock())
    one = np.array([1e-3])
    monitor.add_samples(10.0, 0.04, one, one, one)
    monitor.add_samples(11.0, 0.04, 5 * one, one, one)
    before = monitor.snapshot(11.0)
    assert math.isnan(before.speed)
    assert math.isnan(before.temperature)
    assert not before.has_thermometer
    monitor.add_samples(12.0, 0.04, one[:0], one[:0], one[:0])
    assert dataclasses.replace(monitor.snapshot(11.0), speed=0.0, temperature=0.0) == dataclasses.replace(
        before, speed=0.0, temperature=0.0
    )


def test_the_servo_is_as_old_as_its_status() -> None:
    monitor = BenchMonitor(BenchClock())
    monitor.add_servo_status(ServoStatus(time=10.0, position=0.002, connected=True))
    snapshot = monitor.snapshot(10.05)
    assert snapshot.servo_age == pytest.approx(0.05)
    assert snapshot.servo is monitor.servo


def test_the_age_of_setpoints_counts_only_while_an_experiment_runs_that_is_followed() -> None:
    def age(now: float, followed: str = "generator") -> float:
        snapshot: Snapshot = monitor.snapshot(now, followed)
        return snapshot.setpoint_age

    monitor = BenchMonitor(BenchClock())
    monitor.add_setpoint(9.0)
    monitor.add_experiment_state("running", 10.0)
    assert age(10.1) == pytest.approx(0.1)
    assert age(10.1, "") == 0.0
    monitor.add_setpoint(10.2)
    assert age(10.3) == pytest.approx(0.1)
    monitor.add_experiment_state("done", 10.4)
    assert age(20.0) == 0.0


def test_a_setpoint_that_nobody_follows_for_its_stamp_is_no_sign_of_life() -> None:
    monitor = BenchMonitor(BenchClock())
    monitor.add_experiment_state("running", 10.0)
    monitor.add_setpoint(10.1)
    monitor.add_setpoint(10.2, lag=0.3)
    snapshot = monitor.snapshot(10.3, "generator")
    assert (snapshot.setpoint_age, snapshot.setpoint_lag) == (pytest.approx(0.2), 0.3)
    monitor.add_setpoint(10.4)
    assert monitor.snapshot(10.4, "generator").setpoint_lag == 0.0
    # It must not be blamed in the next run.
    monitor.add_setpoint(10.5, lag=0.3)
    monitor.add_experiment_state("running", 11.0)
    assert monitor.snapshot(11.2, "generator").setpoint_lag == 0.0


def test_each_source_of_setpoints_speaks_for_itself() -> None:
    monitor = BenchMonitor(BenchClock())
    monitor.add_experiment_state("loaded", 9.0)
    monitor.add_experiment_state("running", 10.0)
    for now, state in ((10.1, "loaded"), (10.2, "running"), (10.3, "aborted: on request")):
        monitor.add_experiment_state(state, now, "controller")
    assert monitor.sources == {
        "generator": SourceState("running", "", 1, 10.0),
        "controller": SourceState("aborted", "on request", 1, 10.3),
    }
    assert monitor.experiment_state == "aborted"
    # What the controller tells is no sign of life of the generator.
    assert monitor.snapshot(10.4, "generator").setpoint_age == pytest.approx(0.4)
    assert monitor.snapshot(10.4, "controller").setpoint_age == 0.0


def test_lvdt_and_encoder_are_compared_at_the_same_instants_once_the_rod_is_homed() -> None:
    monitor, speed = BenchMonitor(BenchClock()), 0.2
    times = 5.0 + 1e-3 * np.arange(20)

    def difference(beyond: float) -> float:
        monitor.add_samples(5.0, 1e-3, speed * times + beyond, np.zeros(20), np.zeros(20))
        return monitor.snapshot(5.03).position_difference

    for homed in (False, True):
        for time in np.arange(4.9, 5.03, 0.01):
            monitor.add_servo_status(ServoStatus(time=time, position=speed * time, connected=True, homed=homed))
        assert difference(0.003) == pytest.approx(0.003) if homed else np.isnan(difference(0.003))
    # A new homing shifts the origin: what was read before does not count any more.
    monitor.add_servo_status(ServoStatus(time=5.04, position=0.0, connected=True, homed=False))
    assert np.isnan(difference(0.003))


@pytest.mark.parametrize("late", [0.0, 0.002, 0.005])
def test_lvdt_and_encoder_are_compared_in_short_blocks_too(late: float) -> None:
    """Blocks of 4 ms of a hybrid test end before the encoder's next report, which comes every 10 ms and some time late."""
    monitor, speed = BenchMonitor(BenchClock()), 0.05
    events = [(5.004 + 4e-3 * k, "samples", 5.0 + 4e-3 * k) for k in range(50)]
    events += [(5.0 + 1e-2 * k + late, "servo", 5.0 + 1e-2 * k) for k in range(20)]
    differences = []
    for now, kind, time in sorted(events):
        if kind == "servo":
            monitor.add_servo_status(ServoStatus(time=time, position=speed * time, connected=True, homed=True))
            continue
        times = time + 1e-3 * np.arange(4)
        beyond = np.where(times < 5.1, 0.0, 0.003)
        monitor.add_samples(time, 1e-3, speed * times + beyond, np.zeros(4), np.zeros(4))
        differences.append((now, monitor.snapshot(now).position_difference))
    known = [difference for now, difference in differences if now > 5.03]
    assert np.isfinite(known).all()
    told = next(now for now, difference in differences if abs(difference) > 0.002)
    assert told < 5.13
