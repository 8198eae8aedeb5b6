"""The motor's serial port as a pseudo-terminal: the one place of the simulator that opens a device."""

import contextlib
import fcntl
import os
import sys
import termios
import threading
import time
import tty
from pathlib import Path

from mrd_base import InputError
from mrd_sim.motor.smart_motor import BAUD_RATES, SmartMotor

_RATES = {getattr(termios, f"B{rate}"): rate for rate in BAUD_RATES}
_DELIVERY_TIMEOUT = 5.0
"""Wall seconds in which the kernel carries bytes through a pseudo-terminal, be the machine ever so busy."""


class DeviceLink:
    """A symbolic link to a pseudo-terminal that belongs to one simulated motor at a time.

    A ``.lock`` file next to the link holds its target, and is locked as long as the link is claimed.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        When something else stands at ``path``, or another simulated motor uses it.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._lock = open(f"{path}.lock", "a+", encoding="utf-8")  # noqa: SIM115 - held until release()
        except OSError as error:
            raise InputError(f"port_link {path}: cannot be made ({error.strerror})") from None
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock.close()
            raise InputError(
                f"port_link {path}: another simulated motor uses it; stop that one or choose another port_link"
            ) from None
        self._lock.seek(0)
        former = self._lock.read().strip()
        if os.path.lexists(path):
            # A killed simulator leaves its link. The terminal that it names may belong to another program by now.
            target = os.readlink(path) if path.is_symlink() else ""
            if not target or (target != former and path.exists()):
                self._lock.close()
                raise InputError(f"port_link {path}: something else stands there; remove it or choose another port_link")

    def point_to(self, target: str) -> None:
        """Make or replace the link."""
        self._lock.seek(0)
        self._lock.truncate()
        self._lock.write(target)
        self._lock.flush()
        fresh = Path(f"{self.path}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(target)
        fresh.replace(self.path)

    def remove(self, target: str) -> None:
        """Remove the link if it still points to ``target``."""
        with contextlib.suppress(OSError):
            if os.readlink(self.path) == target:
                self.path.unlink()

    def release(self) -> None:
        """Let another simulated motor use the link."""
        self._lock.close()


class MotorSerialPort:
    """Serves a motor on a pseudo-terminal that a driver opens by a link.

    Parameters
    ----------
    motor : SmartMotor
    link : path
        Link to make, see `DeviceLink`; ``~`` is the home directory.

    Attributes
    ----------
    lock : Lock
        Held by everybody who uses the motor.

    Raises
    ------
    InputError
        When the link cannot be made.
    """

    def __init__(self, motor: SmartMotor, link: str | Path) -> None:
        self.motor = motor
        self.link = Path(link).expanduser().absolute()
        self.lock = threading.RLock()
        self.plugged = False
        self._received = 0  # bytes since the start
        self._device_link = DeviceLink(self.link)

    @property
    def terminal(self) -> str:
        """Device file of the pseudo-terminal while the line is plugged in."""
        return os.ttyname(self._slave)

    def plug(self) -> None:
        """Make the pseudo-terminal and its link; nothing when that is done already."""
        with self.lock:
            if self.plugged:
                return
            # As long as we hold the slave open, reading the master does not fail when the driver closes its end.
            self._master, self._slave = os.openpty()
            # Raw before anybody can write: a fresh terminal echoes and turns CR into LF.
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self._device_link.point_to(self.terminal)
            self.plugged = True

    def unplug(self) -> None:
        """Pull the line: the driver's end fails, the link is gone, the motor goes on with its last command."""
        with self.lock:
            if not self.plugged:
                return
            self.plugged = False
            target = self.terminal
            for descriptor in (self._master, self._slave):
                os.close(descriptor)
            self._device_link.remove(target)

    def close(self) -> None:
        """Unplug for good and release the link."""
        self.unplug()
        self._device_link.release()

    def read(self, count: int, now: float) -> None:
        """Wait until ``count`` bytes in all have come since the start, and give the motor those of bench time ``now``.

        The kernel takes a moment to carry bytes from one end of a pseudo-terminal to the other. Bytes that do not come are
        lost: the line was pulled meanwhile.
        """
        deadline = time.monotonic() + _DELIVERY_TIMEOUT
        while self._received < count:
            with self.lock:
                arrived = self.plugged and self._read(now)
            if not self.plugged or time.monotonic() > deadline:
                self._received = count
            elif not arrived:
                os.sched_yield()

    def exchange(self, now: float, awaited: bool = False) -> bool:
        """Let the motor read and answer until a bench time; return whether bytes were sent to the host.

        Where a host does nothing but wait for them, they are at its end by then.
        """
        with self.lock:
            if self.plugged:
                self._read(now)
            self.motor.advance(now)
            sent = bytes(byte for _, byte in self.motor.take_output(now, self._host_baud() if self.plugged else None))
            return self.plugged and bool(sent) and self._write(sent, awaited)

    def _host_baud(self) -> int:
        """Rate that the host has set: a pseudo-terminal transports at any rate, but remembers the setting."""
        return _RATES.get(termios.tcgetattr(self._slave)[5], 0)

    def _read(self, now: float) -> bool:
        try:
            data = os.read(self._master, 4096)
        except BlockingIOError:
            return False
        self._received += len(data)
        self.motor.feed(data, now, self._host_baud())
        return True

    def _write(self, data: bytes, awaited: bool) -> bool:
        present = self._bytes_at_host()
        try:
            os.write(self._master, data)
        except BlockingIOError:
            return False  # nobody reads, so the buffer is full and the bytes are lost, as on a wire
        deadline = time.monotonic() + _DELIVERY_TIMEOUT
        while awaited and self._bytes_at_host() < present + len(data) and time.monotonic() < deadline:
            os.sched_yield()  # a sleep would take many times as long as the kernel
        return True

    def _bytes_at_host(self) -> int:
        """Return the number of bytes that the host has not read yet."""
        return int.from_bytes(fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)), sys.byteorder)
