"""Bench time of a simulated bench: it stands still until every participant has done its work (docs/simulated_bench.md).

The `Barrier` owns the time; a `BarrierClock` is the clock of one participating process. They exchange packets over a local
socket, and the time itself stands in a file that all processes map.
"""

import contextlib
import fcntl
import json
import math
import mmap
import os
import selectors
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mrd_base.clock import BenchClock, Waiter
from mrd_base.errors import InputError

# The channel of the bytes that go to the motor over its serial line.
LINE = "motor line"

# Wall time in s for the owner of the time to come up.
_START_TIMEOUT = 60.0
# Wall time in s after which a participant that does not finish its work is left behind.
STALL = 30.0
# The same for a process that was stopped by a signal.
_STOPPED_STALL = 1.0
# Wall time in s after which an announced message counts as lost.
_LOST_AFTER = 10.0
# Wall time in s for ROS to match publishers and subscriptions of a new participant.
_MATCHING_TIMEOUT = 5.0
# Wall time in s between two looks for messages of others than participants.
_OUTSIDERS_INTERVAL = 0.05
# Bench times in s that differ by less are one instant: a double holds the time since 1970 to 0.2 us only.
_INSTANT = 1e-5
# Wall time in s by which a paced bench may be late and catch up.
_CATCH_UP = 0.1

# Packets begin with their kind. A participant sends hello, busy, report, matched and leave; the owner sends match and grant.
_HELLO, _BUSY, _REPORT, _MATCH, _MATCHED, _GRANT, _LEAVE = b"H", b"B", b"R", b"M", b"m", b"G", b"L"
# Number of the latest grant; the time at which the participant next has something to do, or that of the grant; whether it
# waits for bytes on the serial line, or some came.
_HEAD = struct.Struct("=cId?")
# Index of a channel and number of its latest message.
_ENTRY = struct.Struct("=Hq")
_PACKET_SIZE = 1 << 16


def _address(path: Path) -> tuple[int, str]:
    """Return a descriptor to close and a short name for a socket in a folder whose path may be too long for a socket."""
    folder = os.open(path.parent, os.O_DIRECTORY)
    return folder, f"/proc/self/fd/{folder}/{path.name}"


def _time_file(path: Path) -> Path:
    return path.with_name(path.name + ".time")


class Inbox(Protocol):
    """The messages that arrive on one channel."""

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
    If the owner of the time is lost, time goes on as on the wall, so that the node's own watchdogs act.

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
        self._socket, self._time = _connect(Path(path))
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
        self._inboxes: list[Inbox] = []
        self._seen: list[int] = []
        self._last_look = 0.0
        self._alone: float | None = None  # difference of bench time and wall time once the owner of the time is lost
        self._thread = threading.Thread(target=self._serve, name="bench time", daemon=True)
        self._count_of_subscribers: Mapping[str, Callable[[], int]] = {}
        self._count_of_publishers: Mapping[str, Callable[[], int]] = {}
        self.begun = threading.Event()  # whether all expected participants have joined and are connected
        self.error: Exception | None = None  # of a callback
        self.lost = 0
        self.on_lost: Callable[[str], None] = lambda _reason: None

    def join(
        self,
        publishers: Mapping[str, Callable[[], int]] | None = None,
        subscriptions: Mapping[str, tuple[Inbox, Callable[[], int]]] | None = None,
        *,
        share_core: bool = False,
    ) -> None:
        """Take part from now on.

        Parameters
        ----------
        publishers : mapping
            Channels on which the process sends, each with a callable that counts those who receive.
        subscriptions : mapping
            Channels on which it receives, each with its inbox and a callable that counts those who send.
        share_core : bool
            Whether the process moves to the processor core of the other nodes once time begins. They mostly work one after
            the other, and to wake a process on another core takes longer than most of their work.
        """
        self._share_core = share_core
        subscriptions = subscriptions or {}
        with self._lock:
            self._count_of_subscribers = publishers or {}
            self._count_of_publishers = {channel: count for channel, (_, count) in subscriptions.items()}
            self._inboxes = [inbox for inbox, _ in subscriptions.values()]
            self._seen = [0] * len(self._inboxes)
            for channel in self._count_of_subscribers:
                self._index(channel)
            hello = {"name": self._name, "sends": self._channels, "receives": list(subscriptions)}
            self._send(_HELLO + json.dumps(hello).encode())
            self._changed.update(range(len(self._sent)))
            self.release()
        self._thread.start()

    def stop_receiving(self) -> None:
        """Neither handle messages nor call timers back from now on; the threads still wait for bench times."""
        self._deaf = True

    def leave(self) -> None:
        """Take part no more; this may be called twice."""
        self._deaf = self._left = True
        self._send(_LEAVE)
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
        """Block until the next multiple of a period, an instant at which others work, too."""
        self.sleep_until(self.next_multiple(period))

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
                self._send(_BUSY)

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
        packet = _HEAD.pack(_REPORT, self._grant, due, line)
        if self._changed:
            packet += b"".join(_ENTRY.pack(index, self._sent[index]) for index in sorted(self._changed))
            self._changed.clear()
        self._send(packet)

    def _wait(self, waiter: _BarrierWaiter, until: float, line: bool) -> None:
        with self._lock:
            if waiter.woken or until <= self.now():
                return
            if self._alone is None:
                self._waiting[waiter] = until, line
                self.release()
        if self._alone is None:
            waiter.gate.acquire()
        if self._alone is not None:  # the waiter's own end has not come perhaps
            while not waiter.woken and not line and self.now() < until:
                time.sleep(1e-3)

    def _wake(self, waiter: _BarrierWaiter, woken: bool = False) -> None:
        with self._lock:
            waiter.woken = waiter.woken or woken
            if self._waiting.pop(waiter, None) is not None:
                self.hold()
                waiter.gate.release()

    def _serve(self) -> None:
        try:
            self._serve_owner()
            if not self._left:
                self._go_on_alone()
        except Exception as error:
            self.error = error
            self.leave()

    def _serve_owner(self) -> None:
        """Do what the owner of the time grants until the connection ends."""
        self._socket.settimeout(_OUTSIDERS_INTERVAL)
        while True:
            try:
                packet = self._socket.recv(_PACKET_SIZE)
            except TimeoutError:
                self._look_for_outsiders()
                continue
            except OSError:
                return
            if not packet:
                return
            if packet[:1] == _GRANT:
                self._work(packet)
            elif packet[:1] == _MATCH:
                self._match(json.loads(packet[1:]))

    def _work(self, packet: bytes) -> None:
        """Process a grant: messages, timers, threads."""
        _, number, now, line = _HEAD.unpack_from(packet)
        with self._lock:
            self._grant = number
            self._active += 1
        for position in range(_HEAD.size, len(packet), _ENTRY.size):
            self._receive(*_ENTRY.unpack_from(packet, position))
        self._call_timers(now)
        with self._lock:
            for waiter, (until, waits_for_line) in list(self._waiting.items()):
                if until <= now + _INSTANT or (line and waits_for_line):
                    self._wake(waiter)
            self.release()
        if time.monotonic() - self._last_look > _OUTSIDERS_INTERVAL:
            self._look_for_outsiders()

    def _call_timers(self, now: float) -> None:
        for timer in self._timers:
            if timer.due <= now + _INSTANT and not self._deaf:
                timer.reset()
                timer.callback()

    def _receive(self, index: int, last: int) -> None:
        """Process the messages of a channel up to a number."""
        begin = time.monotonic()
        while self._seen[index] < last:
            if self._take(index, last):
                continue
            if time.monotonic() - begin > _LOST_AFTER:
                self.lost += last - self._seen[index]
                self._seen[index] = last
                return
            time.sleep(2e-5)

    def _take(self, index: int, last: float = math.inf) -> bool:
        """Process the next message of a channel; return whether there was one."""
        taken = self._inboxes[index].take()
        if taken is None:
            return False
        message, number = taken
        if number <= last:  # a larger number is that of another sender
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
            subscribed = (self._count_of_subscribers[name]() >= count for name, count in others["receivers"].items())
            return all(subscribed) and all(self._count_of_publishers[name]() > 0 for name in others["senders"])

        while not matched() and time.monotonic() < deadline:
            time.sleep(0.01)
        if self._share_core:
            for thread in os.listdir("/proc/self/task"):
                with suppress(OSError):
                    os.sched_setaffinity(int(thread), {others["core"]})
        self._look_for_outsiders()
        self._seen = [0] * len(self._seen)  # another sender counts from the beginning
        self.begun.set()
        self._send(_MATCHED)

    def _go_on_alone(self) -> None:
        """Let time pass as on the wall after the owner of the time was lost."""
        with self._lock:
            self._alone = self._time[0] - time.monotonic()
            for waiter in list(self._waiting):
                self._wake(waiter)
        self.on_lost("the owner of the bench time is lost; time goes on as on the wall")
        while not self._left:
            self._look_for_outsiders()
            self._call_timers(self.now())
            time.sleep(5e-3)


def _connect(path: Path) -> tuple[socket.socket, "memoryview[float]"]:
    """Connect with the owner of the time; return the socket and the mapped time."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    deadline = time.monotonic() + _START_TIMEOUT
    while True:
        try:
            folder, address = _address(path)
            try:
                connection.connect(address)
            finally:
                os.close(folder)
            with _time_file(path).open("rb") as file:
                return connection, memoryview(mmap.mmap(file.fileno(), 8, prot=mmap.PROT_READ)).cast("d")
        except (FileNotFoundError, ConnectionRefusedError):
            if time.monotonic() > deadline:
                raise InputError(f"clock: nobody owns the bench time at {path}; start the node plant with it") from None
            time.sleep(0.02)


class SimulatedPlant(Protocol):
    """What the owner of the time simulates between two instants."""

    def next_event(self) -> float:
        """Return the bench time at which it next has something to do."""

    def read_line(self, count: int, now: float) -> None:
        """Wait until ``count`` bytes in all have come over the serial line; they were sent at the present bench time."""

    def advance_line(self, now: float, awaited: bool) -> bool:
        """Exchange bytes over the serial line; return whether some were sent to the host.

        If the host has ``awaited`` them, they have arrived there.
        """

    def advance(self, now: float) -> bool:
        """Simulate up to a bench time; return whether something was published."""


@dataclass
class _Participant:
    """A participant, as its owner knows it."""

    connection: socket.socket
    process: int
    name: str = ""
    sends: dict[int, str] = field(default_factory=dict)
    receives: list[str] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    pending: dict[int, int] = field(default_factory=dict)
    granted: int = 0
    done: int = 0
    busy: bool = True
    matching: bool = False
    due: float = math.inf
    line: bool = False
    since: float = 0.0  # wall time at which it began its work

    @property
    def settled(self) -> bool:
        return self.done == self.granted and not self.busy and not self.matching


class Barrier:
    """Owner of the bench time.

    Time goes on to the earliest instant at which a participant or the plant has something to do, once all participants have
    done their work and have received what was sent to them.

    Parameters
    ----------
    path : Path
        Socket to make.
    expected : sequence of str
        Participants that time waits for at the start.
    start : float
        Bench time in s at the start.
    pace : float
        Largest number of bench seconds in a wall second; inf for as many as the machine computes.
    report : callable
        Receives one line on each participant that was lost.
    """

    def __init__(
        self, path: Path, expected: Sequence[str], start: float, pace: float, report: Callable[[str], None]
    ) -> None:
        self._path, self._report, self._pace = path, report, pace
        self._missing = set(expected)
        self._participants: dict[socket.socket, _Participant] = {}
        self._receivers: dict[str, list[tuple[_Participant, int]]] = {}
        self._unsettled: set[socket.socket] = set()
        cores = sorted(os.sched_getaffinity(0))
        self._core = cores[os.getpid() % len(cores)]  # another bench may take another one
        self._newcomers = False
        self._line_count = 0
        self._origin = (start, time.monotonic())
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._time_file = _time_file(path).open("ab+", buffering=0)
        try:
            fcntl.flock(self._time_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"clock {path}: another simulated bench uses it; stop that one or choose another") from None
        self._time_file.truncate(8)
        self._time: memoryview[float] = memoryview(mmap.mmap(self._time_file.fileno(), 8)).cast("d")
        self._time[0] = start
        path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        folder, address = _address(path)
        self._listener.bind(address)
        os.close(folder)
        self._listener.listen()
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def _joined(self) -> list[_Participant]:
        return [participant for participant in self._participants.values() if participant.name]

    @property
    def now(self) -> float:
        """Bench time in s."""
        return float(self._time[0])

    def run(self, plant: SimulatedPlant, closing: threading.Event) -> None:
        """Let the time pass until ``closing`` is set."""
        timeout = 0.1
        while not closing.is_set():
            self._poll(timeout)
            timeout = 0.1
            if self._unsettled:
                self._leave_stalled_behind()
            elif self._deliver() or self._missing or self._match_newcomers():
                continue
            else:
                plant.read_line(self._line_count, self._time[0])
                timeout = self._advance(plant)

    def close(self) -> None:
        """Release the participants, for whom time goes on as on the wall."""
        for connection in [*self._participants, self._listener]:
            connection.close()
        self._selector.close()
        for file in (self._path, _time_file(self._path)):
            file.unlink(missing_ok=True)
        self._time_file.close()

    # Packets

    def _poll(self, timeout: float) -> None:
        """Process the packets that came, and wait for one at most ``timeout`` wall seconds."""
        events = self._selector.select(timeout)
        # One look is not enough: a packet that is read may have been sent because of one that came just after its look.
        while events:
            for key, _ in events:
                if key.fileobj is self._listener:
                    self._accept()
                else:
                    self._read(self._participants[key.fileobj])  # type: ignore[index]
            events = self._selector.select(0)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setblocking(False)
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        self._participants[connection] = _Participant(connection, struct.unpack("3i", credentials)[0])
        self._selector.register(connection, selectors.EVENT_READ)

    def _read(self, participant: _Participant) -> None:
        try:
            packet = participant.connection.recv(_PACKET_SIZE)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        kind = packet[:1]
        if kind == _REPORT:
            self._on_report(participant, packet)
        elif kind == _BUSY:
            participant.busy = True
        elif kind == _MATCHED:
            participant.matching = False
        elif kind == _HELLO:
            self._on_hello(participant, json.loads(packet[1:]))
        else:
            self._remove(participant, "" if kind == _LEAVE else "has died")
            return
        self._note(participant)

    def _note(self, participant: _Participant) -> None:
        """Note whether a participant is at work."""
        if participant.settled:
            self._unsettled.discard(participant.connection)
        elif participant.connection not in self._unsettled:
            self._unsettled.add(participant.connection)
            participant.since = time.monotonic()

    def _on_hello(self, participant: _Participant, hello: dict[str, Any]) -> None:
        participant.name = hello["name"]
        participant.sends = {index: channel for channel, index in hello["sends"].items()}
        participant.receives = hello["receives"]
        for index, channel in enumerate(participant.receives):
            self._receivers.setdefault(channel, []).append((participant, index))
        self._missing.discard(participant.name)
        self._newcomers = True

    def _on_report(self, participant: _Participant, packet: bytes) -> None:
        _, participant.done, participant.due, participant.line = _HEAD.unpack_from(packet)
        participant.busy = False
        for position in range(_HEAD.size, len(packet), _ENTRY.size):
            index, count = _ENTRY.unpack_from(packet, position)
            # What was sent before it joined is not waited for: those who receive it may not have been there.
            sent = count - participant.counts.get(index, 0 if index == 0 else count)
            participant.counts[index] = count
            if index == 0:
                self._line_count += sent
            elif sent:
                for receiver, inbox in self._receivers.get(participant.sends[index], ()):
                    receiver.pending[inbox] = count

    def _remove(self, participant: _Participant, reason: str) -> None:
        self._selector.unregister(participant.connection)
        participant.connection.close()
        del self._participants[participant.connection]
        self._unsettled.discard(participant.connection)
        for receivers in self._receivers.values():
            receivers[:] = [entry for entry in receivers if entry[0] is not participant]
        if participant.name and reason:
            self._report(f"{participant.name} {reason}; the bench goes on without it")

    def _leave_stalled_behind(self) -> None:
        for connection in list(self._unsettled):
            participant = self._participants[connection]
            waited = time.monotonic() - participant.since
            if waited > _STOPPED_STALL and _is_stopped(participant.process):
                self._remove(participant, "was stopped by a signal")
            elif waited > STALL:
                self._remove(participant, f"has not finished its work for {waited:.0f} s")

    # Time

    def _grant(self, participant: _Participant, line: bool = False) -> None:
        """Let a participant do what is due now, and receive what was sent to it."""
        participant.granted += 1
        packet = _HEAD.pack(_GRANT, participant.granted, self._time[0], line)
        for entry in sorted(participant.pending.items()):
            packet += _ENTRY.pack(*entry)
        participant.pending.clear()
        self._send(participant, packet)

    def _send(self, participant: _Participant, packet: bytes) -> None:
        # An error shows when the connection is read.
        with suppress(OSError):
            participant.connection.send(packet)
        self._note(participant)

    def _deliver(self) -> bool:
        """Let participants receive what was sent to them; return whether there was anything."""
        receivers = [participant for participant in self._participants.values() if participant.pending]
        for participant in receivers:
            self._grant(participant)
        return bool(receivers)

    def _match_newcomers(self) -> bool:
        """Let ROS connect the participants with each other after one has joined; return whether one has."""
        if not self._newcomers:
            return False
        self._newcomers = False
        participants = self._joined
        sent = {channel for participant in participants for channel in participant.sends.values()}
        for participant in participants:
            receivers = {channel: len(self._receivers.get(channel, ())) for channel in participant.sends.values()}
            del receivers[LINE]
            senders = [channel for channel in participant.receives if channel in sent]
            participant.matching = True
            self._send(
                participant, _MATCH + json.dumps({"receivers": receivers, "senders": senders, "core": self._core}).encode()
            )
        self._origin = (self.now, time.monotonic())
        return True

    def _advance(self, plant: SimulatedPlant) -> float:
        """Go on until a participant has something to do; return how long to wait for packets, in wall s."""
        participants = self._joined
        awaited = any(participant.line for participant in participants)
        due = min((participant.due for participant in participants), default=math.inf)
        while True:
            instant = max(self._time[0], min(due, plant.next_event()))
            early = (instant - self._origin[0]) / self._pace - (time.monotonic() - self._origin[1])
            if early > 0:
                return min(early, 0.1)
            if early < -_CATCH_UP:
                self._origin = (instant, time.monotonic())
            self._time[0] = instant
            sent = plant.advance_line(instant, awaited)
            for participant in participants:
                if participant.due <= instant + _INSTANT or (sent and participant.line):
                    self._grant(participant, sent)
            published = plant.advance(instant)
            if self._unsettled:
                return 0.1
            if sent or published:
                return 0.0


def _is_stopped(process: int) -> bool:
    """Whether a process was stopped by a signal."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state in "Tt"
