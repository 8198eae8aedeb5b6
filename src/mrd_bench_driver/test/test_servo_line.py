"""The servo on a pseudo-terminal, and as a node."""

import contextlib
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
import tty

import pytest

from mrd_base import BenchClock
from mrd_bench_driver.servo.communication import ServoCommunication
from mrd_bench_driver.servo.config import ServoConfig

from .simulated_servo import MM, UNITS, FakeMotor
from .unread_pipe import fill, unread_pipe

pytestmark = pytest.mark.realtime


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
        # A line that was slow at first is asked again.
        until(lambda: statuses and "4000 counts per revolution" in statuses[-1].message)
        assert not any(status.connected for status in statuses)


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
        # The supervisor's request to let go may be lost, but not the end of its permission to move.
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
    options = ["-r", f"__ns:={graph.node.get_namespace()}", "-p", f"port:={fake.link}", "-p", "lease_timeout_ms:=1000.0"]
    with unread_pipe() as stderr:
        process = subprocess.Popen(
            [sys.executable, "-c", "from mrd_bench_driver.nodes.servo import main; main()", "--ros-args", *options],
            stderr=stderr,
        )
        try:
            graph.until(lambda: states and states[-1].connected and leases.get_subscription_count())
            graph.during(0.1)
            assert graph.call("servo/enable", SetBool, data=True).success
            graph.until(lambda: states[-1].enabled and stop.get_subscription_count() == 2)
            fill(stderr)
            fake.answer = lambda text, reply: None
            queries = fake.motor.log.count("RPA")
            until(lambda: fake.motor.log.count("RPA") > queries)  # its reply will not come
            stop.publish(Bool(data=True))
            until(lambda: "S" in fake.motor.log)
            # Neither does the log of the stop itself leave the drive on.
            until(lambda: "OFF" in fake.motor.log)
        finally:
            process.kill()
            process.wait()


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
