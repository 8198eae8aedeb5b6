"""The serial line to the motor: whole replies or an error, never half a one and never the neighbour's.

One thread owns the line. Another may only wake it (`Wake`), which breaks off whatever the owner waits for.
"""

import os
import select
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import serial

from mrd_base import BenchClock
from mrd_bench_driver.smartmotor import ReplyError

# Whatever the bench time, the operating system needs this long (wall s) to hand over a byte under load.
MIN_TIMEOUT = 0.02
_BUFFER = 256
# What pyserial raises once the port is gone; termios.error is no OSError, a port closed under a read is a TypeError.
_GONE = (serial.SerialException, OSError, termios.error, TypeError)


class LineLost(Exception):  # noqa: N818 (reads as what happened)
    """The port cannot be used any more, or not yet."""


class Interrupted(Exception):  # noqa: N818
    """The owner was woken while it waited; the reply is given up."""


class Wake:
    """Wakes the thread that owns the line, from any thread."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._read, False)
        os.set_blocking(self._write, False)

    def fileno(self) -> int:
        """Descriptor that is readable while the wake-up is pending."""
        return self._read

    def set(self) -> None:
        """Wake the owner; a full pipe means that it is awake already."""
        with suppress(BlockingIOError):
            os.write(self._write, b"!")

    def wait(self, wall: float) -> bool:
        """Wait at most ``wall`` seconds; true when woken, and then the wake-up is taken."""
        if not select.select([self], [], [], max(0.0, wall))[0]:
            return False
        self.clear()
        return True

    def clear(self) -> None:
        """Take pending wake-ups."""
        with suppress(BlockingIOError):
            os.read(self._read, 4096)

    def close(self) -> None:
        """Give the descriptors back."""
        os.close(self._read)
        os.close(self._write)


class SerialLine:
    """A serial port that carries carriage-return-ended replies.

    Parameters
    ----------
    port : str
        Device; ``/dev/serial/by-id/...`` survives replugging.
    baud_rate : int
    clock : BenchClock
        Timeouts are given in bench seconds.
    wake : Wake
        Breaks off a wait.

    Raises
    ------
    LineLost
        From every method, once the port fails.
    """

    def __init__(self, port: str, baud_rate: int, clock: BenchClock, wake: Wake) -> None:
        self.port, self.clock, self._wake = port, clock, wake
        self._buffer = bytearray()
        self._dirty = True
        with self._guard("cannot be opened"):
            # Reads never block: the waiting is done by select, where a wake-up can end it.
            self._serial: Any = serial.Serial(port, baud_rate, timeout=0, write_timeout=0.2, exclusive=True)
        with suppress(*_GONE, ValueError, AttributeError, NotImplementedError):
            # A USB adapter's latency timer of 16 ms would dominate every exchange; a pseudo-terminal has none.
            self._serial.set_low_latency_mode(True)

    @property
    def baud_rate(self) -> int:
        """Rate of the host's side in bit/s."""
        return int(self._serial.baudrate)

    @baud_rate.setter
    def baud_rate(self, value: int) -> None:
        with self._guard(f"refuses {value} baud"):
            self._serial.baudrate = value
        self._dirty = True

    def duration(self, count: int) -> float:
        """Time in bench s that ``count`` bytes take (start, 8 data and stop bit)."""
        return 10 * count / self.baud_rate

    def write(self, data: bytes) -> None:
        """Send commands that are answered by nothing."""
        with self._guard("does not take data"):
            self._serial.write(data)

    def ask(self, request: bytes, count: int, timeout: float) -> list[tuple[bytes, float]]:
        """Send a request and wait for its ``count`` replies.

        Parameters
        ----------
        request : bytes
            Commands and reports, ended by a delimiter.
        count : int
            Replies that it brings.
        timeout : float
            Bench seconds for all replies, after the time that the bytes of the request take.

        Returns
        -------
        list of (reply, time)
            Each without its carriage return, with the bench time of its end.

        Raises
        ------
        ReplyError
            When a reply is missing or more came than asked for. What still arrives is thrown away before the next
            question, so that no late reply is ever taken for another.
        Interrupted
            When the owner was woken.
        """
        if self._dirty:
            self.drain()
        if self._buffer or self._ready(0.0):
            self.drain()
            raise ReplyError("bytes came that nobody had asked for: a late reply, or noise")
        self.write(request)
        self._dirty = True
        deadline = time.monotonic() + max(MIN_TIMEOUT, self.clock.wall(timeout + self.duration(len(request))))
        replies = [(self._line(deadline), self.clock.now()) for _ in range(count)]
        if self._buffer:
            raise ReplyError(f"{bytes(self._buffer)!r} came after the last reply expected")
        self._dirty = False
        return replies

    def drain(self, limit: float = 0.2) -> None:
        """Throw away what arrives until the line has been quiet, at most ``limit`` bench seconds."""
        quiet = max(0.002, self.clock.wall(self.duration(5)))
        deadline = time.monotonic() + max(MIN_TIMEOUT, self.clock.wall(limit))
        self._buffer.clear()
        while time.monotonic() < deadline and self._ready(quiet):
            self._receive()
        self._buffer.clear()
        self._dirty = False

    def close(self) -> None:
        """Close the port; safe at any time."""
        with suppress(*_GONE):
            self._serial.close()

    def _line(self, deadline: float) -> bytes:
        while (end := self._buffer.find(b"\r")) < 0:
            if len(self._buffer) > _BUFFER:
                raise ReplyError(f"{len(self._buffer)} bytes came without an end of a reply")
            if not self._ready(deadline - time.monotonic()):
                raise ReplyError("no reply in time" if not self._buffer else f"half a reply: {bytes(self._buffer)!r}")
            self._receive()
        line = bytes(self._buffer[:end]).strip(b"\n")
        del self._buffer[: end + 1]
        return line

    def _ready(self, wall: float) -> bool:
        """Whether bytes are there within ``wall`` seconds."""
        with self._guard("is gone"):
            ready = select.select([self._serial.fileno(), self._wake], [], [], max(0.0, wall))[0]
        if self._wake in ready:
            self._wake.clear()
            self._dirty = True
            raise Interrupted("the wait for a reply was broken off")
        return bool(ready)

    def _receive(self) -> None:
        with self._guard("is gone"):
            self._buffer += self._serial.read(_BUFFER)

    @contextmanager
    def _guard(self, what: str) -> Iterator[None]:
        try:
            yield
        except _GONE as error:
            raise LineLost(f"{self.port} {what} ({error})") from error
