"""The modes of the bench and the permitted transitions between them."""

import threading
from collections.abc import Callable
from enum import IntEnum

from mrd_bench_driver.supervision.errors import RefusedError, TrippedError


class Mode(IntEnum):
    """Mode of the bench, numbered as in the message BenchState."""

    IDLE = 0
    HOMING = 1
    IDENTIFICATION = 2
    CONTROL = 3
    FAULT = 4

    @property
    def may_move(self) -> bool:
        """Whether the rod may move, so that the interlocks are checked."""
        return self in (Mode.HOMING, Mode.IDENTIFICATION, Mode.CONTROL)

    def __str__(self) -> str:
        return self.name.lower()


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
        Receives mode and reason at the start and after every change, in the order of the changes.
    """

    def __init__(self, on_change: Callable[[Mode, str], None]) -> None:
        self._lock = threading.RLock()
        self._on_change = on_change
        self._set(Mode.IDLE, "started")

    def _set(self, mode: Mode, reason: str) -> None:
        self.current, self.reason = mode, reason
        self._on_change(mode, reason)

    def enter(self, mode: Mode, reason: str) -> None:
        """Change to another mode.

        Raises
        ------
        TrippedError
            In a fault, unless it ends in idle.
        RefusedError
            If there is no transition from the present mode.
        """
        with self._lock:
            if self.current is Mode.FAULT and mode is not Mode.IDLE:
                raise TrippedError(self.reason)
            if mode not in TRANSITIONS[self.current]:
                raise RefusedError(f"the bench cannot go from {self.current} to {mode}; call stop first")
            self._set(mode, reason)

    def leave(self, reason: str) -> None:
        """Return to idle from a mode in which the rod may move. A fault stays."""
        with self._lock:
            if self.current.may_move:
                self._set(Mode.IDLE, reason)

    def trip(self, reason: str) -> bool:
        """Change to fault; return whether this is new. The reason of the first fault stays."""
        with self._lock:
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
