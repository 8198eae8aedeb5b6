"""The owner of the time of a simulated bench: time stands still until every participant has done its work.

Owner and participants (`mrd_base.barrier_clock`) exchange packets over a local socket, and the time itself stands in a file
that all processes map. `docs/simulated_bench.md` describes the order of events.
"""

import fcntl
import json
import math
import mmap
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mrd_base.barrier_clock import ENTRY, HEAD, INSTANT, LINE, PACKET_SIZE, Packet, socket_address, time_file
from mrd_base.errors import InputError

# Wall time in s after which a participant that does not finish its work is left behind. The supervisor may wait for the
# recorder to close a bag, or for the generator to plan a set.
_STALL = 120.0
# The same for a process that was stopped by a signal.
_STOPPED_STALL = 1.0
# The same for one whose thread that processes messages and timers does not say that it lives: it hangs in one of them.
_HANGING_STALL = 20.0
# Wall time in s by which a paced bench may be late and catch up.
_CATCH_UP = 0.1


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
    descriptor: int
    process: int
    name: str = ""
    identity: str = ""
    sends: dict[int, str] = field(default_factory=dict)
    receives: list[tuple[str, bool]] = field(default_factory=list)  # channels, and whether messages last there
    counts: dict[int, int] = field(default_factory=dict)
    pending: dict[int, int] = field(default_factory=dict)
    granted: int = 0
    done: int = 0
    busy: bool = True
    connected: bool = False  # whether it has been told to let ROS connect it
    matching: bool = False
    due: float = math.inf
    line: bool = False
    since: float = 0.0  # wall time at which it began its work
    heard: float = field(default_factory=time.monotonic)  # wall time of its latest packet

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
        self._participants: dict[int, _Participant] = {}  # by the descriptors of their connections
        self._receivers: dict[str, list[tuple[_Participant, int]]] = {}
        self._unsettled: set[int] = set()  # descriptors of those at work
        self._addressed: dict[int, _Participant] = {}  # those to whom messages were sent
        cores = sorted(os.sched_getaffinity(0))
        self._core = cores[os.getpid() % len(cores)]  # another bench may take another one
        self._newcomers = False
        self._line_count = 0
        self._origin = (start, time.monotonic())
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._time_file = time_file(path).open("ab+", buffering=0)
        try:
            fcntl.flock(self._time_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise InputError(f"clock {path}: another simulated bench uses it; stop that one or choose another") from None
        self._time_file.truncate(8)
        self._time: memoryview[float] = memoryview(mmap.mmap(self._time_file.fileno(), 8)).cast("d")
        self._time[0] = start
        path.unlink(missing_ok=True)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        folder, address = socket_address(path)
        self._listener.bind(address)
        os.close(folder)
        self._listener.listen()
        self._listener.setblocking(False)
        self._selector = select.epoll()
        self._selector.register(self._listener.fileno(), select.EPOLLIN)

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
        """Release the participants, for whom time goes on by the machine's clock."""
        # The file of the time is the first to go: by its lock, participants tell that the owner has ended.
        time_file(self._path).unlink(missing_ok=True)
        self._time_file.close()
        for connection in [*(participant.connection for participant in self._participants.values()), self._listener]:
            connection.close()
        self._selector.close()
        self._path.unlink(missing_ok=True)

    # Packets

    def _poll(self, timeout: float) -> None:
        """Process the packets that came, and wait for one at most ``timeout`` wall seconds."""
        events = self._selector.poll(timeout)
        while events:
            for descriptor, _ in events:
                if descriptor == self._listener.fileno():
                    self._accept()
                elif descriptor in self._participants:
                    self._read(self._participants[descriptor])
            # Once all seem to have done their work, another look is needed: a report that was read may have been sent
            # because of a packet that came just after its sender was looked at.
            events = [] if self._unsettled else self._selector.poll(0)

    def _accept(self) -> None:
        connection, _ = self._listener.accept()
        connection.setblocking(False)
        credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
        self._participants[connection.fileno()] = _Participant(
            connection, connection.fileno(), struct.unpack("3i", credentials)[0]
        )
        self._selector.register(connection.fileno(), select.EPOLLIN)

    def _read(self, participant: _Participant) -> None:
        try:
            packet = participant.connection.recv(PACKET_SIZE)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        kind = packet[:1]
        participant.heard = time.monotonic()
        if kind == Packet.ALIVE:
            return
        if kind == Packet.REPORT:
            self._on_report(participant, packet)
        elif kind == Packet.BUSY:
            participant.busy = True
        elif kind == Packet.MATCHED:
            participant.matching = False
        elif kind == Packet.HELLO:
            self._on_hello(participant, json.loads(packet[1:]))
        else:
            self._remove(participant, "" if kind == Packet.LEAVE else "has died")
            return
        self._note(participant)

    def _note(self, participant: _Participant) -> None:
        """Note whether a participant is at work."""
        if participant.settled:
            self._unsettled.discard(participant.descriptor)
        elif participant.descriptor not in self._unsettled:
            self._unsettled.add(participant.descriptor)
            participant.since = time.monotonic()

    def _on_hello(self, participant: _Participant, hello: dict[str, Any]) -> None:
        participant.name, participant.identity = hello["name"], hello["identity"]
        participant.sends = {index: channel for channel, index in hello["sends"].items()}
        participant.receives = hello["receives"]
        for index, (channel, _) in enumerate(participant.receives):
            self._receivers.setdefault(channel, []).append((participant, index))
        self._missing.discard(participant.name)
        self._newcomers = True

    def _on_report(self, participant: _Participant, packet: bytes) -> None:
        _, participant.done, participant.due, participant.line = HEAD.unpack_from(packet)
        participant.busy = False
        for position in range(HEAD.size, len(packet), ENTRY.size):
            index, count = ENTRY.unpack_from(packet, position)
            # What was sent before it joined is not waited for: those who receive it may not have been there.
            sent = count - participant.counts.get(index, 0 if index == 0 else count)
            participant.counts[index] = count
            if index == 0:
                self._line_count += sent
            elif sent:
                for receiver, inbox in self._receivers.get(participant.sends.get(index, ""), ()):
                    receiver.pending[inbox] = count
                    self._addressed[receiver.descriptor] = receiver

    def _remove(self, participant: _Participant, reason: str) -> None:
        self._selector.unregister(participant.descriptor)
        participant.connection.close()
        del self._participants[participant.descriptor]
        self._unsettled.discard(participant.descriptor)
        self._addressed.pop(participant.descriptor, None)
        for receivers in self._receivers.values():
            receivers[:] = [entry for entry in receivers if entry[0] is not participant]
        if participant.name and reason:
            self._report(f"{participant.name} {reason}; the bench goes on without it")

    def _leave_stalled_behind(self) -> None:
        for descriptor in list(self._unsettled):
            participant = self._participants[descriptor]
            waited = time.monotonic() - participant.since
            if waited > _STOPPED_STALL and _is_stopped(participant.process):
                self._remove(participant, "was stopped by a signal")
            elif participant.name and min(waited, time.monotonic() - participant.heard) > _HANGING_STALL:
                self._remove(participant, f"hangs: its messages and timers have not ended for {_HANGING_STALL:g} s")
            elif waited > _STALL:
                self._remove(participant, f"has not finished its work for {waited:.0f} s")

    # Time

    def _grant(self, participant: _Participant, line: bool = False) -> None:
        """Let a participant do what is due now, and receive what was sent to it."""
        participant.granted += 1
        packet = HEAD.pack(Packet.GRANT, participant.granted, self._time[0], line)
        for entry in sorted(participant.pending.items()):
            packet += ENTRY.pack(*entry)
        participant.pending.clear()
        self._addressed.pop(participant.descriptor, None)
        self._send(participant, packet)

    def _send(self, participant: _Participant, packet: bytes) -> None:
        # An error shows when the connection is read.
        with suppress(OSError):
            participant.connection.send(packet)
        self._note(participant)

    def _deliver(self) -> bool:
        """Let participants receive what was sent to them; return whether there was anything."""
        receivers = [participant for participant in self._addressed.values() if participant.connected]
        for participant in receivers:
            self._grant(participant)
        return bool(receivers)

    def _match_newcomers(self) -> bool:
        """Let ROS connect the participants with each other after one has joined; return whether one has."""
        if not self._newcomers:
            return False
        self._newcomers = False
        participants = self._joined
        senders: dict[str, list[str]] = {}
        for participant in participants:
            for channel in participant.sends.values():
                senders.setdefault(channel, []).append(participant.identity)
        for participant in participants:
            others = {
                "receivers": {
                    channel: [receiver.identity for receiver, _ in self._receivers.get(channel, ())]
                    for channel in participant.sends.values()
                    if channel != LINE
                },
                "senders": {channel: senders.get(channel, []) for channel, _ in participant.receives},
                "core": self._core,
            }
            if not participant.connected:
                # What was sent since it joined came before ROS had connected it, and comes late or never.
                participant.pending = {
                    inbox: count for inbox, count in participant.pending.items() if participant.receives[inbox][1]
                }
                participant.connected = True
            participant.matching = True
            self._send(participant, Packet.MATCH + json.dumps(others).encode())
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
                if participant.due <= instant + INSTANT or (sent and participant.line):
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
