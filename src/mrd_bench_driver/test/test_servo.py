"""The servo with a fake motor: in virtual time, on a pseudo-terminal, and as a node."""

import contextlib
import math
import os
import pty
import random
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

from mrd_base import BenchClock, from_mapping, read_node_parameters
from mrd_bench_driver.servo.communication import ServoCommunication
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.controller import ServoController
from mrd_bench_driver.servo.homing import Phase
from mrd_bench_driver.servo.motor_setup import MotorIdentity
from mrd_bench_driver.servo.smartmotor import STATUS_0, Drivetrain, MotorUnits, ReplyError
from mrd_bench_driver.servo.streaming import RodSetpoint
from mrd_trajectory.limits import Limits

pytestmark = pytest.mark.realtime

UNITS = MotorUnits(Drivetrain())
MM = 1e-3


class FakeMotor:
    """A SmartMotor reduced to what the servo needs: trapezoidal profiles and registers."""

    def __init__(self, position: float = 0.0) -> None:
        self.position = float(UNITS.counts(position))
        self.velocity = 0.0  # counts/s
        self.target, self.goal = 0, self.position
        self.vt, self.adt, self.planned = 0, 0, (0.0, 1.0)
        self.off, self.mode = True, "hold"
        self.faults, self.limits = 0, False
        self.log: list[str] = []
        self.time = 0.0

    def advance(self, time: float) -> None:
        while self.time < time - 1e-9:
            dt = min(2.5e-4, time - self.time)
            self.time += dt
            speed, rate = self.planned
            wanted = 0.0
            if self.mode == "go":
                distance = self.goal - self.position
                reach = math.sqrt(2 * rate * abs(distance))
                wanted = math.copysign(min(speed, reach), distance)
                if abs(distance) < max(1.0, abs(self.velocity) * dt) and abs(self.velocity) <= 2 * rate * dt + 1:
                    self.position, self.velocity, self.mode = self.goal, 0.0, "hold"
                    continue
            change = wanted - self.velocity
            self.velocity += math.copysign(min(abs(change), rate * dt), change)
            self.position += self.velocity * dt

    def command(self, text: str) -> str | None:
        self.log.append(text)
        name, _, value = text.partition("=")
        if name == "PT":
            self.target = int(value)
        elif name == "VT":
            self.vt = int(value)
        elif name == "ADT":
            self.adt = int(value)
        elif name == "O":
            self.position = self.goal = float(value)
        elif name == "G" and not self.faults:
            self.off, self.mode, self.goal = False, "go", float(self.target)
            self.planned = self.vt / 65536 * 8000, self.adt / 65536 * 8000**2
        elif name in ("X", "OFF", "S"):
            self.mode = "hold"
            self.off |= name == "OFF"
            self.velocity *= name == "X"
        elif name == "ZS":
            self.faults = 0
        elif name in ("SLE", "SLD"):
            self.limits = name == "SLE"
        word_0 = 1 | self.off << 1 | (self.mode == "go") << 2 | self.faults
        answers = {"RPA": round(self.position), "RW(0)": word_0, "RW(1)": self.limits << 10, "RUJA": 36900}
        answers |= {"RTEMP": 31, "RRES": 8000, "RSAMP": 8000, "RSP": "12500/5.0.3.44"}
        return str(answers[text]) if text in answers else None


class SimulatedServo:
    """Controller and motor in virtual time, with the delays of the line. ``tamper`` may change replies, None drops them."""

    def __init__(self, position: float = 0.0, **config: object) -> None:
        self.config = ServoConfig(**config)  # type: ignore[arg-type]
        self.motor = FakeMotor(position + 0.007)  # the encoder knows no origin
        self.offset = -0.007
        self.servo = ServoController(self.config)
        self.now = 100.0
        self.motor.time = self.now
        self.tamper = lambda replies: replies
        self.trace: list[tuple[float, float]] = []
        self.lvdt_error, self.lvdt_runs = 0.0, True
        self.servo.connect(MotorIdentity(UNITS, round(self.motor.position), (3, 0)), self.config.baud_rate, self.now)

    @property
    def rod(self) -> float:
        return UNITS.metres(1) * self.motor.position + self.offset

    def send(self, data: bytes) -> list[str]:
        replies = []
        for byte in data.replace(b"\r", b" ").split():
            text = byte.decode()
            self.now += 10 * (len(text) + 1) / self.config.baud_rate
            self.motor.advance(self.now)
            if text.startswith("O="):
                self.offset = self.rod - UNITS.metres(int(text[2:]))
            if (reply := self.motor.command(text)) is not None:
                self.taken = self.now
                replies.append(reply)
        return replies

    def run(self, duration: float, setpoint=None, jitter: float = 0.0) -> None:
        end, due = self.now + duration, self.now
        rng = random.Random(1)
        while self.now < end:
            self.now = max(due, self.now) + rng.random() * jitter
            self.motor.advance(self.now)
            if setpoint is not None:
                self.servo.follow(setpoint(self.now), self.now)
            if self.lvdt_runs:
                self.servo.add_samples(self.now, 0.001, np.full(10, self.rod + self.lvdt_error))
            self.send(self.servo.take_commands())
            start, batch = self.now, self.servo.tick(self.now)
            due = start + self.servo.period
            replies = self.tamper(self.send(batch.data))
            if replies is None:
                self.now += 0.03
                self.servo.replies_missed()
            else:
                self.now += 0.002 + 10 * (len(replies[0]) + 1) / self.config.baud_rate
                self.motor.advance(self.now)
                try:
                    values = [query.parse(reply.encode()) for query, reply in zip(batch.queries, replies, strict=True)]
                except ReplyError:
                    self.servo.replies_missed()
                else:
                    self.servo.take_replies(batch, values, self.now)
            self.trace.append((self.now, self.rod))

    def settle(self, duration: float) -> float:
        """Travel of the rod without the servo."""
        before, most = self.rod, 0.0
        for _ in range(int(duration / 1e-3)):
            self.now += 1e-3
            self.motor.advance(self.now)
            most = max(most, abs(self.rod - before))
        return most

    @property
    def status(self):
        return self.servo.status(self.now)


@pytest.fixture
def homed() -> SimulatedServo:
    return home()


def home(**config: object) -> SimulatedServo:
    bench = SimulatedServo(position=4 * MM, **config)
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.status.homed, bench.status
    return bench


def sine(bench: SimulatedServo, amplitude: float = 5 * MM, frequency: float = 1.5):
    begin, w = bench.now, 2 * math.pi * frequency

    def position(now: float) -> float:
        # A soft start over one second, smooth in the acceleration.
        s = min(1.0, max(0.0, now - begin))
        return amplitude * s**3 * (10 - 15 * s + 6 * s**2) * math.sin(w * (now - begin))

    def at(now: float) -> RodSetpoint:
        h = 1e-4
        before, here, after = position(now - h), position(now), position(now + h)
        return RodSetpoint(now, here, (after - before) / (2 * h), (after - 2 * here + before) / h**2)

    return at


def test_shipped_configuration_is_the_default():
    path = Path(__file__).parents[3] / "config" / "bench.yaml"
    assert from_mapping(ServoConfig, read_node_parameters(path, "servo"), "bench.yaml") == ServoConfig()


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
    assert "setpoints stopped" in homed.status.message
    assert homed.status.enabled, "it holds the rod"
    stands = homed.rod
    homed.run(0.3, lambda now: RodSetpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == stands
    assert "setpoints stopped" in homed.servo.enable(True, homed.now).message
    assert homed.servo.reset_fault(homed.now).success
    assert homed.servo.enable(True, homed.now).success
    homed.run(0.5, lambda now: RodSetpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == pytest.approx(stands + 0.5 * MM, abs=5e-6)


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


# On a pseudo-terminal


class FakeLine:
    """The motor behind a pseudo-terminal, at one baud rate, in wall time."""

    def __init__(self, path, baud_rate: int = 9600) -> None:
        self.link, self.baud_rate = path, baud_rate
        self.motor = FakeMotor(3 * MM)
        self.motor.time = time.monotonic()
        self.mute = self.babble = False
        self.answer = lambda text, reply: reply
        self.plug()

    def plug(self) -> None:
        self._stop = threading.Event()
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(self.slave))
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        self._stop.set()
        self._thread.join()
        self.link.unlink()
        os.close(self.master)
        os.close(self.slave)

    def _serve(self) -> None:
        rest = b""
        while not self._stop.is_set():
            if self.babble:
                os.write(self.master, b"1")
            if not select.select([self.master], [], [], 2e-4 if self.babble else 0.005)[0]:
                continue
            data = os.read(self.master, 1024)
            speed = termios.tcgetattr(self.slave)[5]
            if speed != getattr(termios, f"B{self.baud_rate}"):
                continue
            *whole, rest = (rest + data).replace(b" ", b"\r").split(b"\r")
            self.motor.advance(time.monotonic())
            for text in whole:
                command = bytes(byte for byte in text if byte < 0x80).decode()
                if command.startswith("BAUD(0)="):
                    self.baud_rate = int(command[8:])
                reply = self.answer(command, self.motor.command(command))
                if reply is not None and not self.mute:
                    os.write(self.master, reply.encode() + b"\r")


@contextlib.contextmanager
def communicating(fake: FakeLine, **config: object):
    """A controller that is connected with the fake motor, and the list of its statuses."""
    statuses = []
    communication = ServoCommunication(
        ServoConfig(port=str(fake.link), **config),  # type: ignore[arg-type]
        BenchClock(),
        statuses.append,
    )
    communication.start()
    try:
        yield communication.controller, statuses
    finally:
        communication.close()


def until(condition, limit: float = 4.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.002)


@pytest.fixture
def fake(tmp_path):
    line = FakeLine(tmp_path / "motor")
    yield line
    with contextlib.suppress(OSError):
        line.unplug()


def test_the_motor_is_found_and_its_baud_rate_raised(fake):
    with communicating(fake) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        assert fake.baud_rate == 115200
        assert statuses[-1].position == pytest.approx(3 * MM, abs=1e-6)
        until(lambda: not math.isnan(statuses[-1].temperature))
        first, begin = len(statuses), time.monotonic()
        until(lambda: len(statuses) >= first + 20)
        # 100 ticks per second; the machine may be slower, never faster.
        assert time.monotonic() - begin > 0.15
        assert controller.missed_replies == 0
    until(lambda: fake.motor.log[-2:] == ["X", "OFF"])


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


def test_a_stop_interrupts_the_wait_for_replies_and_the_drive_is_left_off(fake):
    with communicating(fake) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        controller.enable(True, controller.status(0).time)
        until(lambda: not fake.motor.off)
        fake.answer = lambda text, reply: None
        queries = fake.motor.log.count("RPA")
        until(lambda: fake.motor.log.count("RPA") > queries)  # its reply will not come
        begin = time.monotonic()
        controller.emergency_stop(BenchClock().now())
        until(lambda: "S" in fake.motor.log)
        assert time.monotonic() - begin < 0.5
    until(lambda: fake.motor.off)


def test_a_stop_is_written_before_anybody_is_told_of_it(fake):
    """Whoever is told blocks, like a log whose terminal stands still."""
    statuses, told, go_on = [], threading.Event(), threading.Event()

    def on_status(status) -> None:
        statuses.append(status)
        if status.stopped:
            told.set()
            go_on.wait()

    communication = ServoCommunication(ServoConfig(port=str(fake.link)), BenchClock(), on_status)
    communication.start()
    try:
        until(lambda: statuses and statuses[-1].connected)
        fake.answer = lambda text, reply: None
        queries = fake.motor.log.count("RPA")
        until(lambda: fake.motor.log.count("RPA") > queries)  # its reply will not come
        communication.controller.emergency_stop(BenchClock().now())
        assert told.wait(4.0)
        until(lambda: "S" in fake.motor.log)
    finally:
        go_on.set()
        communication.close()


def test_a_stop_by_the_check_of_the_lease_is_written_before_anybody_is_told(fake):
    statuses, events = [], []

    def check() -> None:
        if statuses and statuses[-1].connected and not events:
            events.append("checked")
            communication.controller.emergency_stop(BenchClock().now())

    def on_status(status) -> None:
        statuses.append(status)
        if status.stopped and len(events) == 1:
            until(lambda: "S" in fake.motor.log)
            events.append("told")

    communication = ServoCommunication(ServoConfig(port=str(fake.link)), BenchClock(), on_status, check)
    communication.start()
    try:
        until(lambda: events == ["checked", "told"])
    finally:
        communication.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_of_the_thread_of_the_line_stops_the_motor_and_ends_the_process(fake, monkeypatch):
    events = []
    with communicating(fake) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        monkeypatch.setattr(os, "kill", lambda *arguments: events.append((arguments, list(fake.motor.log[-2:]))))
        monkeypatch.setattr(controller, "take_replies", lambda *arguments: 1 / 0)
        until(lambda: events)
        assert statuses[-1].message.startswith("internal error: ZeroDivisionError(")
    assert events == [((os.getpid(), signal.SIGTERM), ["X", "OFF"])]


def test_a_motor_that_is_plugged_in_again_does_not_move(fake):
    with communicating(fake) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        controller.enable(True, BenchClock().now())
        until(lambda: statuses[-1].enabled)
        fake.unplug()
        until(lambda: not statuses[-1].connected)
        fake.baud_rate, fake.motor.off = 9600, True
        fake.motor.log.clear()
        fake.plug()
        until(lambda: statuses[-1].connected)
        until(lambda: fake.motor.log.count("RPA") > 10)
        assert "G" not in fake.motor.log
        assert not statuses[-1].enabled


def test_a_port_that_appears_late_is_opened_at_once_and_its_motor_may_boot(fake):
    fake.unplug()
    with communicating(fake) as (_controller, statuses):
        time.sleep(5.0)  # by now, the driver waits for several seconds between its attempts
        assert not statuses[-1].connected
        fake.mute = True  # it boots
        fake.plug()
        threading.Timer(1.0, setattr, (fake, "mute", False)).start()
        until(lambda: statuses[-1].connected, limit=3.0)


def test_late_replies_are_never_taken_for_others(fake):
    with communicating(fake) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        held = []

        def late(text: str, reply: str | None) -> str | None:
            # The tenth reply comes only after the next query, and so do all that follow.
            if reply is None:
                return None
            held.append(reply)
            return None if len(held) == 10 else held[-2] if len(held) > 10 else reply

        fake.answer = late
        until(lambda: len(held) > 25)
        fake.answer = lambda text, reply: reply
        received = len(statuses)
        until(lambda: len(statuses) > received + 5)
        assert controller.missed_replies > 0
        assert {round(status.position, 5) for status in statuses if status.connected} == {0.003}


def test_a_motor_of_another_resolution_is_refused(fake):
    fake.answer = lambda text, reply: "4000" if text == "RRES" else reply
    with communicating(fake) as (_, statuses):
        until(lambda: statuses)
        assert "4000 counts per revolution" in statuses[-1].message
        assert not statuses[-1].connected


def test_a_motor_that_falls_silent_is_a_lost_line(fake):
    with communicating(fake) as (_, statuses):
        until(lambda: statuses and statuses[-1].connected)
        fake.mute = True
        until(lambda: not statuses[-1].connected)
        assert "no longer answers" in statuses[-1].message


@pytest.mark.parametrize("fault", ["mute", "babble"])
def test_a_motion_without_positions_is_stopped_in_time_whatever_the_line_does(fake, fault):
    with communicating(fake, baud_rate=9600, feedback_timeout=0.18) as (controller, statuses):
        until(lambda: statuses and statuses[-1].connected)
        assert controller.home(BenchClock().now()).success
        setattr(fake, fault, True)
        until(lambda: statuses[-1].fault)
        named = re.match(r"no valid position from the motor for (\d+) ms of motion; check the line", statuses[-1].message)
        assert named, statuses[-1].message
        assert int(named[1]) < 210  # a loaded machine is late by less than an exchange on this slow line takes
        until(lambda: "X" in fake.motor.log)


# As a node


def test_node_homes_follows_and_lets_go(fake):
    rclpy = pytest.importorskip("rclpy")
    from std_msgs.msg import Bool
    from std_srvs.srv import SetBool, Trigger

    from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED
    from mrd_interfaces import msg

    # The wall's time is no bench time: a busy machine needs patience.
    patience = [f"{name}_timeout_ms:=600.0" for name in ("setpoint", "feedback", "lease")]
    options = [word for parameter in (f"port:={fake.link}", *patience) for word in ("-p", parameter)]
    process = subprocess.Popen(["ros2", "run", "mrd_bench_driver", "servo", "--ros-args", *options])
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("servo_test", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    states, clock = [], BenchClock()
    stamp = lambda t: {"sec": int(t), "nanosec": int(t % 1 * 1e9)}  # noqa: E731
    try:
        node.create_subscription(msg.ServoState, "servo_state", states.append, RECORDED)
        samples = node.create_publisher(msg.BenchSamples, "samples", RECORDED)
        setpoints = node.create_publisher(msg.Setpoint, "setpoint", COMMAND)
        stop = node.create_publisher(Bool, "emergency_stop", LATCHED)
        leases = node.create_publisher(msg.Lease, "lease", COMMAND)
        mode: int | None = msg.BenchState.IDLE

        def renew() -> None:
            if mode is None:
                return
            number = 7 if mode == msg.BenchState.IDENTIFICATION else 0
            leases.publish(stamped(msg.Lease, holder="test", mode=mode, number=number))

        def enter(new: int | None) -> None:
            """Change the mode of the bench, and let the servo hear it; None renews the lease no more."""
            nonlocal mode
            mode = new
            until = time.monotonic() + 0.1
            spin(lambda: time.monotonic() > until)

        node.create_timer(0.02, renew)

        def spin(condition, publish=lambda: None, limit: float = 10.0):
            end = time.monotonic() + limit
            while not condition():
                assert time.monotonic() < end, states[-1] if states else "no state"
                publish()
                executor.spin_once(timeout_sec=0.01)

        def call(kind, name, **request):
            client = node.create_client(kind, name)
            spin(client.service_is_ready)
            future = client.call_async(kind.Request(**request))
            spin(future.done)
            return future.result()

        def stamped(kind, **fields):
            message = kind(**fields)
            for name, value in stamp(clock.now()).items():
                setattr(message.header.stamp, name, value)
            return message

        spin(lambda: states and states[-1].connected)
        origin = fake.motor.position - UNITS.counts(2 * MM)

        def lvdt() -> None:
            # The fake shifts its register when homed; the rod itself goes on from where it was.
            homed = any(text.startswith("O=") for text in fake.motor.log)
            position = UNITS.metres(fake.motor.position - (0 if homed else origin))
            samples.publish(stamped(msg.BenchSamples, sample_period=0.001, position=[position] * 10))

        enter(msg.BenchState.IDLE)
        refused = call(Trigger, "servo/home")
        assert (refused.success, refused.message[:27]) == (False, "the bench is in mode idle; ")
        enter(msg.BenchState.HOMING)
        assert call(Trigger, "servo/home").success
        spin(lambda: states[-1].homed, lvdt)
        enter(msg.BenchState.IDENTIFICATION)
        assert abs(states[-1].position) < 0.05 * MM
        begin = clock.now()

        def follow() -> None:
            t = clock.now() - begin
            position, velocity = 1e-3 * (1 - math.cos(6 * t)), 6e-3 * math.sin(6 * t)
            setpoints.publish(stamped(msg.Setpoint, position=position, velocity=velocity, lease=7))
            setpoints.publish(stamped(msg.Setpoint, position=-0.01, lease=6))  # of somebody else

        spin(lambda: states[-1].position > 1.5 * MM, follow)
        assert states[-1].moving
        assert not states[-1].fault
        stop.publish(Bool(data=True))
        spin(lambda: states[-1].stopped and not states[-1].moving)
        assert "S" in fake.motor.log
        assert not call(SetBool, "servo/enable", data=True).success
        assert not call(Trigger, "servo/reset_fault").success  # not in a run
        enter(msg.BenchState.FAULT)
        assert call(Trigger, "servo/reset_fault").success
        enter(msg.BenchState.IDENTIFICATION)
        assert call(SetBool, "servo/enable", data=True).success
        spin(lambda: states[-1].enabled)
        # The supervisor's request to let go may be lost, but not the end of its leave to move.
        enter(msg.BenchState.IDLE)
        spin(lambda: not states[-1].enabled)
        # The supervisor's own request is no stop by somebody, but nobody goes on with the lease after it either.
        enter(msg.BenchState.IDENTIFICATION)
        assert call(SetBool, "servo/enable", data=True).success
        spin(lambda: states[-1].enabled)
        assert call(Trigger, "servo/rest").success
        spin(lambda: not states[-1].enabled)
        assert states[-1].halt_time == -math.inf
        assert not call(SetBool, "servo/enable", data=True).success
        enter(msg.BenchState.IDLE)
        enter(msg.BenchState.IDENTIFICATION)
        assert call(SetBool, "servo/enable", data=True).success
        spin(lambda: states[-1].enabled)
        # A stop ends the lease: nobody goes on with it as if nothing had happened.
        called = clock.now()
        assert call(Trigger, "servo/stop").success
        spin(lambda: states[-1].halt_time > called)
        assert call(SetBool, "servo/enable", data=True).message.startswith("somebody called a stop")
        # Without a supervisor, the servo stops by itself, and latches.
        enter(None)
        spin(lambda: states[-1].stopped)
        assert states[-1].message.startswith("the supervisor test has been silent for 6")
        enter(msg.BenchState.HOMING)
        assert "latched (the supervisor test has been silent" in call(Trigger, "servo/home").message
        # A button tells when it was pressed also where the stop is latched already: a reset may be under way.
        called = clock.now()
        assert call(Trigger, "servo/emergency_stop").success
        spin(lambda: states[-1].halt_time > called)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=5) == 0
        assert fake.motor.log[-2:] == ["X", "OFF"]
    finally:
        process.kill()
        process.wait()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_log_that_blocks_keeps_nobody_from_stopping_the_rod(fake, graph):
    """Nobody reads the pipe, as if a terminal stood still."""
    from std_msgs.msg import Bool
    from std_srvs.srv import SetBool

    from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED
    from mrd_interfaces import msg

    states = graph.subscribe("servo_state", msg.ServoState, RECORDED)
    leases = graph.node.create_publisher(msg.Lease, "lease", COMMAND)
    stop = graph.node.create_publisher(Bool, "emergency_stop", LATCHED)

    def renew() -> None:
        lease, now = msg.Lease(holder="test", mode=msg.BenchState.HOMING), graph.clock.now()
        lease.header.stamp.sec, lease.header.stamp.nanosec = int(now), int(now % 1 * 1e9)
        leases.publish(lease)

    graph.node.create_timer(0.02, renew)
    unread, stderr = os.pipe()
    options = ["-r", f"__ns:={graph.node.get_namespace()}", "-p", f"port:={fake.link}", "-p", "lease_timeout_ms:=1000.0"]
    process = subprocess.Popen(
        [sys.executable, "-c", "from mrd_bench_driver.nodes.servo import main; main()", "--ros-args", *options],
        stderr=stderr,
    )
    try:
        graph.until(lambda: states and states[-1].connected and leases.get_subscription_count())
        graph.during(0.1)
        assert graph.call("servo/enable", SetBool, data=True).success
        graph.until(lambda: states[-1].enabled and stop.get_subscription_count() == 2)
        filler = os.open(f"/proc/self/fd/{stderr}", os.O_WRONLY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(filler, b"x")
        os.close(filler)
        fake.answer = lambda text, reply: None
        queries = fake.motor.log.count("RPA")
        until(lambda: fake.motor.log.count("RPA") > queries)  # its reply will not come
        stop.publish(Bool(data=True))
        until(lambda: "S" in fake.motor.log)
    finally:
        process.kill()
        process.wait()
        os.close(unread)
        os.close(stderr)


@contextlib.contextmanager
def unspun_node(fake, monkeypatch):
    """Yield a node that nobody spins, as if a callback hung, and what makes it hear a mode. The thread of its line works."""
    rclpy = pytest.importorskip("rclpy")
    from mrd_bench_driver.nodes.servo import ServoNode
    from mrd_interfaces import msg

    # A busy machine needs patience, but for the lease.
    parameters = f"port:={fake.link}", "feedback_timeout_ms:=1000.0", "lease_timeout_ms:=400.0"
    monkeypatch.setattr("sys.argv", ["servo", "--ros-args", *(word for text in parameters for word in ("-p", text))])
    rclpy.init(args=["--ros-args", "-r", "__ns:=/hung"])
    node = ServoNode()

    def hear(mode: str) -> None:
        lease = msg.Lease(holder="test", mode=getattr(msg.BenchState, mode))
        lease.header.stamp = node.stamp()
        node._lease._on_lease(lease)

    try:
        until(lambda: node._controller.status(0.0).connected)
        yield node, hear
    finally:
        node.close()
        node.destroy_node()
        rclpy.shutdown()


def test_a_servo_whose_callbacks_hang_stops_the_homing_without_its_supervisor(fake, monkeypatch):
    with unspun_node(fake, monkeypatch) as (node, hear):
        hear("HOMING")
        assert node._home().success
        until(lambda: node._controller.status(0.0).enabled)
        until(lambda: node._controller.status(0.0).stopped)
        assert "the supervisor test has been silent for " in node._controller.status(0.0).message
        until(lambda: "S" in fake.motor.log)


def test_the_drive_goes_off_with_the_end_of_a_control_that_a_stop_has_ended(fake, monkeypatch):
    with unspun_node(fake, monkeypatch) as (node, hear):
        hear("CONTROL")
        assert node._enable().success
        until(lambda: not fake.motor.off)
        assert node._halt().success
        until(lambda: "X" in fake.motor.log)
        hear("IDLE")
        until(lambda: fake.motor.off)
        assert not node._controller.status(0.0).enabled
