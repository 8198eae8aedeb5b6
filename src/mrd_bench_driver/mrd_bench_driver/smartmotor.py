"""SmartMotor Class 5, ASCII protocol: units, commands, reports and status words; no port is opened here.

A set command is answered by nothing, a report by one decimal number and a carriage return. Replies carry no name: they
belong to the questions by order alone, so that whatever looks wrong is refused rather than guessed at.
"""

import math
import re
from dataclasses import dataclass

from mrd_base import InputError, quantity

BAUD_RATES = (115200, 57600, 38400, 19200, 9600, 4800, 2400)
FACTORY_BAUD = 9600
# Trajectory rates in Hz that PID1, PID2, PID4 and PID8 give.
SAMPLE_RATES = (16000, 8000, 4000, 2000)
# Targets and velocities are 32-bit registers of the motor.
_REGISTER = 2**31 - 1


class ReplyError(Exception):
    """A reply is missing, garbled or impossible."""


@dataclass(frozen=True)
class Drive:
    """What stands between the motor's encoder and the rod; section ``drive`` of the node's configuration."""

    counts_per_revolution: int = quantity(8000, "", "encoder counts per motor revolution (RRES)", lower=100, upper=10**6)
    gear_ratio: float = quantity(40.0, "", "motor revolutions per pinion revolution", lower=0.01, upper=1e4)
    pinion_diameter: float = quantity(0.064, "mm", "pitch diameter of the pinion", lower=1e-3, upper=1)
    reversed: bool = quantity(False, "", "true where positive counts retract the rod")


@dataclass(frozen=True)
class Units:
    """Conversion between SI at the rod and the motor's numbers.

    Parameters
    ----------
    drive : Drive
        Encoder, gearbox and pinion.
    sample_rate : int
        Trajectory rate of the motor in Hz (``RSAMP``); it scales every velocity and acceleration.
    """

    drive: Drive
    sample_rate: int = 8000

    @property
    def counts_per_metre(self) -> float:
        """Encoder counts per metre of rod travel, negative for a reversed drive."""
        sign = -1.0 if self.drive.reversed else 1.0
        travel = math.pi * self.drive.pinion_diameter / self.drive.gear_ratio
        return sign * self.drive.counts_per_revolution / travel

    def counts(self, position: float) -> int:
        """Position register (counts) of a rod ``position`` in m."""
        return round(position * self.counts_per_metre)

    def metres(self, counts: int) -> float:
        """Rod position in m of a position register."""
        return counts / self.counts_per_metre

    def vt(self, speed: float) -> int:
        """``VT`` (counts per sample × 65536) of a ``speed`` ≥ 0 in m/s, at least 1: zero would never arrive."""
        return max(1, min(_REGISTER, round(speed * abs(self.counts_per_metre) / self.sample_rate * 65536)))

    def speed(self, vt: int) -> float:
        """Rod speed in m/s of a ``VT``."""
        return vt / 65536 * self.sample_rate / abs(self.counts_per_metre)

    def adt(self, acceleration: float) -> int:
        """``ADT`` (counts per sample² × 65536) of an ``acceleration`` ≥ 0 in m/s²: the next even number, at least 2."""
        raw = acceleration * abs(self.counts_per_metre) / self.sample_rate**2 * 65536
        # An exact even number must not be lifted by the last bit of the product.
        return max(2, min(_REGISTER - 1, 2 * math.ceil(raw / 2 - 1e-9)))

    def acceleration(self, adt: int) -> float:
        """Rod acceleration in m/s² of an ``ADT``."""
        return adt / 65536 * self.sample_rate**2 / abs(self.counts_per_metre)


def check_units(drive: Drive, counts_per_revolution: int, sample_rate: int) -> Units:
    """Units of a motor that reported its resolution and rate.

    Raises
    ------
    InputError
        When the motor is not the one that the bench is configured for.
    """
    if counts_per_revolution != drive.counts_per_revolution:
        raise InputError(
            f"the motor reports {counts_per_revolution} counts per revolution (RRES), the bench is configured for "
            f"{drive.counts_per_revolution}; check the motor, then drive.counts_per_revolution"
        )
    if sample_rate not in SAMPLE_RATES:
        raise InputError(
            f"the motor reports a trajectory rate of {sample_rate} Hz (RSAMP), expected one of "
            f"{', '.join(map(str, SAMPLE_RATES))}"
        )
    return Units(drive, sample_rate)


@dataclass(frozen=True)
class Report:
    """A question to the motor, the range that its answer must lie in, and its form (the first group is the number)."""

    query: bytes
    lower: int
    upper: int
    form: bytes = rb"(-?[0-9]{1,10})"

    def parse(self, reply: bytes) -> int:
        """Value of a reply, without its carriage return.

        Raises
        ------
        ReplyError
            Unless the reply has the form and its number lies within the range.
        """
        match = re.fullmatch(self.form, reply)
        if not match:
            raise ReplyError(f"{self.query.decode()} was answered by {_shown(reply)}, expected {self.form.decode()}")
        value = int(match[1])
        if not self.lower <= value <= self.upper:
            raise ReplyError(f"{self.query.decode()} was answered by {value}, expected {self.lower} to {self.upper}")
        return value


POSITION = Report(b"RPA", -_REGISTER - 1, _REGISTER)
STATUS_0 = Report(b"RW(0)", 0, 65535)
STATUS_1 = Report(b"RW(1)", 0, 65535)
BUS_VOLTAGE = Report(b"RUJA", 0, 100_000)  # mV
TEMPERATURE = Report(b"RTEMP", -50, 200)  # degC
RESOLUTION = Report(b"RRES", 1, 10**6)
SAMPLE_RATE = Report(b"RSAMP", 1, 10**5)
FIRMWARE = Report(b"RSP", 0, _REGISTER, rb"([0-9]{1,10})/[0-9.]{1,20}")


def motion(position: int, vt: int, adt: int | None) -> bytes:
    """Command that moves to ``position`` in counts; without ``adt`` the motor keeps its acceleration."""
    acceleration = b"" if adt is None else b"ADT=%d " % adt
    return b"PT=%d VT=%d %sG " % (position, vt, acceleration)


@dataclass(frozen=True)
class Status:
    """Status words 0 and 1, decoded.

    Attributes
    ----------
    off : bool
        The drive does not hold the rod (Bo).
    moving : bool
        A trajectory is in progress (Bt).
    soft_limits : bool
        The software travel limits are enabled.
    faults : tuple of str
        What stopped or stops the motor, in plain words with what to do.
    """

    off: bool
    moving: bool
    soft_limits: bool
    faults: tuple[str, ...]


_FAULTS_0 = {
    3: "bus voltage out of range: check the supply and, after hard braking, the shunt",
    4: "peak current exceeded (Ba): look for a jammed rod or a short",
    5: "motor over-temperature (Bh): let it cool by 5 degC, then reset",
    6: "position error too large (Be): look for a jammed rod, too much force or a weak supply",
    7: "velocity limit exceeded (Bv): lower the speed of the experiment",
    9: "position error grew too fast (dE/dt): look for a blow or a loose coupling",
    12: "positive hardware limit was touched: check limit_switches, then home again",
    13: "negative hardware limit was touched: check limit_switches, then home again",
    14: "positive hardware limit is active: check limit_switches or move the rod off the switch",
    15: "negative hardware limit is active: check limit_switches or move the rod off the switch",
}
_FAULTS_1 = {
    12: "positive software travel limit was passed: reset, then home again",
    13: "negative software travel limit was passed: reset, then home again",
    14: "beyond the positive software travel limit: reset, then home again",
    15: "beyond the negative software travel limit: reset, then home again",
}


def decode_status(word_0: int, word_1: int) -> Status:
    """Meaning of status words 0 and 1 (Moog Animatics, Class 5)."""
    faults = [text for bit, text in _FAULTS_0.items() if word_0 >> bit & 1]
    faults += [text for bit, text in _FAULTS_1.items() if word_1 >> bit & 1]
    return Status(
        off=bool(word_0 >> 1 & 1), moving=bool(word_0 >> 2 & 1), soft_limits=bool(word_1 >> 10 & 1), faults=tuple(faults)
    )


def _shown(reply: bytes) -> str:
    return repr(reply[:24].decode("ascii", "backslashreplace"))
