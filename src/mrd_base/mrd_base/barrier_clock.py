"""The clock of a process that takes part in a simulated bench (docs/simulated_bench.md)."""

import contextlib
import fcntl
import json
import math
import mmap
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any, Protocol

from mrd_base.clock import BenchClock, Waiter
from mrd_base.errors import InputError

# The channel of the bytes that go to the motor over its serial line.
LINE = "motor line"

# Wall time in s for the owner of the time to come up.
_START_TIMEOUT = 180.0
# Wall time in s after which an announced message counts as lost.
_LOST_AFTER = 10.0
# The same where its number has come already: either it came early, or that was a message of somebody else on the channel.
_STRANGER_WAIT = 0.01
# The same where a larger number has come: either that message took its place in a queue of one, or somebody else sent it.
_NEWER_WAIT = 0.1
# Wall time in s for ROS to match publishers and subscriptions of a new participant.
_MATCHING_TIMEOUT = 30.0
# Wall time in s between two looks for messages of others than participants.
_OUTSIDERS_INTERVAL = 0.05
# Wall time in s in which an owner that ends has closed all of its files.
_END_OF_OWNER = 0.05
# Bench times in s that differ by less are one instant: a double holds the time since 1970 to 0.2 us only.
INSTANT = 1e-5


class Packet:
    """Kinds of packets, the first byte of each. A participant sends HELLO, BUSY, REPORT, ALIVE, MATCHED and LEAVE."""

    HELLO, BUSY, REPORT, ALIVE, MATCHED, LEAVE = b"H", b"B", b"R", b"A", b"m", b"L"
    MATCH, GRANT = b"M", b"G"


# The head of a report or grant: its kind; number of the latest grant; time at which the participant next has work to do,
# or time of the grant; whether the participant waits for bytes on the serial line, or some came.
HEAD = struct.Struct("=cId?")
# Index of a channel and number of its latest message.
ENTRY = struct.Struct("=Hq")
PACKET_SIZE = 1 << 16


def socket_address(path: Path) -> tuple[int, str]:
    """Return a descriptor to close and a short name for a socket in a folder whose path may be too long for a socket."""
    folder = os.open(path.parent, os.O_DIRECTORY)
    return folder, f"/proc/self/fd/{folder}/{path.name}"


def time_file(path: Path) -> Path:
    """Return the file in which the bench time of the owner with a socket stands."""
    return path.with_name(path.name + ".time")


class Inbox(Protocol):
    """The messages that arrive on one channel."""

    @property
    def lasting(self) -> bool:
        """Whether the latest messages come also to one who joins after they were sent."""

    def take(self) -> tuple[Any, int] | None:
        """Return the next message and its number, or None if none is there."""

    def handle(self, message: Any) -> None:
        """Process a message."""


class BenchTimer:
    """Calls back at whole multiples of a period in bench time; timers of several nodes are due at the same instants."""

    def __init__(self, clock: "BarrierClock", period: float, callback: Callable[[], None]) -> None:
        self._clock, self._period, self.callback = clock, period, callback
        self.due = clock.next_multiple(period)

    def reset(self) -> None:
        """Wait for the next multiple of the period."""
        self.due = self._clock.next_multiple(self._period)

    def cancel(self) -> None:
        """Call back no more until `reset`."""
        self.due = math.inf


class _BarrierWaiter(Waiter):
    """Lets one thread, which is busy otherwise, wait for a bench time."""

    def __init__(self, clock: "BarrierClock") -> None:
        self._barrier_clock = clock
        self.gate = threading.Lock()
        self.gate.acquire()
        self.woken = False

    def wake(self) -> None:
        self._barrier_clock._wake(self, woken=True)

    def clear(self) -> None:
        self.woken = False

    def wait(self, until: float, line: int | None = None) -> bool:
        self._barrier_clock._wait(self, until, line is not None)
        woken, self.woken = self.woken, False
        return woken

    def close(self) -> None:
        pass


class BarrierClock(BenchClock):
    """Clock of a process that takes part in a simulated bench.

    The process is at work as long as one of its threads is `busy`, and while it processes what came with a grant of the
    owner: first messages, then timers, then threads whose waits end. Afterwards it reports when it next has something to do.
    If the owner of the time is lost, time goes on by the machine's clock, so that the node's own watchdogs act. A process
    that the owner has left behind, because it was stopped, follows the owner's time from then on.

    Parameters
    ----------
    path : Path
        Socket of the `Barrier`.
    name : str
        Name of the participant.
    """

    def __init__(self, path: str | Path, name: str) -> None:
        self._name = name
        self._time: memoryview[float]
        self._path = Path(path)
        self._socket, self._time = _connect(self._path)
        self._origin = math.floor(self._time[0])
        self._lock = threading.RLock()
        self._thread_state = threading.local()
        self._active = 1  # until it has joined
        self._deaf = self._left = False
        self._grant = 0
        self._channels: dict[str, int] = {LINE: 0}
        self._sent = [0]
        self._changed: set[int] = set()
        self._waiting: dict[_BarrierWaiter, tuple[float, bool]] = {}
        self._timers: list[BenchTimer] = []
        self._received: list[str] = []
        self._inboxes: list[Inbox] = []
        self._seen: list[int] = []  # for each inbox, the number up to which all announced messages have come
        self._newest: list[int] = []  # the largest number that has come
        self._last_look = 0.0
        self._left_behind = False  # whether the owner of the time goes on without this process
        self._alone: float | None = None  # difference of bench time and wall time once the owner of the time is lost
        self._thread = threading.Thread(target=self._serve, name="bench time", daemon=True)
        self._receivers: Mapping[str, Callable[[], Collection[str]]] = {}
        self._senders: Mapping[str, Callable[[], Collection[str]]] = {}
        self.begun = threading.Event()  # whether all expected participants have joined and are connected
        self.error: Exception | None = None  # of a callback
        self.on_loss: Callable[[str], None] = lambda _what: None  # receives what was lost, in one line

    def join(
        self,
        publishers: Mapping[str, Callable[[], Collection[str]]] | None = None,
        subscriptions: Sequence[tuple[str, Inbox, Callable[[], Collection[str]]]] = (),
        *,
        identity: str = "",
        share_core: bool = False,
    ) -> None:
        """Take part from now on.

        Parameters
        ----------
        publishers : mapping
            Channels on which the process sends, each with a callable that returns the identities of those who receive.
        subscriptions : sequence
            Channels on which it receives, each with an inbox and a callable that returns the identities of those who send.
        identity : str
            What tells the process from all others, also from one of its name that has died.
        share_core : bool
            Whether the process moves to the processor core of the other nodes once time begins. They mostly work one after
            the other, and to wake a process on another core takes longer than most of their work.
        """
        self._share_core = share_core
        with self._lock:
            self._receivers = publishers or {}
            self._senders = {channel: senders for channel, _, senders in subscriptions}
            self._received = [channel for channel, _, _ in subscriptions]
            self._inboxes = [inbox for _, inbox, _ in subscriptions]
            self._seen = [0] * len(self._inboxes)
            self._newest = [0] * len(self._inboxes)
            for channel in self._receivers:
                self._index(channel)
            receives = [(channel, inbox.lasting) for channel, inbox, _ in subscriptions]
            hello = {"name": self._name, "identity": identity, "sends": self._channels, "receives": receives}
            self._send(Packet.HELLO + json.dumps(hello).encode())
            self._changed.update(range(len(self._sent)))
            self.release()
        self._thread.start()

    def stop_receiving(self) -> None:
        """Neither handle messages nor call timers back from now on; the threads still wait for bench times."""
        self._deaf = True

    def leave(self) -> None:
        """Take part no more; this may be called twice."""
        self._deaf = self._left = True
        self._send(Packet.LEAVE)
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(1.0)

    # The interface of BenchClock

    def now(self) -> float:
        """Return the bench time in s."""
        if self._alone is not None:
            return self._alone + time.monotonic()
        return float(self._time[0])

    def sleep_until(self, bench_time: float) -> None:
        """Block until ``bench_time``; return at once when it has passed."""
        with self.busy():
            _BarrierWaiter(self).wait(bench_time)

    def next_multiple(self, period: float) -> float:
        """Return the next bench time that is a whole multiple of a period after a full second."""
        now = self.now()
        return self._origin + (math.floor((now - self._origin) / period + 1e-3) + 1) * period

    def sleep_step(self, period: float) -> None:
        """Block until the next multiple of a period, an instant at which others work, too, and have done so on return."""
        self.sleep_until(self.next_multiple(period))
        self.settle()

    def settle(self) -> None:
        """Let all others end their work of the present instant: wait for one of its own, at which nobody else is due."""
        self.sleep_until(self.now() + 3 * INSTANT)

    def waiter(self) -> Waiter:
        """Return a means to wait, for a thread that is `busy` otherwise."""
        return _BarrierWaiter(self)

    def timer(self, period: float, callback: Callable[[], None]) -> BenchTimer:
        """Return a timer that calls back in the thread that receives the messages."""
        timer = BenchTimer(self, period, callback)
        with self._lock:
            self._timers.append(timer)
        return timer

    def busy(self) -> AbstractContextManager[None]:
        """Return a context in which the bench stands still, except while the thread waits for a bench time."""
        return self._busy()

    @contextlib.contextmanager
    def _busy(self) -> Iterator[None]:
        if getattr(self._thread_state, "busy", False):
            yield
            return
        self._thread_state.busy = True
        self.hold()
        try:
            yield
        finally:
            self._thread_state.busy = False
            self.release()

    def hold(self) -> None:
        """Begin work during which the bench stands still; any thread ends it by `release`."""
        with self._lock:
            self._active += 1
            if self._active == 1:
                self._send(Packet.BUSY)

    def release(self) -> None:
        """End work that `hold` began."""
        with self._lock:
            self._active -= 1
            if self._active == 0:
                self._report()

    def sending(self, channel: str, count: int = 1) -> None:
        """Announce messages or bytes that are about to be sent; called before they are."""
        with self._lock:
            index = self._index(channel)
            self._sent[index] += count
            self._changed.add(index)
            if self._active == 0:
                self._report()

    # Internals

    def _index(self, channel: str) -> int:
        index = self._channels.setdefault(channel, len(self._sent))
        if index == len(self._sent):
            self._sent.append(0)
        return index

    def _send(self, packet: bytes) -> None:
        # An error shows in the thread that receives.
        with suppress(OSError):
            self._socket.send(packet)

    def _report(self) -> None:
        due = min((timer.due for timer in self._timers), default=math.inf) if not self._deaf else math.inf
        line = False
        for until, waits_for_line in self._waiting.values():
            due = min(due, until)
            line = line or waits_for_line
        packet = HEAD.pack(Packet.REPORT, self._grant, due, line)
        if self._changed:
            packet += b"".join(ENTRY.pack(index, self._sent[index]) for index in sorted(self._changed))
            self._changed.clear()
        self._send(packet)

    def _wait(self, waiter: _BarrierWaiter, until: float, line: bool) -> None:
        with self._lock:
            if waiter.woken or until <= self.now():
                return
            attended = not self._left_behind
            if attended:
                self._waiting[waiter] = until, line
                self.release()
        if attended:
            waiter.gate.acquire()
        if self._left_behind:  # the waiter's own end has not come perhaps
            while not waiter.woken and not line and self.now() < until:
                time.sleep(1e-3)
                if self._left:
                    self._note_loss_of_owner()

    def _wake(self, waiter: _BarrierWaiter, woken: bool = False) -> None:
        with self._lock:
            waiter.woken = waiter.woken or woken
            if self._waiting.pop(waiter, None) is not None:
                self.hold()
                waiter.gate.release()

    def _serve(self) -> None:
        try:
            self._serve_owner()
        except Exception as error:
            self.error = error
            self.leave()
        # A process ends only once its threads have ended: those that wait then wait by themselves.
        self._release_waiters()
        if not self._left:
            self._go_on_alone()

    def _serve_owner(self) -> None:
        """Do what the owner of the time grants until the connection ends."""
        self._socket.settimeout(_OUTSIDERS_INTERVAL)
        while True:
            try:
                packet = self._socket.recv(PACKET_SIZE)
            except TimeoutError:
                self._look_for_outsiders()
                self._send(Packet.ALIVE)
                continue
            except OSError:
                return
            if not packet:
                return
            if packet[:1] == Packet.GRANT:
                self._work(packet)
            elif packet[:1] == Packet.MATCH:
                self._match(json.loads(packet[1:]))

    def _work(self, packet: bytes) -> None:
        """Process a grant: messages, timers, threads."""
        _, number, now, line = HEAD.unpack_from(packet)
        with self._lock:
            self._grant = number
            self._active += 1
        for position in range(HEAD.size, len(packet), ENTRY.size):
            self._receive(*ENTRY.unpack_from(packet, position))
        self._call_timers(now)
        with self._lock:
            for waiter, (until, waits_for_line) in list(self._waiting.items()):
                if until <= now + INSTANT or (line and waits_for_line):
                    self._wake(waiter)
            self.release()
        if time.monotonic() - self._last_look > _OUTSIDERS_INTERVAL:
            self._look_for_outsiders()

    def _call_timers(self, now: float) -> None:
        for timer in self._timers:
            if timer.due <= now + INSTANT and not self._deaf:
                timer.reset()
                timer.callback()

    def _receive(self, index: int, last: int) -> None:
        """Process the messages of a channel up to a number, and at least the one that was announced."""
        begin, taken = time.monotonic(), False
        while self._seen[index] < last or not taken:
            if self._take(index, last):
                taken = True
                continue
            waited = time.monotonic() - begin
            if self._seen[index] >= last and waited > _STRANGER_WAIT:
                return
            if self._newest[index] >= last and waited > _NEWER_WAIT:
                self._seen[index] = last
                return
            if waited > _LOST_AFTER:
                channel = self._received[index]
                self.on_loss(
                    f"{last - self._seen[index]} announced messages on {channel} did not come within {_LOST_AFTER:g} s"
                )
                self._seen[index] = last
                return
            time.sleep(2e-5)

    def _take(self, index: int, last: float = math.inf) -> bool:
        """Process the next message of a channel; return whether there was one."""
        taken = self._inboxes[index].take()
        if taken is None:
            return False
        message, number = taken
        self._newest[index] = max(self._newest[index], number)
        if number <= last:  # a larger number may be that of another sender
            self._seen[index] = max(self._seen[index], number)
        if not self._deaf:
            self._inboxes[index].handle(message)
        return True

    def _look_for_outsiders(self) -> None:
        """Process messages of others than participants, which nobody announces."""
        self._last_look = time.monotonic()
        for index in range(len(self._inboxes)):
            while self._take(index):
                pass

    def _match(self, others: dict[str, Any]) -> None:
        """Wait until ROS has connected this process with the other participants."""
        deadline = time.monotonic() + _MATCHING_TIMEOUT

        def matched() -> bool:
            connected = ((self._receivers, others["receivers"]), (self._senders, others["senders"]))
            return all(
                set(identities) <= set(found[channel]())
                for found, wanted in connected
                for channel, identities in wanted.items()
            )

        while not matched():
            if time.monotonic() > deadline:
                self.on_loss(f"ROS did not connect all participants within {_MATCHING_TIMEOUT:g} s; messages may be lost")
                break
            time.sleep(0.01)
        if self._share_core:
            for thread in os.listdir("/proc/self/task"):
                with suppress(OSError):
                    os.sched_setaffinity(int(thread), {others["core"]})
        self._seen = [0] * len(self._seen)  # another sender counts from the beginning
        self._newest = [0] * len(self._seen)
        self._look_for_outsiders()
        self.begun.set()
        self._send(Packet.MATCHED)

    def _go_on_alone(self) -> None:
        """Go on without the owner's grants: by its time as long as it lives, then by the machine's clock."""
        time.sleep(_END_OF_OWNER)
        if _has_owner(self._path):
            self.on_loss("the bench has gone on without this process, which stood still")
        while not self._left:
            self._note_loss_of_owner()
            try:
                self._look_for_outsiders()
                self._call_timers(self.now())
            except Exception as error:
                self.error = error
                self.leave()
            time.sleep(5e-3)

    def _release_waiters(self) -> None:
        with self._lock:
            self._left_behind = True
            for waiter in list(self._waiting):
                self._wake(waiter)

    def _note_loss_of_owner(self) -> None:
        """Let time go on by the machine's clock if nobody owns it any more."""
        if self._alone is None and not _has_owner(self._path):
            self._alone = self._time[0] - time.monotonic()
            if not self._left:
                self.on_loss("the owner of the bench time is lost; bench time follows the machine's clock")


def _has_owner(path: Path) -> bool:
    """Whether a process owns the time with this socket: it holds a lock on the file of the time."""
    try:
        with time_file(path).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _connect(path: Path) -> tuple[socket.socket, "memoryview[float]"]:
    """Connect with the owner of the time; return the socket and the mapped time."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    deadline = time.monotonic() + _START_TIMEOUT
    while True:
        try:
            folder, address = socket_address(path)
            try:
                connection.connect(address)
            finally:
                os.close(folder)
            with time_file(path).open("rb") as file:
                return connection, memoryview(mmap.mmap(file.fileno(), 8, prot=mmap.PROT_READ)).cast("d")
        except (FileNotFoundError, ConnectionRefusedError):
            if time.monotonic() > deadline:
                raise InputError(f"clock: nobody owns the bench time at {path}; start the node plant with it") from None
            time.sleep(0.02)
