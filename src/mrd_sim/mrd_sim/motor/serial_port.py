"""The motor's serial port as a pseudo-terminal: the one place of the simulator that opens a device."""

import contextlib
import fcntl
import os
import selectors
import termios
import threading
import tty
from pathlib import Path

from mrd_base import BenchClock, InputError
from mrd_sim.motor.smart_motor import BAUD_RATES, SmartMotor

_RATES = {getattr(termios, f"B{rate}"): rate for rate in BAUD_RATES}
_HANDOVER = 0.001
"""Wall seconds. Bytes that leave within it are handed over together, as a USB adapter does."""


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

    A thread carries the bytes, each at its bench time. Whoever else uses the motor holds ``lock``.

    Parameters
    ----------
    motor : SmartMotor
    bench : BenchClock
    link : path
        Link to make, see `DeviceLink`; ``~`` is the home directory.

    Raises
    ------
    InputError
        When the link cannot be made.
    """

    def __init__(self, motor: SmartMotor, bench: BenchClock, link: str | Path) -> None:
        self.motor = motor
        self.bench = bench
        self.link = Path(link).expanduser().absolute()
        self.lock = threading.Lock()
        self._device_link = DeviceLink(self.link)
        self._thread: threading.Thread | None = None

    @property
    def plugged(self) -> bool:
        """Whether the port exists and is served."""
        return self._thread is not None and self._thread.is_alive()

    @property
    def terminal(self) -> str:
        """Device file of the pseudo-terminal while the line is plugged in."""
        return os.ttyname(self._slave)

    def plug(self) -> None:
        """Make the pseudo-terminal and its link and serve them; nothing when that is done already."""
        if self._thread is not None:
            return
        # As long as we hold the slave open, reading the master does not fail when the driver closes its end.
        self._master, self._slave = os.openpty()
        # Raw before anybody can write: a fresh terminal echoes and turns CR into LF.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._wake_reader, self._wake_writer = os.pipe()
        self._device_link.point_to(self.terminal)
        self._thread = threading.Thread(target=self._serve, name="motor serial port", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Pull the line: the driver's end fails, the link is gone, the motor goes on with its last command."""
        if self._thread is None:
            return
        os.write(self._wake_writer, b"x")
        self._thread.join()
        self._thread = None
        target = self.terminal
        for descriptor in (self._master, self._slave, self._wake_reader, self._wake_writer):
            os.close(descriptor)
        self._device_link.remove(target)

    def close(self) -> None:
        """Unplug for good and release the link."""
        self.unplug()
        self._device_link.release()

    def _host_baud(self) -> int:
        """Rate that the host has set: a pseudo-terminal transports at any rate, but remembers the setting."""
        return _RATES.get(termios.tcgetattr(self._slave)[5], 0)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._master, selectors.EVENT_READ)
            selector.register(self._wake_reader, selectors.EVENT_READ)
            while True:
                with self.lock:
                    due = self.motor.next_event()
                wait = None if due == float("inf") else max(self.bench.wall(due - self.bench.now()), _HANDOVER)
                ready = {key.fd for key, _ in selector.select(wait)}
                if self._wake_reader in ready:
                    return
                data = b""
                if self._master in ready:
                    with contextlib.suppress(BlockingIOError):
                        data = os.read(self._master, 4096)
                now = self.bench.now()
                with self.lock:
                    baud = self._host_baud()
                    if data:
                        self.motor.feed(data, now, baud)
                    self.motor.advance(now)
                    sent = bytes(byte for _, byte in self.motor.take_output(now, baud))
                if sent:
                    # When nobody reads, the buffer is full and the bytes are lost, as on a wire.
                    with contextlib.suppress(BlockingIOError):
                        os.write(self._master, sent)
