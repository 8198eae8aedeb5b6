"""Homing in virtual time: what it finds, refuses and survives."""

import re

import numpy as np
import pytest

from mrd_trajectory.limits import Limits

from .simulated_servo import MM, UNITS, SimulatedServo, home, sine


@pytest.fixture
def homed() -> SimulatedServo:
    return home()


def test_homing_finds_mid_stroke(homed):
    assert abs(homed.rod) < 0.05 * MM
    assert abs(homed.status.position - homed.rod) < 0.05 * MM
    assert homed.motor.limits
    assert homed.status.enabled
    assert not homed.status.fault
    limit = [text for text in homed.motor.log if text.startswith(("SLN", "SLP"))]
    assert limit == [f"SLN={UNITS.counts(-0.02675)}", f"SLP={UNITS.counts(0.02675)}"]


def test_homing_never_exceeds_its_speed(homed):
    times, rods = np.array(homed.trace).T
    assert np.abs(np.diff(rods) / np.diff(times)).max() < 1.2 * homed.config.homing_speed


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda bench: setattr(bench, "lvdt_runs", False), "too few fresh position samples"),
        (lambda bench: setattr(bench.motor, "velocity", 3000.0), "the rod moves"),
    ],
)
def test_homing_refuses(spoil, line):
    bench = SimulatedServo()
    assert bench.servo.home(bench.now).success
    bench.run(0.05)
    bench.motor.mode, bench.motor.planned = "hold", (0.0, 0.0)
    spoil(bench)
    bench.run(3.0)
    assert line in bench.status.message
    assert bench.status.fault
    assert not bench.status.homed


def test_homing_notices_an_lvdt_that_goes_the_other_way():
    bench = SimulatedServo(position=10 * MM)
    bench.servo.home(bench.now)
    bench.run(0.5)
    begin = bench.rod
    original = bench.servo.add_samples
    bench.servo.add_samples = lambda t, dt, x: original(t, dt, 2 * begin - x)
    bench.run(4.0)
    assert "disagree" in bench.status.message
    assert abs(bench.rod - begin) < 6 * MM


def test_homing_compares_at_the_end():
    bench = SimulatedServo(position=4 * MM)
    bench.servo.home(bench.now)
    bench.run(0.5)
    bench.lvdt_error = 0.8 * MM
    bench.run(4.0)
    assert "disagree by 0.8" in bench.status.message
    assert not bench.status.homed


def unplug_lvdt(bench: SimulatedServo, reading: float = 0.0) -> None:
    original = bench.servo.add_samples
    bench.servo.add_samples = lambda t, dt, x: original(t, dt, np.full(np.size(x), reading))


@pytest.mark.parametrize("tolerance", [0.5 * MM, 10 * MM])
@pytest.mark.parametrize("reading", [0.0, 0.01 * MM, -1.9 * MM])
def test_homing_does_not_believe_an_unplugged_lvdt(reading, tolerance):
    """It reads mid-stroke wherever the rod stands. Further attempts do not bring the rod nearer to its end."""
    bench = SimulatedServo(position=20 * MM, homing_tolerance=tolerance)
    unplug_lvdt(bench, reading)
    for _ in range(4):
        assert bench.servo.home(bench.now).success
        bench.run(4.0)
        assert re.search(r"LVDT and encoder .* moved by -?2\.0\d mm by the encoder, by -?0\.00 mm", bench.status.message)
        assert "unplugged or stuck LVDT" in bench.status.message
        assert bench.status.fault
        assert not bench.status.homed
        assert bench.motor.velocity == 0
        assert bench.servo.reset_fault(bench.now).success
        bench.run(0.1)
    assert max(abs(rod - 20 * MM) for _, rod in bench.trace) < 2.2 * MM


def test_an_lvdt_that_dies_in_a_run_does_not_set_the_origin(homed):
    wanted = sine(homed)
    homed.run(1.2, wanted)
    homed.servo.stop()
    homed.run(0.3)
    assert abs(homed.rod) > 2.5 * MM
    begin = homed.rod
    unplug_lvdt(homed)
    homed.trace.clear()
    assert homed.servo.home(homed.now).success
    homed.run(4.0)
    assert "LVDT and encoder disagree" in homed.status.message
    assert not homed.status.homed
    # What the encoder still knows of mid-stroke shows where there is room.
    assert abs(homed.rod) < abs(begin)
    assert max(abs(rod - begin) for _, rod in homed.trace) < 2.2 * MM


@pytest.mark.parametrize("position", [0.0, 0.3 * MM, 1.9 * MM, -1.9 * MM])
def test_homing_near_mid_stroke_sees_the_lvdt_follow_before_it_goes_there(position):
    bench = SimulatedServo(position=position)
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.status.homed, bench.status
    assert abs(bench.rod) < 0.05 * MM
    assert 1.9 * MM < max(abs(rod - position) for _, rod in bench.trace) < 2.2 * MM
    times, rods = np.array(bench.trace).T
    assert np.abs(np.diff(rods) / np.diff(times)).max() < 1.2 * bench.config.homing_speed


@pytest.mark.parametrize("position", [0.0, 0.4 * MM, -0.4 * MM])
def test_homing_near_mid_stroke_keeps_within_a_short_stroke(position):
    bench = SimulatedServo(position=position, limits=Limits(stroke=5 * MM))
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.status.homed, bench.status
    assert max(abs(rod) for _, rod in bench.trace) < bench.config.limits.reach


def test_a_rod_beyond_the_limits_can_be_homed():
    bench = SimulatedServo(position=27.2 * MM)
    bench.servo.home(bench.now)
    bench.run(8.0)
    assert bench.status.homed
    assert abs(bench.rod) < 0.05 * MM
    assert bench.motor.limits


@pytest.mark.parametrize(("position", "instants"), [(4 * MM, np.arange(0.0, 0.6, 0.005)), (0.0, np.arange(0.2, 1.3, 0.01))])
def test_a_stop_at_any_instant_of_the_homing_is_no_fault(position, instants):
    """Among them is the instant at which the origin waits to be sent. From mid-stroke, the rod goes away and comes back."""
    for duration in instants:
        bench = SimulatedServo(position=position)
        assert bench.servo.home(bench.now).success
        bench.run(duration)
        bench.servo.tick(bench.now)
        assert bench.servo.stop().success
        travel = bench.rod
        bench.run(0.3)
        assert abs(bench.rod - travel) < 1 * MM
        assert bench.status.message == "", duration
        assert not bench.status.homed, duration
        assert bench.motor.velocity == 0
