"""What the bench is doing, and what it may do next."""

from enum import IntEnum

from mrd_base import InputError


class Mode(IntEnum):
    """Numbers as in the message BenchState."""

    IDLE = 0
    HOMING = 1
    IDENTIFICATION = 2
    CONTROL = 3
    FAULT = 4

    @property
    def may_move(self) -> bool:
        """Whether the rod may move, so that the interlocks watch."""
        return self in (Mode.HOMING, Mode.IDENTIFICATION, Mode.CONTROL)

    def __str__(self) -> str:
        return self.name.lower()


# A fault may come at any time; it is left to idle only, so that nothing goes on by itself afterwards.
TRANSITIONS: dict[Mode, frozenset[Mode]] = {
    Mode.IDLE: frozenset({Mode.HOMING, Mode.IDENTIFICATION, Mode.CONTROL, Mode.FAULT}),
    Mode.HOMING: frozenset({Mode.IDLE, Mode.IDENTIFICATION, Mode.CONTROL, Mode.FAULT}),
    Mode.IDENTIFICATION: frozenset({Mode.IDLE, Mode.FAULT}),
    Mode.CONTROL: frozenset({Mode.IDLE, Mode.FAULT}),
    Mode.FAULT: frozenset({Mode.IDLE}),
}

_WAYS_OUT = {
    Mode.HOMING: "wait for its end or call stop",
    Mode.IDENTIFICATION: "wait for its end, cancel it or call stop",
    Mode.CONTROL: "call stop",
    Mode.FAULT: "remove the cause, then call reset_fault",
}


def change(now: Mode, to: Mode) -> Mode:
    """The new mode.

    Raises
    ------
    InputError
        When there is no way from one to the other; it says what to do first.
    """
    if to not in TRANSITIONS[now]:
        hint = f"; {_WAYS_OUT[now]}" if now in _WAYS_OUT and to != now else ""
        raise InputError(f"the bench cannot go from {now} to {to}{hint}")
    return to
