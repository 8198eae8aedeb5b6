"""The motor's serial line as a pseudo-terminal: the one place of the simulator that opens a device."""

import contextlib
import fcntl
import os
import selectors
import termios
import threading
import tty
from pathlib import Path
from typing import IO

from mrd_base import BenchClock, InputError
from mrd_sim.motor.smart_motor import BAUD_RATES, SmartMotor

_RATES = {getattr(termios, f"B{rate}"): rate for rate in BAUD_RATES}
_COALESCE = 0.001  # wall seconds: bytes that leave within it are handed over together, as a USB adapter does


class SerialLine:
    """Serves a motor on a pseudo-terminal that a driver opens by its link.

    A thread of its own carries the bytes, each at its bench time. Whoever else uses the motor holds ``lock``.

    Parameters
    ----------
    motor : SmartMotor
    bench : BenchClock
    link : path
        Symbolic link to make; ``~`` is the home directory. A ``.lock`` file beside it keeps a second motor from it.

    Raises
    ------
    InputError
        When something stands at ``link`` that is not ours, or another simulated motor uses it.
    """

    def __init__(self, motor: SmartMotor, bench: BenchClock, link: str | Path) -> None:
        self.motor = motor
        self.bench = bench
        self.link = Path(link).expanduser().absolute()
        self.lock = threading.Lock()
        self._owner = self._claim()
        self._thread: threading.Thread | None = None

    @property
    def plugged(self) -> bool:
        """Whether the line exists and is served."""
        return self._thread is not None and self._thread.is_alive()

    def plug(self) -> None:
        """Make the pseudo-terminal and its link and serve it; nothing when that is done already."""
        if self._thread is not None:
            return
        # As long as we hold the slave open, reading the master does not fail when the driver closes its end.
        self._master, self._slave = os.openpty()
        # Raw before anybody can write: a fresh terminal echoes and turns CR into LF.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._wake_reader, self._wake_writer = os.pipe()
        self._make_link(os.ttyname(self._slave))
        self._thread = threading.Thread(target=self._serve, name="motor serial line", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Pull the line: the driver's end fails, the link is gone, the motor does what it was told last."""
        if self._thread is None:
            return
        os.write(self._wake_writer, b"x")
        self._thread.join()
        self._thread = None
        target = os.ttyname(self._slave)
        for descriptor in (self._master, self._slave, self._wake_reader, self._wake_writer):
            os.close(descriptor)
        with contextlib.suppress(OSError):
            if os.readlink(self.link) == target:
                self.link.unlink()

    def close(self) -> None:
        """Unplug for good and give the link up."""
        self.unplug()
        self._owner.close()

    def _claim(self) -> IO[str]:
        try:
            self.link.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            owner = open(f"{self.link}.lock", "a+", encoding="utf-8")  # noqa: SIM115 - held until close()
        except OSError as error:
            raise InputError(f"port_link {self.link}: cannot be made ({error.strerror})") from None
        try:
            fcntl.flock(owner, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            owner.close()
            raise InputError(
                f"port_link {self.link}: another simulated motor uses it; stop that one or choose another port_link"
            ) from None
        owner.seek(0)
        ours = owner.read().strip()
        if os.path.lexists(self.link):
            # A killed simulator leaves its link; the terminal it names may meanwhile be someone else's.
            target = os.readlink(self.link) if self.link.is_symlink() else ""
            if not target or (target != ours and self.link.exists()):
                owner.close()
                raise InputError(f"port_link {self.link}: something else stands there; remove it or choose another one")
        return owner

    def _make_link(self, target: str) -> None:
        self._owner.seek(0)
        self._owner.truncate()
        self._owner.write(target)
        self._owner.flush()
        fresh = Path(f"{self.link}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(target)
        fresh.replace(self.link)

    def _host_baud(self) -> int:
        """Rate that the host has set; a pseudo-terminal transports at any, but remembers it."""
        return _RATES.get(termios.tcgetattr(self._slave)[5], 0)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._master, selectors.EVENT_READ)
            selector.register(self._wake_reader, selectors.EVENT_READ)
            while True:
                with self.lock:
                    due = self.motor.next_event()
                wait = None if due == float("inf") else max(self.bench.wall(due - self.bench.now()), _COALESCE)
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
                    # Nobody reads: the buffer is full, and as on a wire the bytes are gone.
                    with contextlib.suppress(BlockingIOError):
                        os.write(self._master, sent)
