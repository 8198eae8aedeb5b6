"""Bench time that waits: for work, for messages, for threads, but not for the dead."""

import math
import queue
import signal
import subprocess
import sys
import threading
import time

import pytest

from mrd_base import InputError
from mrd_base.barrier import Barrier
from mrd_base.barrier_clock import BarrierClock

pytestmark = pytest.mark.realtime


class Plant:
    """A plant with something to do every 10 ms."""

    def __init__(self) -> None:
        self.time = 0.0

    def next_event(self) -> float:
        return self.time + 0.01

    def read_line(self, count: int, now: float) -> None:
        pass

    def advance_line(self, now: float, awaited: bool) -> bool:
        return False

    def advance(self, now: float) -> bool:
        due = now >= self.next_event() - 1e-6
        self.time = now if due else self.time
        return due


class Bench:
    """An owner of the time and its participants."""

    def __init__(self, path, *expected: str, pace: float = math.inf) -> None:
        self.path, self.reports = path, []
        self.barrier = Barrier(path, expected, 0.0, pace, self.reports.append)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        self.clocks: list[BarrierClock] = []

    def _run(self) -> None:
        try:
            self.barrier.run(Plant(), self._closing)
        finally:
            self.barrier.close()

    def clock(self, name: str, join: bool = True) -> BarrierClock:
        self.clocks.append(BarrierClock(self.path, name))
        if join:
            self.clocks[-1].join()
        return self.clocks[-1]

    def lose(self) -> None:
        self._closing.set()
        self._thread.join()

    def end(self) -> None:
        for clock in self.clocks:
            clock.leave()
        self.lose()


@pytest.fixture
def make_bench(tmp_path):
    benches = []

    def make(*expected: str, **options: float) -> Bench:
        benches.append(Bench(tmp_path / "clock", *expected, **options))
        return benches[-1]

    yield make
    for bench in benches:
        bench.end()


def until(condition, timeout: float = 10.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "did not happen"
        time.sleep(1e-3)


class Inbox:
    """A channel between two threads, on which messages take a while."""

    lasting = False

    def __init__(self, handle, delay: float = 0.0) -> None:
        self._messages: queue.Queue = queue.Queue()
        self._sent, self._delay = 0, delay
        self.handle = handle

    def send(self, clock: BarrierClock, message: object, skipped: int = 0) -> None:
        clock.sending("channel")
        self._sent += 1 + skipped
        threading.Timer(self._delay, self._messages.put, [(message, self._sent)]).start()

    def take(self):
        try:
            return self._messages.get_nowait()
        except queue.Empty:
            return None


def test_time_begins_when_all_are_there(make_bench):
    bench = make_bench("one", "two")
    one = bench.clock("one")
    time.sleep(0.2)
    assert one.now() == 0.0
    bench.clock("two")
    until(lambda: one.now() > 1.0)


def test_time_waits_for_work_and_for_nothing_else(make_bench):
    bench = make_bench("worker", "other")
    worker, other = bench.clock("worker", join=False), bench.clock("other")
    begin = time.monotonic()
    instants = []

    def work() -> None:
        with worker.busy():
            for _ in range(100):
                worker.sleep(0.1)
                instants.append(worker.now())
            with worker.busy():  # within its own work, a thread may wait, too
                worker.sleep(0.5)
            time.sleep(0.3)
            instants.append(worker.now())

    thread = threading.Thread(target=work)
    thread.start()
    worker.join()
    thread.join()
    assert instants == pytest.approx([*(0.1 * k for k in range(1, 101)), 10.5], abs=1e-4)
    assert time.monotonic() - begin < 5.0, "10 s of bench time take no 10 s"
    until(lambda: other.now() > 20.0)


def test_time_stands_until_messages_have_been_processed_in_the_order_of_the_instants(make_bench):
    bench = make_bench("sender", "receiver")
    sender, receiver = bench.clock("sender", join=False), bench.clock("receiver", join=False)
    received: list[tuple[float, float]] = []
    losses: list[str] = []
    receiver.on_loss = losses.append
    inbox = Inbox(lambda sent: received.append((sent, receiver.now())), delay=0.02)
    timer = sender.timer(0.05, lambda: inbox.send(sender, sender.now()))
    sender.join({"channel": lambda: ["b"]}, identity="a")
    receiver.join(None, [("channel", inbox, lambda: ["a"])], identity="b")
    until(lambda: len(received) >= 20)
    timer.cancel()
    assert [sent for sent, _ in received[:20]] == pytest.approx([0.05 * k for k in range(1, 21)])
    assert all(sent == now for sent, now in received)
    assert not losses


def test_a_message_that_a_newer_one_has_replaced_is_not_waited_for(make_bench):
    """In a queue of one, as of every latched topic, the newer message may take the place of the one that was announced."""
    bench = make_bench("sender", "receiver")
    sender, receiver = bench.clock("sender", join=False), bench.clock("receiver", join=False)
    received, losses = [], []
    receiver.on_loss = losses.append
    inbox = Inbox(received.append)
    sender.join({"channel": lambda: ["b"]}, identity="a")
    receiver.join(None, [("channel", inbox, lambda: ["a"])], identity="b")
    until(lambda: receiver.now() > 0.1)
    sender.sending("channel")  # the message itself never comes
    time.sleep(0.1)
    inbox.send(sender, "newer", skipped=1)
    inbox.send(sender, "newest")
    begin = receiver.now()
    until(lambda: receiver.now() > begin + 1.0, 3.0)
    assert received == ["newer", "newest"]
    assert not losses


def test_what_another_thread_wakes_has_not_waited_in_bench_time(make_bench):
    bench = make_bench("servo")
    servo = bench.clock("servo", join=False)
    waiter = servo.waiter()
    woken = []

    def line() -> None:
        with servo.busy():
            for _ in range(50):
                before = servo.now()
                if waiter.wait(before + 1.0):
                    woken.append((waking[-1], servo.now()))

    waking = []

    def wake() -> None:
        waking.append(servo.now())
        waiter.wake()

    servo.timer(0.35, wake)
    thread = threading.Thread(target=line)
    thread.start()
    servo.join()
    thread.join(10)
    assert len(woken) > 20
    assert all(before == after for before, after in woken)


def test_timers_of_all_participants_are_due_at_the_same_instants(make_bench):
    bench = make_bench("one", "two")
    ticks: dict[str, list[float]] = {"one": [], "two": []}
    clocks = {name: bench.clock(name, join=False) for name in ticks}
    for name, clock in clocks.items():
        clock.timer(0.01 if name == "one" else 0.03, lambda clock=clock, name=name: ticks[name].append(clock.now()))
        clock.join()
    until(lambda: len(ticks["two"]) > 100)
    assert set(ticks["two"][:100]) <= set(ticks["one"])
    assert ticks["one"][:100] == pytest.approx([0.01 * k for k in range(1, 101)], abs=1e-5)


def test_whoever_looks_at_what_others_do_sees_all_of_the_instant(make_bench):
    bench = make_bench("one", "two")
    one, two = bench.clock("one", join=False), bench.clock("two", join=False)
    done: list[float] = []

    def work() -> None:
        now = two.now()
        time.sleep(0.02)
        done.append(now)

    two.timer(0.01, work)
    seen = []

    def look() -> None:
        with one.busy():
            for _ in range(5):
                one.sleep_step(0.01)
                seen.append(len(done))

    one.hold()
    one.join()
    two.join()
    looking = threading.Thread(target=look)
    looking.start()
    one.release()
    looking.join(10.0)
    assert seen == [1, 2, 3, 4, 5]


def test_a_pace_is_kept_and_delays_are_not_caught_up_in_a_burst(make_bench):
    bench = make_bench("one", pace=2.0)
    clock = bench.clock("one")
    until(lambda: clock.now() > 0.0)
    begin, start = time.monotonic(), clock.now()
    with clock.busy():
        time.sleep(0.5)
        assert clock.now() == start
    time.sleep(0.5)
    elapsed = (clock.now() - start) / (time.monotonic() - begin - 0.5)
    assert elapsed < 2.8


OTHER = """
import sys, time
from mrd_base.barrier_clock import BarrierClock
clock = BarrierClock(sys.argv[1], "other")
clock.join()
with clock.busy():
    print("at work", flush=True)
    while True:
        clock.sleep(0.05)
"""


@pytest.mark.parametrize(("end", "reason"), [(signal.SIGKILL, "has died"), (signal.SIGSTOP, "was stopped by a signal")])
def test_a_dead_participant_is_named_and_time_goes_on_without_it(make_bench, end, reason):
    bench = make_bench("one", "other")
    one = bench.clock("one")
    other = subprocess.Popen([sys.executable, "-c", OTHER, str(bench.path)], stdout=subprocess.PIPE)
    try:
        assert other.stdout.readline() == b"at work\n"
        until(lambda: one.now() > 0.5)
        other.send_signal(end)
        until(lambda: bench.reports, timeout=5.0)
        assert bench.reports == [f"other {reason}; the bench goes on without it"]
        now = one.now()
        until(lambda: one.now() > now + 1.0)
    finally:
        other.kill()
        other.communicate()


def test_a_participant_that_hangs_in_a_callback_is_named_and_left_behind(make_bench, monkeypatch):
    monkeypatch.setattr("mrd_base.barrier._HANGING_STALL", 0.5)
    bench = make_bench("one", "other")
    one, other = bench.clock("one"), bench.clock("other")
    ended = threading.Event()
    with other.busy():
        other.timer(1.0, ended.wait)
    try:
        until(lambda: bench.reports, timeout=5.0)
        hangs = "hangs: its messages and timers have not ended for 0.5 s"
        assert bench.reports == [f"other {hangs}; the bench goes on without it"]
        now = one.now()
        until(lambda: one.now() > now + 1.0)
    finally:
        ended.set()


def test_long_work_of_another_thread_is_no_hanging(make_bench, monkeypatch):
    monkeypatch.setattr("mrd_base.barrier._HANGING_STALL", 0.5)
    bench = make_bench("one")
    one = bench.clock("one")
    with one.busy():
        time.sleep(1.5)
    now = one.now()
    until(lambda: one.now() > now + 1.0)
    assert not bench.reports


def test_a_participant_that_was_left_behind_follows_the_time_of_the_bench(make_bench):
    bench = make_bench("one", "other", pace=50.0)
    one = bench.clock("one")
    program = OTHER + "        print(clock.now(), flush=True)\n"
    other = subprocess.Popen([sys.executable, "-c", program, str(bench.path)], stdout=subprocess.PIPE, text=True)
    try:
        assert other.stdout.readline() == "at work\n"
        other.send_signal(signal.SIGSTOP)
        until(lambda: bench.reports, timeout=5.0)
        now = one.now()
        until(lambda: one.now() > now + 20.0)
        other.send_signal(signal.SIGCONT)
        begin, deadline = one.now(), time.monotonic() + 10.0
        while float(other.stdout.readline()) < begin + 100.0:
            assert time.monotonic() < deadline
        assert one.now() > begin + 100.0
    finally:
        other.kill()
        other.communicate()


def test_without_an_owner_time_goes_on_as_on_the_wall_so_that_watchdogs_act(make_bench):
    bench = make_bench("one")
    one = bench.clock("one", join=False)
    ticks = []
    one.timer(0.01, lambda: ticks.append(one.now()))
    one.join()
    until(lambda: ticks)
    ended = []

    def wait() -> None:
        with one.busy():
            while not ended:
                one.sleep(1e3)
                ended.append(one.now())

    with one.busy():
        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        bench.lose()
        lost, begin, count = one.now(), time.monotonic(), len(ticks)
        one.sleep(0.2)
        assert one.now() - lost == pytest.approx(time.monotonic() - begin, abs=0.1)
    until(lambda: len(ticks) > count + 5)
    assert not ended


def test_who_leaves_still_waits_by_the_time_of_the_bench_and_without_its_owner_by_the_wall(make_bench):
    """Otherwise, the threads of a node that ends would keep its process for ever."""
    bench = make_bench("one", "other", pace=50.0)
    one, other = bench.clock("one"), bench.clock("other")
    begin, ended = one.now(), []

    def wait(duration: float) -> None:
        one.sleep_until(begin + duration)
        ended.append(one.now() - begin)

    for duration in (20.0, 1e3):
        threading.Thread(target=wait, args=[duration], daemon=True).start()
    until(lambda: one.now() > begin + 5.0)
    one.leave()
    until(lambda: ended, timeout=5.0)
    assert 20.0 <= ended[0] < 40.0
    assert other.now() > begin + 20.0
    now = one.now()
    bench.lose()
    one.sleep(0.2)
    assert now + 0.2 <= one.now() < now + 100.0


def test_an_error_of_a_callback_is_kept_for_the_node(make_bench):
    bench = make_bench("one")
    one = bench.clock("one", join=False)
    one.timer(0.01, lambda: 1 / 0)
    one.join()
    until(lambda: one.error is not None)
    assert isinstance(one.error, ZeroDivisionError)


def test_two_owners_do_not_share_a_time(make_bench):
    bench = make_bench()
    with pytest.raises(InputError, match="another simulated bench uses it"):
        Barrier(bench.path, [], 0.0, 1.0, print)
