"""Find the motor on a serial line, identify it and set it up. Afterwards it stands still, with its drive off."""

import math
from contextlib import suppress
from dataclasses import dataclass

from mrd_base.clock import BenchClock, Waiter
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.motor_line import LineLostError, MotorLine
from mrd_bench_driver.servo.smartmotor import (
    BAUD_RATES,
    FACTORY_BAUD_RATE,
    POSITION,
    RESOLUTION,
    SAMPLE_RATE,
    STATUS_0,
    STATUS_1,
    Drivetrain,
    MotorUnits,
    Query,
    ReplyError,
    decode_status,
    motor_units,
)

# Wait in bench s for a reply. It begins about 3.5 ms after the end of the query (Moog Class 5, published measurement); the
# margin costs time only while the motor is searched for.
REPLY_TIMEOUT = 0.04
# Largest value in counts that the register of the motor's position-error limit EL accepts.
_EL_MAX = 262143
# Difference in counts of two position replies that agree: a motor at rest dithers by a few counts.
_POSITION_DITHER = 8


@dataclass(frozen=True)
class MotorIdentity:
    """Replies of a motor before it is set up: its units, its position in counts, and its status words 0 and 1."""

    units: MotorUnits
    position: int
    words: tuple[int, int]


def connect_motor(
    config: ServoConfig, keep_origin: bool, clock: BenchClock, waiter: Waiter
) -> tuple[MotorLine, MotorIdentity]:
    """Open the port, find and identify the motor, switch it to the configured baud rate, and set it up.

    Parameters
    ----------
    keep_origin : bool
        Whether to keep software travel limits that the motor still holds. They show that it was not reset.
    waiter : Waiter
        Waits for replies; another thread may wake it to end the search for the motor.

    Raises
    ------
    LineLostError
        If the port fails or no motor answers.
    InputError
        If the motor is not the configured one.
    WaitInterrupted
        If a wake-up came.
    """
    line = MotorLine(config.port, config.baud_rate, clock, waiter)
    try:
        _find_baud_rate(line, config.baud_rate)
        # A motor that still moves comes to rest while it is identified.
        line.write(b"X END ")
        if line.baud_rate != config.baud_rate:
            _switch_baud_rate(line, config.baud_rate)
        motor = _identify(line, config.drive)
        _configure(line, config, motor, keep_origin)
    except ReplyError as error:
        line.close()
        raise LineLostError(f"{config.port}: the motor does not answer properly ({error})") from error
    except BaseException:
        line.close()
        raise
    return line, motor


def _configure(line: MotorLine, config: ServoConfig, motor: MotorIdentity, keep_origin: bool) -> None:
    """Set the limits at which the motor itself stops: position error (``EL``), speed (``VL``), and travel."""
    counts_per_metre = abs(motor.units.counts_per_metre)
    error_limit = round(config.following_error_limit * counts_per_metre)
    rpm_limit = math.ceil(60 * (2 * config.limits.speed) * counts_per_metre / config.drive.counts_per_revolution)
    line.write(b"OFF %s " % (b"EILP EILN" if config.limit_switches else b"EIGN(W,0)"))
    if not (keep_origin and decode_status(*motor.words).soft_limits):
        line.write(b"SLD ")
    line.write(b"ZS MP EL=%d VL=%d\r" % (min(error_limit, _EL_MAX), rpm_limit))


def _read(line: MotorLine, query: Query) -> int:
    """Send a query until two successive replies agree: a garbled digit must not become a unit or an origin."""
    last: int | None = None
    for _ in range(5):
        try:
            value = query.parse(line.exchange(query.command + b"\r", 1, REPLY_TIMEOUT)[0][0])
        except ReplyError:
            continue
        if last is not None and abs(value - last) <= (_POSITION_DITHER if query is POSITION else 0):
            return value
        last = value
    raise ReplyError(f"{query.command.decode()} did not bring two equal replies")


def _find_baud_rate(line: MotorLine, baud_rate: int) -> None:
    """Find the rate of the motor: the configured one, that of the factory, or one of an earlier session."""
    for rate in dict.fromkeys((baud_rate, FACTORY_BAUD_RATE, *BAUD_RATES)):
        line.baud_rate = rate
        if _answers(line):
            return
    raise LineLostError(f"{line.port}: no motor answers at any baud rate; check power, cable and address")


def _answers(line: MotorLine) -> bool:
    """Whether a motor answers at the present baud rate."""
    # The byte 0x80 addresses all motors: bytes sent at a wrong rate may have addressed another one. The first carriage
    # return ends what the motor may have received of them. An echo that is still on comes before the number and is
    # discarded.
    line.drain(0.2)
    line.write(b"\x80\r\x80ECHO_OFF\r")
    for _ in range(2):
        with suppress(ReplyError):
            line.drain(0.05)
            RESOLUTION.parse(line.exchange(RESOLUTION.command + b"\r", 1, REPLY_TIMEOUT)[0][0])
            return True
    return False


def _switch_baud_rate(line: MotorLine, baud_rate: int) -> None:
    previous = line.baud_rate
    line.write(b"BAUD(0)=%d\r" % baud_rate)
    line.clock.sleep(line.duration(16) + 0.005)
    line.baud_rate = baud_rate
    if not _answers(line):
        raise LineLostError(
            f"{line.port}: the motor answered at {previous} baud but not after the change to {baud_rate}; check the line"
        )


def _identify(line: MotorLine, drivetrain: Drivetrain) -> MotorIdentity:
    units = motor_units(drivetrain, _read(line, RESOLUTION), _read(line, SAMPLE_RATE))
    return MotorIdentity(units, _read(line, POSITION), (_read(line, STATUS_0), _read(line, STATUS_1)))
