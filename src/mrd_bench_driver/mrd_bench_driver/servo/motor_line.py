"""The serial line to the motor. A query brings its own whole replies or an error, never part of a reply or a late one.

One thread owns the line. Other threads may only wake its `Waiter`, which ends any wait of the owner at once.
"""

import math
import select
import termios
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import serial

from mrd_base.barrier_clock import LINE
from mrd_base.clock import BenchClock, Waiter
from mrd_bench_driver.servo.smartmotor import ReplyError

# Shortest timeout in s: under load, the operating system takes this long to deliver a byte.
MIN_TIMEOUT = 0.02
# Bytes read at once, and the length beyond which data without a carriage return is no reply.
_BUFFER_SIZE = 256
# Exceptions of pyserial once the port is gone. termios.error is no OSError; a port closed during a read is a TypeError.
_PORT_ERRORS = (serial.SerialException, OSError, termios.error, TypeError)


class LineLostError(Exception):
    """The port is lost, or not open yet."""


class WaitInterrupted(Exception):  # noqa: N818 (no error: somebody asked for it)
    """The owner of the line was woken while it waited for a reply, which is lost."""


class MotorLine:
    """A serial port on which each reply ends with a carriage return.

    Parameters
    ----------
    port : str
        Device. ``/dev/serial/by-id/...`` survives replugging.
    clock : BenchClock
        Clock of the timeouts, which are in bench seconds.
    waiter : Waiter
        Waits for replies; another thread may wake it to end a wait.

    Raises
    ------
    LineLostError
        By every method, once the port fails.
    """

    def __init__(self, port: str, baud_rate: int, clock: BenchClock, waiter: Waiter) -> None:
        self.port, self.clock, self._waiter = port, clock, waiter
        self._buffer = bytearray()
        self._stale = True  # whether bytes of earlier queries may still arrive
        with self._guarded("cannot be opened"):
            # Reads do not block: select waits instead, because a wake-up can end it.
            self._serial: Any = serial.Serial(port, baud_rate, timeout=0, write_timeout=0.2, exclusive=True)
        with suppress(*_PORT_ERRORS, ValueError, AttributeError, NotImplementedError):
            # The latency timer of a USB adapter, 16 ms, would dominate every exchange. A pseudo-terminal has none.
            self._serial.set_low_latency_mode(True)

    @property
    def baud_rate(self) -> int:
        """Baud rate in bit/s of this end of the line."""
        return int(self._serial.baudrate)

    @baud_rate.setter
    def baud_rate(self, value: int) -> None:
        with self._guarded(f"refuses {value} baud"):
            self._serial.baudrate = value
        self._stale = True

    def duration(self, count: int) -> float:
        """Return the time in bench s that ``count`` bytes take, each with start bit, 8 data bits and stop bit."""
        return 10 * count / self.baud_rate

    def write(self, data: bytes) -> None:
        """Send commands, which the motor does not answer."""
        self.clock.sending(LINE, len(data))
        with self._guarded("does not take data"):
            self._serial.write(data)

    def exchange(self, request: bytes, count: int, timeout: float, latest: float = math.inf) -> list[tuple[bytes, float]]:
        """Send a request and wait for its ``count`` replies.

        Parameters
        ----------
        request : bytes
            Commands and queries, ended by a delimiter.
        count : int
            Number of replies expected.
        timeout : float
            Longest wait in bench s for all replies, after the time that the bytes of the request take.
        latest : float
            Bench time in s at which any wait ends, because the owner of the line has something else to do.

        Returns
        -------
        list of (reply, time)
            Replies without their carriage returns, with the bench times at which they ended.

        Raises
        ------
        ReplyError
            If a reply is missing or surplus, or the line does not become quiet. Bytes that still arrive are discarded before
            the next request, so that no late reply is taken for another.
        WaitInterrupted
            If a wake-up came.
        """
        if self._stale:
            self.drain(latest=latest)
        if self._stale or self._ready(self.clock.now()):
            self.drain(latest=latest)
            raise ReplyError("bytes came without a query: a late reply, or noise")
        self.write(request)
        self._stale = True
        deadline = min(latest, self.clock.now() + max(MIN_TIMEOUT, timeout + self.duration(len(request))))
        replies = [(self._line(deadline), self.clock.now()) for _ in range(count)]
        if self._buffer:
            raise ReplyError(f"{bytes(self._buffer)!r} came after the last expected reply")
        self._stale = False
        return replies

    def drain(self, limit: float = 0.04, latest: float = math.inf) -> None:
        """Discard what arrives until the line has been quiet, for at most ``limit`` bench seconds, and until ``latest``.

        A line that is not quiet by then is drained further before the next request.
        """
        quiet = max(0.002, self.duration(5))
        deadline = min(latest, self.clock.now() + max(MIN_TIMEOUT, limit))
        self._stale = True
        while self._stale and self.clock.now() < deadline:
            self._stale = self._ready(self.clock.now() + quiet)
            if self._stale:
                self._receive()
        self._buffer.clear()

    def close(self) -> None:
        """Close the port. This may be called at any time."""
        with suppress(*_PORT_ERRORS):
            self._serial.close()

    def _line(self, deadline: float) -> bytes:
        while (end := self._buffer.find(b"\r")) < 0:
            if len(self._buffer) > _BUFFER_SIZE:
                raise ReplyError(f"{len(self._buffer)} bytes came without an end of a reply")
            if not self._ready(deadline):
                raise ReplyError("no reply in time" if not self._buffer else f"incomplete reply: {bytes(self._buffer)!r}")
            self._receive()
        line = bytes(self._buffer[:end]).strip(b"\n")
        del self._buffer[: end + 1]
        return line

    def _ready(self, until: float) -> bool:
        """Wait for bytes until a bench time; return whether there are any."""
        with self._guarded("is gone"):
            line = self._serial.fileno()
            interrupted = self._waiter.wait(until, line)
            ready = bool(select.select([line], [], [], 0.0)[0])
        if interrupted:
            self._stale = True
            raise WaitInterrupted("the wait for a reply was interrupted")
        return ready

    def _receive(self) -> None:
        with self._guarded("is gone"):
            self._buffer += self._serial.read(_BUFFER_SIZE)

    @contextmanager
    def _guarded(self, what: str) -> Iterator[None]:
        try:
            yield
        except _PORT_ERRORS as error:
            raise LineLostError(f"{self.port} {what} ({error})") from error
