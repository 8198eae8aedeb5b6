"""ASCII protocol of the SmartMotor Class 5: units, commands, queries and status words. This module opens no port.

The motor does not answer a command. It answers a query with one decimal number and a carriage return. A reply does not
name its query: only the order relates the two. Therefore a reply that looks wrong is refused, never interpreted.
"""

import math
import re
from dataclasses import dataclass

from mrd_base import InputError, quantity

BAUD_RATES = (115200, 57600, 38400, 19200, 9600, 4800, 2400)
FACTORY_BAUD_RATE = 9600
# Rates in Hz at which the motor computes its trajectory, for its settings PID1, PID2, PID4 and PID8.
SAMPLE_RATES = (16000, 8000, 4000, 2000)
# The motor keeps positions and velocities in signed 32-bit registers.
_REGISTER_MAX = 2**31 - 1


class ReplyError(Exception):
    """A reply is missing, garbled, or outside the range of its query."""


@dataclass(frozen=True)
class Drivetrain:
    """Encoder, gearbox and pinion, which relate the motor's counts to the rod; section ``drive`` of the configuration."""

    counts_per_revolution: int = quantity(8000, "", "encoder counts per motor revolution (RRES)", lower=100, upper=10**6)
    gear_ratio: float = quantity(40.0, "", "motor revolutions per pinion revolution", lower=0.01, upper=1e4)
    pinion_diameter: float = quantity(0.064, "mm", "pitch diameter of the pinion", lower=1e-3, upper=1)
    reversed: bool = quantity(False, "", "whether positive counts retract the rod")


@dataclass(frozen=True)
class MotorUnits:
    """Convert between SI units at the rod and the motor's integers.

    Parameters
    ----------
    sample_rate : int
        Trajectory rate of the motor in Hz (``RSAMP``). It scales every velocity and acceleration.
    """

    drivetrain: Drivetrain
    sample_rate: int = 8000

    @property
    def counts_per_metre(self) -> float:
        """Encoder counts per metre of rod travel, negative for a reversed drivetrain."""
        sign = -1.0 if self.drivetrain.reversed else 1.0
        travel = math.pi * self.drivetrain.pinion_diameter / self.drivetrain.gear_ratio
        return sign * self.drivetrain.counts_per_revolution / travel

    def counts(self, position: float) -> int:
        """Return the motor position in counts for a rod position in m."""
        return round(position * self.counts_per_metre)

    def metres(self, counts: int) -> float:
        """Return the rod position in m for a motor position in counts."""
        return counts / self.counts_per_metre

    def vt(self, speed: float) -> int:
        """Return ``VT`` (counts per sample × 65536), at least 1, for a ``speed`` ≥ 0 in m/s; 0 would never arrive."""
        return max(1, min(_REGISTER_MAX, round(speed * abs(self.counts_per_metre) / self.sample_rate * 65536)))

    def adt(self, acceleration: float) -> int:
        """Return ``ADT`` (counts per sample² × 65536), rounded up to even, for an ``acceleration`` ≥ 0 in m/s²."""
        raw = acceleration * abs(self.counts_per_metre) / self.sample_rate**2 * 65536
        # The tolerance keeps rounding of the product from lifting an exact even number to the next one.
        return max(2, min(_REGISTER_MAX - 1, 2 * math.ceil(raw / 2 - 1e-9)))


def motor_units(drivetrain: Drivetrain, counts_per_revolution: int, sample_rate: int) -> MotorUnits:
    """Return the units of a motor that reported its resolution and trajectory rate.

    Raises
    ------
    InputError
        If the motor is not the one that the bench is configured for.
    """
    if counts_per_revolution != drivetrain.counts_per_revolution:
        raise InputError(
            f"the motor reports {counts_per_revolution} counts per revolution (RRES), the bench is configured for "
            f"{drivetrain.counts_per_revolution}; check the motor, then drive.counts_per_revolution"
        )
    if sample_rate not in SAMPLE_RATES:
        raise InputError(
            f"the motor reports a trajectory rate of {sample_rate} Hz (RSAMP), expected one of "
            f"{', '.join(map(str, SAMPLE_RATES))}"
        )
    return MotorUnits(drivetrain, sample_rate)


@dataclass(frozen=True)
class Query:
    """A query to the motor.

    Attributes
    ----------
    command : bytes
        Text that is sent.
    lower, upper : int
        Range in which the reply must lie.
    pattern : bytes
        Regular expression that the whole reply matches; its first group is the number.
    """

    command: bytes
    lower: int
    upper: int
    pattern: bytes = rb"(-?[0-9]{1,10})"

    def parse(self, reply: bytes) -> int:
        """Return the number in a reply that has lost its carriage return.

        Raises
        ------
        ReplyError
            If the reply does not match the pattern, or its number lies outside the range.
        """
        match = re.fullmatch(self.pattern, reply)
        if not match:
            shown = repr(reply[:24].decode("ascii", "backslashreplace"))
            raise ReplyError(f"{self.command.decode()} was answered by {shown}, expected {self.pattern.decode()}")
        value = int(match[1])
        if not self.lower <= value <= self.upper:
            raise ReplyError(f"{self.command.decode()} was answered by {value}, expected {self.lower} to {self.upper}")
        return value


POSITION = Query(b"RPA", -_REGISTER_MAX - 1, _REGISTER_MAX)
STATUS_0 = Query(b"RW(0)", 0, 65535)
STATUS_1 = Query(b"RW(1)", 0, 65535)
BUS_VOLTAGE = Query(b"RUJA", 0, 100_000)  # mV
TEMPERATURE = Query(b"RTEMP", -50, 200)  # degC
RESOLUTION = Query(b"RRES", 1, 10**6)
SAMPLE_RATE = Query(b"RSAMP", 1, 10**5)
FIRMWARE = Query(b"RSP", 0, _REGISTER_MAX, rb"([0-9]{1,10})/[0-9.]{1,20}")


def encode_move(position: int, vt: int, adt: int | None) -> bytes:
    """Return the command that moves to ``position`` in counts. Without ``adt`` the motor keeps its acceleration."""
    acceleration = b"" if adt is None else b"ADT=%d " % adt
    return b"PT=%d VT=%d %sG " % (position, vt, acceleration)


@dataclass(frozen=True)
class MotorStatus:
    """Meaning of the motor's status words 0 and 1.

    Attributes
    ----------
    off : bool
        Whether the drive is off, so that it does not hold the rod (bit Bo).
    moving : bool
        Whether a trajectory is in progress (bit Bt).
    soft_limits : bool
        Whether the software travel limits are enabled. A reset of the motor disables them.
    faults : tuple of str
        Each fault in plain words, with its remedy.
    """

    off: bool
    moving: bool
    soft_limits: bool
    faults: tuple[str, ...]


# Faults by their bit in status word 0, and below in status word 1 (Moog Animatics, Class 5).
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


def decode_status(word_0: int, word_1: int) -> MotorStatus:
    """Decode the status words 0 and 1 (Moog Animatics, Class 5)."""
    faults = [text for bit, text in _FAULTS_0.items() if word_0 >> bit & 1]
    faults += [text for bit, text in _FAULTS_1.items() if word_1 >> bit & 1]
    return MotorStatus(
        off=bool(word_0 >> 1 & 1), moving=bool(word_0 >> 2 & 1), soft_limits=bool(word_1 >> 10 & 1), faults=tuple(faults)
    )
