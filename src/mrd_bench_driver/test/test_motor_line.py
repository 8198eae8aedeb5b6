"""The line over a pseudo-terminal: whole replies or an error, in time."""

import math
import os
import pty
import select
import threading
import time
import tty

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import BenchClock
from mrd_bench_driver.servo.motor_line import LineLostError, MotorLine, WaitInterrupted
from mrd_bench_driver.servo.smartmotor import ReplyError

pytestmark = pytest.mark.realtime


class Far:
    """The far end: answers each request with the next script of (wait, bytes)."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        clock = BenchClock()
        self.waiter = clock.waiter()
        self.line = MotorLine(os.ttyname(self.slave), 115200, clock, self.waiter)
        self.line.drain()

    def ask(self, *script: tuple[float, bytes], count: int = 1, timeout: float = 0.05, most: float = math.inf):
        def answer() -> None:
            select.select([self.master], [], [], 1.0)
            os.read(self.master, 1024)
            for wait, data in script:
                time.sleep(wait)
                os.write(self.master, data)

        thread = threading.Thread(target=answer)
        thread.start()
        begin = time.monotonic()
        try:
            latest = self.line.clock.now() + most
            return [reply for reply, _ in self.line.exchange(b"RPA\r", count, timeout, latest)]
        finally:
            self.took = time.monotonic() - begin
            thread.join()


@pytest.fixture(scope="module")
def shared():
    far = Far()
    yield far
    far.line.close()
    os.close(far.master)
    os.close(far.slave)


@pytest.fixture
def far():
    far = Far()
    yield far
    far.line.close()


def test_whole_and_split_replies(far):
    assert far.ask((0, b"-12345\r")) == [b"-12345"]
    assert far.ask((0, b"-12"), (0.01, b"345\r")) == [b"-12345"]
    assert far.ask((0, b"1\r2"), (0.01, b"\r"), count=2) == [b"1", b"2"]


@pytest.mark.parametrize(
    ("script", "line"),
    [
        ([], "no reply in time"),
        ([(0, b"-12")], "incomplete reply"),
        ([(0, b"1\r2\r")], "after the last expected reply"),
        ([(0, b"x" * 400)], "without an end"),
    ],
)
def test_what_is_wrong_is_refused_and_forgotten(far, script, line):
    with pytest.raises(ReplyError, match=line):
        far.ask(*script)
    assert far.ask((0, b"7\r")) == [b"7"]


def test_a_late_reply_is_not_the_next_answer(far):
    with pytest.raises(ReplyError, match="no reply"):
        far.ask()
    far.line.drain()
    os.write(far.master, b"111\r")
    time.sleep(0.01)
    with pytest.raises(ReplyError, match="without a query"):
        far.line.exchange(b"RPA\r", 1, 0.05)
    assert far.ask((0, b"7\r")) == [b"7"]


def test_trickling_bytes_do_not_stretch_the_timeout(far):
    with pytest.raises(ReplyError):
        far.ask(*[(0.01, b"1")] * 100)
    assert far.took < 0.5


def test_an_exchange_ends_in_time_and_its_reply_is_not_the_next_answer(far):
    with pytest.raises(ReplyError, match="no reply"):
        far.ask((0.1, b"111\r"), timeout=2.0, most=0.05)
    assert far.took < 1.0
    assert far.ask((0, b"7\r")) == [b"7"]


def test_nothing_is_asked_before_the_line_is_quiet_and_its_owner_is_not_kept(far, monkeypatch):
    far.line.baud_rate = 2400  # quiet after 20 ms: time enough for a byte to be delivered
    wait = far.waiter.wait

    def wait_for_noise(until: float, line: int) -> bool:
        os.write(far.master, b"1")
        return wait(until, line)

    with monkeypatch.context() as noisy:
        noisy.setattr(far.waiter, "wait", wait_for_noise)
        for _ in range(3):
            begin = time.monotonic()
            with pytest.raises(ReplyError, match="without a query"):
                far.line.exchange(b"RPA\r", 1, 0.02)
            assert time.monotonic() - begin < 0.3
            assert not select.select([far.master], [], [], 0.0)[0], "a query was sent"
    assert far.ask((0, b"7\r")) == [b"7"]


def test_wake_breaks_off_at_once(far):
    threading.Timer(0.02, far.waiter.wake).start()
    with pytest.raises(WaitInterrupted):
        far.ask(timeout=2.0)
    assert far.took < 1.0


def test_unplugged(far):
    os.close(far.slave)
    os.close(far.master)
    with pytest.raises(LineLostError, match=r"is gone|does not take"):
        far.line.exchange(b"RPA\r", 1, 0.05)
    far.line.close()


def test_a_port_that_is_not_there_or_taken(far):
    with pytest.raises(LineLostError, match="cannot be opened"):
        MotorLine("/dev/does-not-exist", 9600, BenchClock(), far.waiter)
    with pytest.raises(LineLostError, match="cannot be opened"):
        MotorLine(os.ttyname(far.slave), 9600, BenchClock(), far.waiter)


@settings(max_examples=40)
@given(st.binary(max_size=300))
def test_any_bytes_give_lines_or_a_refusal(shared, data):
    try:
        (reply,) = shared.ask((0, data or b"\r"), timeout=0.005)
    except ReplyError:
        return
    assert reply == (data or b"\r").split(b"\r")[0].strip(b"\n")
