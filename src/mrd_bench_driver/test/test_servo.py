"""The servo against a motor of a few lines: in virtual time, then on a pseudo-terminal."""

import contextlib
import math
import os
import pty
import random
import select
import signal
import subprocess
import termios
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

from mrd_base import BenchClock, from_mapping, read_node_parameters
from mrd_bench_driver.drive import Setpoint
from mrd_bench_driver.servo import Servo
from mrd_bench_driver.servo_config import ServoConfig
from mrd_bench_driver.servo_loop import ServoLoop
from mrd_bench_driver.smartmotor import Drive, Units
from mrd_bench_driver.smartmotor_setup import Motor

UNITS = Units(Drive())
MM = 1e-3


class FakeMotor:
    """Trapezoids and registers; just enough of a SmartMotor for the servo."""

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


class Bench:
    """Servo and motor in virtual time, with the line's delays; ``tamper`` may spoil the replies (None: missing)."""

    def __init__(self, position: float = 0.0, **config: object) -> None:
        self.config = ServoConfig(**config)  # type: ignore[arg-type]
        self.motor = FakeMotor(position + 0.007)  # the encoder knows no origin
        self.offset = -0.007
        self.servo = Servo(self.config)
        self.now = 100.0
        self.motor.time = self.now
        self.tamper = lambda replies: replies
        self.trace: list[tuple[float, float]] = []
        self.lvdt_error, self.lvdt_runs = 0.0, True
        self.servo.connected(Motor(UNITS, round(self.motor.position), (3, 0)), self.config.baud_rate, self.now)

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
                self.servo.setpoint(setpoint(self.now), self.now)
            if self.lvdt_runs:
                self.servo.samples(self.now, 0.001, np.full(10, self.rod + self.lvdt_error))
            self.send(self.servo.take())
            start, batch = self.now, self.servo.tick(self.now)
            due = start + self.servo.period
            replies = self.tamper(self.send(batch.data))
            if replies is None:
                self.now += 0.03
                self.servo.missed()
            else:
                self.now += 0.002 + 10 * (len(replies[0]) + 1) / self.config.baud_rate
                self.motor.advance(self.now)
                values = [report.parse(reply.encode()) for report, reply in zip(batch.reports, replies, strict=True)]
                self.servo.replied(batch, values, self.now)
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
    def report(self):
        return self.servo.report(self.now)


@pytest.fixture
def homed() -> Bench:
    return home()


def home(**config: object) -> Bench:
    bench = Bench(position=4 * MM, **config)
    assert bench.servo.home(bench.now).success
    bench.run(4.0)
    assert bench.report.homed, bench.report
    return bench


def sine(bench: Bench, amplitude: float = 5 * MM, frequency: float = 1.5):
    begin, w = bench.now, 2 * math.pi * frequency

    def position(now: float) -> float:
        # A soft start over one second, smooth in the acceleration.
        s = min(1.0, max(0.0, now - begin))
        return amplitude * s**3 * (10 - 15 * s + 6 * s**2) * math.sin(w * (now - begin))

    def at(now: float) -> Setpoint:
        h = 1e-4
        before, here, after = position(now - h), position(now), position(now + h)
        return Setpoint(now, here, (after - before) / (2 * h), (after - 2 * here + before) / h**2)

    return at


def test_shipped_configuration_is_the_default():
    path = Path(__file__).parents[3] / "config" / "bench.yaml"
    assert from_mapping(ServoConfig, read_node_parameters(path, "servo"), "bench.yaml") == ServoConfig()


def test_homing_finds_mid_stroke(homed):
    assert abs(homed.rod) < 0.05 * MM
    assert abs(homed.report.position - homed.rod) < 0.05 * MM
    assert homed.motor.limits
    assert homed.report.enabled
    assert not homed.report.fault
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
    bench = Bench()
    assert bench.servo.home(bench.now).success
    bench.run(0.05)
    bench.motor.mode, bench.motor.planned = "hold", (0.0, 0.0)
    spoil(bench)
    bench.run(3.0)
    assert line in bench.report.message
    assert bench.report.fault
    assert not bench.report.homed


def test_homing_notices_an_lvdt_that_goes_the_other_way():
    bench = Bench(position=10 * MM)
    bench.servo.home(bench.now)
    bench.run(0.5)
    begin = bench.rod
    original = bench.servo.samples
    bench.servo.samples = lambda t, dt, x: original(t, dt, 2 * begin - x)
    bench.run(4.0)
    assert "disagree" in bench.report.message
    assert abs(bench.rod - begin) < 6 * MM


def test_homing_compares_at_the_end():
    bench = Bench(position=4 * MM)
    bench.servo.home(bench.now)
    bench.run(0.5)
    bench.lvdt_error = 0.8 * MM
    bench.run(4.0)
    assert "disagree by 0.8" in bench.report.message
    assert not bench.report.homed


def test_a_rod_beyond_the_limits_can_be_homed():
    bench = Bench(position=27.2 * MM)
    bench.servo.home(bench.now)
    bench.run(8.0)
    assert bench.report.homed
    assert abs(bench.rod) < 0.05 * MM
    assert bench.motor.limits


@pytest.mark.parametrize(("baud_rate", "most"), [(115200, 0.1), (38400, 0.2), (9600, 0.6)])
def test_sine_is_followed(baud_rate, most):
    bench = home(baud_rate=baud_rate)
    bench.trace.clear()
    wanted = sine(bench)
    bench.run(4.0, wanted, jitter=0.002)
    error = [wanted(now).position - rod for now, rod in bench.trace]
    assert not bench.report.fault, bench.report.message
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
    assert "setpoints stopped" in homed.report.message
    assert not homed.report.enabled
    stands = homed.rod
    homed.run(0.3, lambda now: Setpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == stands
    assert homed.servo.enable(True, homed.now).success
    homed.run(0.5, lambda now: Setpoint(now, stands + 0.5 * MM, 0, 0))
    assert homed.rod == pytest.approx(stands + 0.5 * MM, abs=5e-6)


def test_setpoints_that_end_at_rest_leave_the_servo_armed(homed):
    homed.run(0.5, lambda now: Setpoint(now, 0.3 * MM, 0, 0))
    homed.run(0.5)
    assert homed.report.enabled
    assert homed.report.message == ""


@pytest.mark.parametrize(
    ("bad", "line"),
    [
        (Setpoint(0, 0.027, 0, 0), "exceeds the reach"),
        (Setpoint(0, 0, 0.21, 0), "exceeds the speed"),
        (Setpoint(0, math.nan, 0, 0), "finite"),
        (Setpoint(0, 0.002, 0, 0), "away from the rod"),
    ],
)
def test_impossible_setpoints_are_refused(homed, bad, line):
    homed.run(0.2, lambda now: Setpoint(now, bad.position, bad.velocity, bad.acceleration))
    assert line in homed.report.message
    assert homed.report.fault
    assert abs(homed.rod) < 0.05 * MM
    assert not homed.servo.enable(True, homed.now).success


def test_setpoints_before_homing_are_ignored():
    bench = Bench()
    bench.servo.enable(True, bench.now)
    before = bench.rod
    bench.run(0.5, lambda now: Setpoint(now, bench.rod + 0.1 * MM, 0.01, 0))
    assert bench.rod == before
    assert bench.servo.ignored_setpoints > 10


def test_following_error_is_a_fault(homed):
    wanted = sine(homed)
    homed.run(1.2, wanted)
    homed.motor.command = lambda text, original=homed.motor.command: None if text == "G" else original(text)
    homed.run(0.3, wanted)
    assert "following error" in homed.report.message
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
    homed.run(0.4, lambda now: Setpoint(now, wanted(now).position, 0, 0))
    assert homed.report.fault
    assert homed.motor.velocity == 0


def test_single_bad_replies_do_not_disturb(homed):
    rng = random.Random(3)
    homed.tamper = lambda replies: [None, replies, ["31000", *replies[1:]]][rng.choices([0, 1, 2], [1, 40, 1])[0]]
    wanted = sine(homed)
    homed.trace.clear()
    homed.run(4.0, wanted)
    assert not homed.report.fault, homed.report.message
    assert max(abs(wanted(now).position - rod) for now, rod in homed.trace) < 2 * MM


def test_a_reset_motor_is_not_homed_any_more(homed):
    homed.motor.position -= 20000
    homed.run(0.5)
    assert "jumped" in homed.report.message
    assert not homed.report.homed


def test_emergency_stop_latches(homed):
    homed.run(1.2, sine(homed))
    homed.servo.emergency_stop(homed.now)
    assert homed.servo.take() == b"S\r"
    homed.servo.emergency_stop(homed.now)
    homed.run(0.4, sine(homed))
    assert homed.motor.off
    assert homed.report.stopped
    assert not homed.servo.enable(True, homed.now).success
    assert not homed.servo.home(homed.now).success
    assert homed.servo.reset_fault(homed.now).success
    homed.run(0.1)
    assert homed.motor.log[homed.motor.log.index("OFF") :].count("ZS") == 1
    assert not homed.report.stopped
    assert not homed.report.enabled
    assert homed.servo.enable(True, homed.now).success
    homed.run(0.2)
    assert homed.report.enabled
    assert not homed.motor.off
    assert homed.report.homed


def test_motor_faults_are_named_and_reset(homed):
    homed.motor.faults, homed.motor.off = 1 << 6, True
    homed.run(0.2)
    assert "position error too large (Be)" in homed.report.message
    assert not homed.report.enabled
    homed.servo.reset_fault(homed.now)
    homed.run(0.2)
    assert homed.report.message == ""
    assert homed.motor.off


def test_disable_lets_go(homed):
    homed.run(1.2, sine(homed))
    homed.servo.enable(False, homed.now)
    homed.run(0.5)
    assert homed.motor.off
    assert homed.motor.velocity == 0
    assert not homed.report.fault


def test_reconnecting_keeps_the_origin_only_of_a_motor_that_was_not_reset(homed):
    motor = Motor(UNITS, round(homed.motor.position), (3, 1 << 10))
    for words, kept in (((3, 1 << 10), True), ((3, 0), False)):
        homed.servo.lost("unplugged")
        assert not homed.report.connected
        assert "unplugged" in homed.report.message
        homed.servo.connected(Motor(UNITS, motor.position, words), 115200, homed.now)
        assert homed.report.homed is kept
        assert not homed.report.enabled


# -- on a pseudo-terminal ----------------------------------------------------------------------------------------------


class FakeLine:
    """The motor behind a pseudo-terminal, at one baud rate, in wall time."""

    def __init__(self, path, baud_rate: int = 9600) -> None:
        self.link, self.baud_rate = path, baud_rate
        self.motor = FakeMotor(3 * MM)
        self.motor.time = time.monotonic()
        self.mute = False
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
            if not select.select([self.master], [], [], 0.005)[0]:
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
def looped(fake: FakeLine, **config: object):
    reports = []
    loop = ServoLoop(ServoConfig(port=str(fake.link), **config), BenchClock(), reports.append)  # type: ignore[arg-type]
    loop.start()
    try:
        yield loop, reports
    finally:
        loop.close()


def until(condition, limit: float = 4.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.005)


@pytest.fixture
def fake(tmp_path):
    line = FakeLine(tmp_path / "motor")
    yield line
    with contextlib.suppress(OSError):
        line.unplug()


def test_loop_finds_the_motor_and_raises_the_baud_rate(fake):
    with looped(fake) as (loop, reports):
        until(lambda: reports and reports[-1].connected)
        assert fake.baud_rate == 115200
        assert reports[-1].position == pytest.approx(3 * MM, abs=1e-6)
        until(lambda: not math.isnan(reports[-1].temperature))
        first = len(reports)
        time.sleep(0.5)
        assert 20 <= len(reports) - first <= 55
        assert loop.servo.missed_replies == 0
    assert fake.motor.log[-2:] == ["X", "OFF"]


def test_loop_stops_at_once_and_leaves_the_drive_off(fake):
    with looped(fake) as (loop, reports):
        until(lambda: reports and reports[-1].connected)
        loop.servo.enable(True, loop.servo.report(0).time)
        until(lambda: not fake.motor.off)
        fake.answer = lambda text, reply: None  # the loop waits for a reply while the stop comes
        time.sleep(0.02)
        begin = time.monotonic()
        loop.servo.emergency_stop(BenchClock().now())
        until(lambda: "S" in fake.motor.log)
        assert time.monotonic() - begin < 0.1
    assert fake.motor.off


def test_loop_reconnects_and_does_not_resume(fake):
    with looped(fake) as (loop, reports):
        until(lambda: reports and reports[-1].connected)
        loop.servo.enable(True, BenchClock().now())
        until(lambda: reports[-1].enabled)
        fake.unplug()
        until(lambda: not reports[-1].connected)
        fake.baud_rate, fake.motor.off = 9600, True
        fake.motor.log.clear()
        fake.plug()
        until(lambda: reports[-1].connected)
        time.sleep(0.1)
        assert "G" not in fake.motor.log
        assert not reports[-1].enabled


def test_late_replies_are_never_taken_for_others(fake):
    with looped(fake) as (loop, reports):
        until(lambda: reports and reports[-1].connected)
        held = []

        def late(text: str, reply: str | None) -> str | None:
            # The tenth reply comes only after the next question, and so do all that follow.
            if reply is None:
                return None
            held.append(reply)
            return None if len(held) == 10 else held[-2] if len(held) > 10 else reply

        fake.answer = late
        time.sleep(0.3)
        fake.answer = lambda text, reply: reply
        time.sleep(0.1)
        assert loop.servo.missed_replies > 0
        assert {round(report.position, 5) for report in reports if report.connected} == {0.003}


def test_wrong_motor_is_refused(fake):
    fake.answer = lambda text, reply: "4000" if text == "RRES" else reply
    with looped(fake) as (_, reports):
        until(lambda: reports)
        assert "4000 counts per revolution" in reports[-1].message
        assert not reports[-1].connected


def test_mute_motor_is_a_lost_line(fake):
    with looped(fake) as (_, reports):
        until(lambda: reports and reports[-1].connected)
        fake.mute = True
        until(lambda: not reports[-1].connected)
        assert "no longer answers" in reports[-1].message


# -- as a node ---------------------------------------------------------------------------------------------------------


def test_node_homes_follows_and_lets_go(fake):
    rclpy = pytest.importorskip("rclpy")
    from std_msgs.msg import Bool
    from std_srvs.srv import SetBool, Trigger

    from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED
    from mrd_interfaces import msg

    process = subprocess.Popen(["ros2", "run", "mrd_bench_driver", "servo", "--ros-args", "-p", f"port:={fake.link}"])
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

        def spin(condition, each=lambda: None, limit: float = 10.0):
            end = time.monotonic() + limit
            while not condition():
                assert time.monotonic() < end, states[-1] if states else "no state"
                each()
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

        assert call(Trigger, "servo/home").success
        spin(lambda: states[-1].homed, lvdt)
        assert abs(states[-1].position) < 0.05 * MM
        begin = clock.now()

        def follow() -> None:
            t = clock.now() - begin
            setpoints.publish(stamped(msg.Setpoint, position=1e-3 * (1 - math.cos(6 * t)), velocity=6e-3 * math.sin(6 * t)))

        spin(lambda: states[-1].position > 1.5 * MM, follow)
        assert states[-1].moving
        assert not states[-1].fault
        stop.publish(Bool(data=True))
        spin(lambda: states[-1].stopped and not states[-1].moving)
        assert "S" in fake.motor.log
        assert not call(SetBool, "servo/enable", data=True).success
        assert call(Trigger, "servo/reset_fault").success
        assert call(SetBool, "servo/enable", data=True).success
        spin(lambda: states[-1].enabled)
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=5) == 0
        assert fake.motor.log[-2:] == ["X", "OFF"]
    finally:
        process.kill()
        process.wait()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
