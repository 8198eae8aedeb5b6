"""The lease: the supervisor's permission to move the rod and to drive the coil, renewed every 40 ms (docs/safety.md).

One message serves as heartbeat and as ownership. Servo and DAQ move nothing without a lease, stop by themselves when it is
no longer renewed, and follow only setpoints that carry its number.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

# Bench time in s for which a stop of an idle bench is remembered, because the lease of a procedure that has just begun may
# still be under way.
_STOP_MEMORY = 0.04
# Time in s by which setpoints may be stamped ahead: those of a hybrid test are by the servo's delay, up to 0.1 s.
_LARGEST_LEAD = 0.13
# Supervisors whose ages, in s, differ by less have started together.
_TOGETHER = 1.0


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

    @property
    def takes_setpoints(self) -> bool:
        """Whether rod and coil follow setpoints."""
        return self in (Mode.IDENTIFICATION, Mode.CONTROL)

    def __str__(self) -> str:
        return self.name.lower()


def is_later(holder: str, age: float, other: str, age_of_other: float) -> bool:
    """Whether one of two supervisors is the later one, which ends; of two that started together, the names decide.

    Ages are in s, by the own clock of each: those of two machines differ, and that of one may have been set meanwhile.
    """
    if holder == other:
        return False
    return holder > other if abs(age - age_of_other) < _TOGETHER else age < age_of_other


@dataclass(frozen=True)
class Lease:
    """A lease, as the supervisor renews it.

    Attributes
    ----------
    time : float
        Bench time in s of the renewal.
    holder : str
        The supervisor.
    since : float
        Bench time in s at which the supervisor started.
    mode : Mode
        Mode of the bench.
    number : int
        What setpoints must carry; 0 where nobody may send any.
    source : str
        Node whose setpoints these are; "" where they come from anybody who has the number.
    """

    time: float = -math.inf
    holder: str = ""
    since: float = math.inf
    mode: Mode = Mode.IDLE
    number: int = 0
    source: str = ""


def is_timely(stamp: float, now: float, timeout: float) -> bool:
    """Whether a setpoint that comes ``now`` is to be followed: not one older than the timeout, or from the future."""
    return -_LARGEST_LEAD <= now - stamp <= timeout


class LeaseWatch:
    """What a node knows of the lease. Its methods return at once.

    Parameters
    ----------
    timeout : float
        Age in s from which a lease is void.

    Attributes
    ----------
    lease : Lease
        Latest renewal by the holder.
    halt_time : float
        Bench time in s of the latest `revoke`.
    """

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout
        self.lease = Lease()
        self._granted = 0  # latest number
        self.halt_time = -math.inf
        self._revoked = False  # whether a stop has ended the lease

    def renew(self, lease: Lease, now: float) -> str:
        """Take a renewal; return why it is refused, or "".

        While a lease is valid, nobody else can take it.
        """
        if self.is_valid(now) and lease.holder != self.lease.holder:
            return f"the lease of {lease.holder} is refused: {self.lease.holder} holds the bench; stop one of them"
        # A message that was under way for long is no sign of life, nor is a stamp from the future.
        if now - lease.time <= self._timeout:
            begins = lease.mode.may_move and not self.lease.mode.may_move
            self._revoked = lease.mode.may_move and (self._revoked or (begins and now - self.halt_time < _STOP_MEMORY))
            self.lease = replace(lease, time=min(lease.time, now))
            self._granted = lease.number or self._granted
        return ""

    def was_granted(self, number: int) -> bool:
        """Whether a number is that of the latest lease, which may have ended."""
        return number == self._granted != 0

    def revoke(self, now: float) -> None:
        """Permit no motion until the present procedure has ended, and remember it: somebody has asked for a stop."""
        self.halt_time = now
        self.end()

    def end(self) -> None:
        """Permit no motion until the present procedure has ended."""
        self._revoked = self.lease.mode.may_move

    def is_valid(self, now: float) -> bool:
        """Whether the holder has renewed the lease lately."""
        return now - self.lease.time <= self._timeout

    def reason_not_to_move(self, now: float) -> str:
        """Return why the rod must not be moved, or ""."""
        if not self.is_valid(now):
            return "no supervisor watches; start one, then call its home, control or run_experiment"
        if not self.lease.mode.may_move:
            return f"the bench is in mode {self.lease.mode}; call home, control or run_experiment of {self.lease.holder}"
        if self._revoked:
            return "somebody called a stop; let the supervisor's procedure end, then begin anew"
        return ""

    def reason_not_to_follow(self, number: int, now: float) -> str:
        """Return why a setpoint with this number must not be followed, or ""."""
        if reason := self.reason_not_to_move(now):
            return reason
        if not self.lease.mode.takes_setpoints:
            return f"the bench is in mode {self.lease.mode}"
        return "" if number == self.lease.number != 0 else f"it carries lease {number}, not {self.lease.number}"

    def reason_not_to_change(self, now: float) -> str:
        """Return why nothing may be changed that would spoil a run, or ""."""
        if self.is_valid(now) and self.lease.mode.may_move:
            return f"the bench is in mode {self.lease.mode}; call stop of {self.lease.holder} first"
        return ""

    def reason_not_to_start(self, source: str, now: float) -> str:
        """Return why a source of setpoints must not be started, or ""; without a lease nobody follows them."""
        if self.is_valid(now) and self.lease.mode is Mode.FAULT:
            return f"the emergency stop is latched; call reset_fault of {self.lease.holder} first"
        return "" if self.lease.source == source else self.reason_not_to_change(now)

    def is_lost(self, now: float) -> bool:
        """Whether the supervisor has fallen silent while rod or coil may move."""
        return self.lease.mode.may_move and not self.is_valid(now)

    def forget(self) -> None:
        """Note that a lost lease has been answered by a stop, which is latched."""
        self.lease, self._revoked = Lease(), False
