"""The permitted transitions between the modes of the bench."""

import itertools
import threading
from collections.abc import Callable

from mrd_base.lease import Mode
from mrd_bench_driver.supervision.errors import RefusedError, TrippedError

# A fault may come at any time. It ends in idle only, so that nothing moves on by itself afterwards.
TRANSITIONS: dict[Mode, frozenset[Mode]] = {
    Mode.IDLE: frozenset({Mode.HOMING, Mode.IDENTIFICATION, Mode.CONTROL, Mode.FAULT}),
    Mode.HOMING: frozenset({Mode.IDLE, Mode.IDENTIFICATION, Mode.CONTROL, Mode.FAULT}),
    Mode.IDENTIFICATION: frozenset({Mode.IDLE, Mode.FAULT}),
    Mode.CONTROL: frozenset({Mode.IDLE, Mode.FAULT}),
    Mode.FAULT: frozenset({Mode.IDLE}),
}


class BenchMode:
    """The present mode of the bench and the reason for it. Threads may share it.

    Parameters
    ----------
    on_change : callable
        Receives this object at the start and after every change, in the order of the changes.
    new_number : callable, optional
        Returns a number that no lease has had.

    Attributes
    ----------
    current, reason : Mode, str
    lease : int
        Number of the lease that the mode grants for setpoints; 0 where nobody may send any.
    source : str
        Node whose setpoints these are; "" where they come from anybody who has the number.
    lock : threading.RLock
        Nothing changes while a thread holds it: for who reads more than one of these.
    """

    def __init__(self, on_change: Callable[["BenchMode"], None], new_number: Callable[[], int] | None = None) -> None:
        self.lock = threading.RLock()
        self._on_change = on_change
        self._new_number = new_number or itertools.count(1).__next__
        self._set(Mode.IDLE, "started")

    def _set(self, mode: Mode, reason: str, source: str = "") -> None:
        self.lease = self._new_number() if mode.takes_setpoints else 0
        self.current, self.reason, self.source = mode, reason, source
        self._on_change(self)

    def enter(self, mode: Mode, reason: str, source: str = "") -> None:
        """Change to another mode.

        Raises
        ------
        TrippedError
            In a fault, unless it ends in idle.
        RefusedError
            If there is no transition from the present mode.
        """
        with self.lock:
            if self.current is Mode.FAULT and mode is not Mode.IDLE:
                raise TrippedError(self.reason)
            if mode not in TRANSITIONS[self.current]:
                raise RefusedError(f"the bench cannot go from {self.current} to {mode}; call stop first")
            self._set(mode, reason, source)

    def leave(self, reason: str) -> None:
        """Return to idle from a mode in which the rod may move. A fault stays."""
        with self.lock:
            if self.current.may_move:
                self._set(Mode.IDLE, reason)

    def trip(self, reason: str) -> bool:
        """Change to fault; return whether this is new. The reason of the first fault stays."""
        with self.lock:
            if self.current is Mode.FAULT:
                return False
            self._set(Mode.FAULT, reason)
            return True

    def require_idle(self) -> None:
        """Raise `RefusedError` unless the bench is idle."""
        mode, reason = self.current, self.reason
        if mode is not Mode.IDLE:
            hint = "remove the cause, then call reset_fault" if mode is Mode.FAULT else "call stop first"
            raise RefusedError(f"the bench is in mode {mode} ({reason}); {hint}")

    def require_no_fault(self) -> None:
        """Raise `TrippedError` in a fault."""
        if self.current is Mode.FAULT:
            raise TrippedError(self.reason)


__all__ = ["TRANSITIONS", "BenchMode", "Mode"]
