"""The servo's controller with a fake motor in virtual time."""

import math
import random
from pathlib import Path

import numpy as np
import pytest

from mrd_base import from_mapping, read_node_parameters
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.homing import Phase
from mrd_bench_driver.servo.motor_setup import MotorIdentity
from mrd_bench_driver.servo.smartmotor import STATUS_0
from mrd_bench_driver.servo.streaming import RodSetpoint

from .simulated_servo import MM, UNITS, SimulatedServo, home, sine


@pytest.fixture
def homed() -> SimulatedServo:
    return home()


def test_shipped_configuration_is_the_default():
    path = Path(__file__).parents[3] / "config" / "bench.yaml"
    assert from_mapping(ServoConfig, read_node_parameters(path, "servo"), "bench.yaml") == ServoConfig()


@pytest.mark.parametrize(("baud_rate", "most"), [(115200, 0.1), (38400, 0.2), (9600, 0.6)])
def test_sine_is_followed(baud_rate, most):
    bench = home(baud_rate=baud_rate)
    bench.trace.clear()
    wanted = sine(bench)
    bench.run(4.0, wanted, jitter=0.002)
    error = [wanted(now).position - rod for now, rod in bench.trace]
    assert not bench.status.fault, bench.status.message
    assert np.abs(error).max() < most * MM
    assert np.ptp([rod for _, rod in bench.trace]) > 9.5 * MM


def test_motion_is_smooth():
    bench = home()
    wanted = sine(bench)
    bench.run(1.5, wanted, jitter=0.001)
    velocity = []
    original = bench.motor.advance

    def advance(now: float) -> None:
        original(now)
        velocity.append((bench.now, UNITS.metres(1) * bench.motor.velocity))

    bench.motor.advance = advance
    bench.run(2.0, wanted, jitter=0.001)
    error = [wanted(now).velocity - v for now, v in velocity]
    assert np.sqrt(np.mean(np.square(error))) < 2 * MM  # of 47 mm/s


def test_a_dead_host_ends_the_motion_within_a_tenth_of_a_second(homed):
    homed.run(1.17, sine(homed, 10 * MM, 2.0))
    speed = UNITS.metres(1) * abs(homed.motor.velocity)
    assert speed > 0.05
    travelled = homed.settle(0.12)
    assert homed.motor.velocity == 0
    assert travelled <= speed * 0.08
    assert homed.settle(1.0) == 0


def test_setpoints_that_stop_stop_the_rod(homed):
    homed.run(1.3, sine(homed))
    homed.run(0.18)
    assert "X" in homed.motor.log
    assert homed.motor.velocity == 0
    assert "setpoints stopped while the rod moved; check the node that sends them" in homed.status.message
    assert homed.status.enabled, "it holds the rod"
    stands = homed.rod
    homed.run(0.3, lambda now: RodSetpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == stands
    assert "setpoints stopped" in homed.servo.enable(True, homed.now).message
    assert homed.servo.reset_fault(homed.now).success
    assert homed.servo.enable(True, homed.now).success
    homed.run(0.5, lambda now: RodSetpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == pytest.approx(stands + 0.5 * MM, abs=5e-6)


def test_setpoints_from_the_future_keep_the_rod_moving_no_longer_than_others(homed):
    """Their age was counted from their stamps, and the rod moved for 253 ms."""
    ahead, wanted = 0.125, sine(homed)

    def early(now):
        setpoint = wanted(now + ahead)
        return RodSetpoint(now + ahead, setpoint.position, setpoint.velocity, setpoint.acceleration)

    homed.run(1.3, early)
    homed.run(0.16)
    assert "X" in homed.motor.log
    assert homed.motor.velocity == 0


def test_setpoints_that_end_at_rest_leave_the_servo_armed(homed):
    homed.run(0.5, lambda now: RodSetpoint(now, 0.3 * MM, 0, 0))
    homed.run(0.5)
    assert homed.status.enabled
    assert homed.status.message == ""


@pytest.mark.parametrize(
    ("bad", "line"),
    [
        (RodSetpoint(0, 0.027, 0, 0), "exceeds the reach"),
        (RodSetpoint(0, 0, 0.21, 0), "exceeds the speed"),
        (RodSetpoint(0, math.nan, 0, 0), "finite"),
        (RodSetpoint(0, 0.002, 0, 0), "away from the rod"),
    ],
)
def test_impossible_setpoints_are_refused(homed, bad, line):
    homed.run(0.2, lambda now: RodSetpoint(now, bad.position, bad.velocity, bad.acceleration))
    assert line in homed.status.message
    assert homed.status.fault
    assert abs(homed.rod) < 0.05 * MM
    assert not homed.servo.enable(True, homed.now).success


@pytest.mark.parametrize(("age", "followed"), [(0.12, True), (0.14, False), (-0.12, True), (-0.14, False)])
def test_neither_old_setpoints_nor_those_from_the_future_are_followed(homed, age, followed):
    homed.servo.follow(RodSetpoint(homed.now - age, homed.rod, 0, 0), homed.now)
    assert homed.servo.ignored_setpoints == (0 if followed else 1)


def test_setpoints_before_homing_are_ignored():
    bench = SimulatedServo()
    bench.servo.enable(True, bench.now)
    before = bench.rod
    bench.run(0.5, lambda now: RodSetpoint(now, bench.rod + 0.1 * MM, 0.01, 0))
    assert bench.rod == before
    assert bench.servo.ignored_setpoints > 10


def test_following_error_is_a_fault(homed):
    wanted = sine(homed)
    homed.run(1.2, wanted)
    homed.motor.command = lambda text, original=homed.motor.command: None if text == "G" else original(text)
    homed.run(0.3, wanted)
    assert "following error" in homed.status.message
    assert homed.motor.velocity == 0


@pytest.mark.parametrize(
    "spoil",
    [lambda replies: None, lambda replies: [str(random.Random(len(replies[0])).randrange(-40000, 40000)), *replies[1:]]],
    ids=["missing", "wrong"],
)
def test_bad_replies_stop_the_rod(homed, spoil):
    homed.run(1.2, sine(homed))
    homed.tamper = spoil
    wanted = sine(homed)
    homed.run(0.4, lambda now: RodSetpoint(now, wanted(now).position, 0, 0))
    assert homed.status.fault
    assert homed.motor.velocity == 0


def test_single_bad_replies_do_not_disturb(homed):
    rng = random.Random(3)
    homed.tamper = lambda replies: [None, replies, ["31000", *replies[1:]]][rng.choices([0, 1, 2], [1, 40, 1])[0]]
    wanted = sine(homed)
    homed.trace.clear()
    homed.run(4.0, wanted)
    assert not homed.status.fault, homed.status.message
    assert max(abs(wanted(now).position - rod) for now, rod in homed.trace) < 2 * MM


def test_a_reset_motor_is_not_homed_any_more(homed):
    homed.motor.position -= 20000
    homed.run(0.5)
    assert "jumped" in homed.status.message
    assert not homed.status.homed


def test_emergency_stop_latches(homed):
    homed.run(1.2, sine(homed))
    homed.servo.emergency_stop(homed.now)
    assert homed.servo.take_commands() == b"S\r"
    homed.servo.emergency_stop(homed.now)
    homed.run(0.4, sine(homed))
    assert homed.motor.off
    assert homed.status.stopped
    assert not homed.servo.enable(True, homed.now).success
    assert not homed.servo.home(homed.now).success
    assert homed.servo.reset_fault(homed.now).success
    homed.run(0.1)
    assert homed.motor.log[homed.motor.log.index("OFF") :].count("ZS") == 1
    assert not homed.status.stopped
    assert not homed.status.enabled
    assert homed.servo.enable(True, homed.now).success
    homed.run(0.2)
    assert homed.status.enabled
    assert not homed.motor.off
    assert homed.status.homed


@pytest.mark.parametrize("begin", ["home", "enable"])
def test_a_stop_before_the_drive_is_switched_on_is_no_fault(begin):
    """The command that switches the drive on still waits to be sent when the stop comes."""
    bench = SimulatedServo(position=4 * MM)
    bench.run(0.2)
    assert (bench.servo.home(bench.now) if begin == "home" else bench.servo.enable(True, bench.now)).success
    assert bench.servo.stop().success
    bench.run(0.3)
    assert bench.motor.off
    assert bench.status.message == ""
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.status.homed, bench.status


def test_a_stop_holds_the_rod_with_the_drive_on_until_it_is_let_go(homed):
    homed.run(1.2, sine(homed))
    assert homed.servo.stop().success
    homed.run(0.5, sine(homed))
    assert homed.motor.velocity == 0
    assert homed.status.enabled is not homed.motor.off
    assert homed.status.enabled
    assert homed.servo.enable(False, homed.now).success
    homed.run(0.5)
    assert homed.motor.off
    assert not homed.status.enabled


def test_a_button_that_is_held_switches_the_drive_off_too(homed):
    homed.run(1.2, sine(homed))
    for _ in range(30):
        homed.servo.emergency_stop(homed.now)
        homed.run(0.02)
    assert homed.motor.off


def test_motor_faults_are_named_and_reset(homed):
    homed.motor.faults, homed.motor.off = 1 << 6, True
    homed.run(0.2)
    assert "position error too large (Be)" in homed.status.message
    assert not homed.status.enabled
    homed.servo.reset_fault(homed.now)
    homed.run(0.2)
    assert homed.status.message == ""
    assert homed.motor.off


def test_a_fault_that_is_read_once_is_not_believed(homed):
    """Where replies are swapped, a position looks like a status word with faults."""
    homed.run(0.2)
    homed.servo._values[STATUS_0] = 1 << 6
    homed.servo._check_motor_status(STATUS_0, homed.now)
    homed.run(0.3)
    assert homed.status.message == ""


def swap_first_two(replies):
    """Swap replies, but for those that they are checked by where these come alone."""
    return replies if "/" in replies[0] and len(replies) == 2 else [*replies[1::-1], *replies[2:]]


def test_replies_that_are_swapped_are_not_taken_for_faults_of_the_motor(homed):
    """Not even where those that the replies are checked by happen to come in order. 40 counts look like two faults."""

    def setpoint(now):
        return RodSetpoint(now, UNITS.metres(40), 0, 0)

    homed.run(0.3, setpoint)
    homed.tamper = swap_first_two
    homed.run(0.5, setpoint)
    assert "motor:" not in homed.status.message


def test_nor_are_they_while_the_origin_is_set():
    bench = SimulatedServo(position=4 * MM)
    assert bench.servo.home(bench.now).success
    while bench.servo._homing.phase is not Phase.ORIGIN:
        bench.run(bench.servo.period)
    bench.tamper = swap_first_two
    bench.run(0.2)
    assert "motor:" not in bench.status.message


def test_disable_lets_go(homed):
    homed.run(1.2, sine(homed))
    homed.servo.enable(False, homed.now)
    homed.run(0.5)
    assert homed.motor.off
    assert homed.motor.velocity == 0
    assert not homed.status.fault


def test_reconnecting_keeps_the_origin_only_of_a_motor_that_was_not_reset(homed):
    motor = MotorIdentity(UNITS, round(homed.motor.position), (3, 1 << 10))
    for words, kept in (((3, 1 << 10), True), ((3, 0), False)):
        homed.servo.disconnect("unplugged")
        assert not homed.status.connected
        assert "unplugged" in homed.status.message
        homed.servo.connect(MotorIdentity(UNITS, motor.position, words), 115200, homed.now)
        assert homed.status.homed is kept
        assert not homed.status.enabled


@pytest.mark.parametrize("seed", range(8))
def test_requests_at_any_moment_are_no_fault(seed):
    """The drive is switched on and off while replies are on their way, and some of these are lost."""
    bench, rng = SimulatedServo(), random.Random(seed)
    requests = (
        bench.servo.stop,
        lambda: bench.servo.home(bench.now),
        lambda: bench.servo.enable(True, bench.now),
        lambda: bench.servo.enable(False, bench.now),
    )

    def tamper(replies):
        if rng.random() > 0.05:
            return replies
        for _ in range(rng.randint(1, 2)):
            rng.choice(requests)()
        return replies if rng.random() < 0.8 else None

    bench.tamper = tamper
    bench.run(30.0)
    assert not bench.servo.status(bench.now).fault, bench.servo.status(bench.now).message
