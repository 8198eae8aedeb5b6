"""Finding the motor on a line, asking what it is, and setting it up; it stands still and off afterwards."""

import math
from contextlib import suppress
from dataclasses import dataclass

from mrd_base import BenchClock
from mrd_bench_driver.serial_line import LineLost, SerialLine, Wake
from mrd_bench_driver.smartmotor import (
    BAUD_RATES,
    FACTORY_BAUD,
    POSITION,
    RESOLUTION,
    SAMPLE_RATE,
    STATUS_0,
    STATUS_1,
    Drive,
    ReplyError,
    Report,
    Units,
    check_units,
)

# A reply begins some 3.5 ms after the question's end (Moog Class 5, measured); waiting longer costs only time.
REPLY_TIMEOUT = 0.04


@dataclass(frozen=True)
class Motor:
    """A motor that answered: its units, its first position (counts) and its status words before the set-up."""

    units: Units
    position: int
    words: tuple[int, int]


def connect(
    port: str,
    baud_rate: int,
    drive: Drive,
    following_error: float,
    speed: float,
    limit_switches: bool,
    keep_origin: bool,
    clock: BenchClock,
    wake: Wake,
) -> tuple[SerialLine, Motor]:
    """Open the port, find and identify the motor, switch to ``baud_rate`` and set the motor up.

    Parameters
    ----------
    following_error : float
        Distance in m at which the motor itself gives up (``EL``).
    speed : float
        Speed in m/s at which the motor itself gives up (``VL``).
    limit_switches : bool
        Whether the hardware travel limits are wired.
    keep_origin : bool
        Whether software limits that the motor still holds are left alone; they tell that it was not reset.

    Raises
    ------
    LineLost
        When the port fails or no motor answers.
    InputError
        When the motor is not the configured one.
    Interrupted
        When woken meanwhile.
    """
    line = SerialLine(port, baud_rate, clock, wake)
    try:
        _probe(line, baud_rate)
        # Whatever still moves comes to rest while the motor is asked what it is.
        line.write(b"X END ")
        if line.baud_rate != baud_rate:
            _switch(line, baud_rate)
        motor = _identify(line, drive)
        counts = round(following_error * abs(motor.units.counts_per_metre))
        rpm = math.ceil(60 * speed * abs(motor.units.counts_per_metre) / drive.counts_per_revolution)
        line.write(b"OFF %s " % (b"EILP EILN" if limit_switches else b"EIGN(W,0)"))
        if not (keep_origin and motor.words[1] >> 10 & 1):
            line.write(b"SLD ")
        line.write(b"ZS MP EL=%d VL=%d\r" % (min(counts, 262143), rpm))
    except ReplyError as error:
        line.close()
        raise LineLost(f"{port}: the motor does not answer properly ({error})") from error
    except BaseException:
        line.close()
        raise
    return line, motor


def _ask(line: SerialLine, report: Report) -> int:
    """Ask until two answers agree: a single garbled digit must not become a unit or an origin."""
    last: int | None = None
    for _ in range(5):
        try:
            value = report.parse(line.ask(report.query + b"\r", 1, REPLY_TIMEOUT)[0][0])
        except ReplyError:
            continue
        if last is not None and abs(value - last) <= (8 if report is POSITION else 0):
            return value
        last = value
    raise ReplyError(f"{report.query.decode()} was not answered twice alike")


def _probe(line: SerialLine, baud_rate: int) -> None:
    """Find the rate that the motor listens at: it may be the configured, the factory's, or one of an earlier session."""
    for rate in dict.fromkeys((baud_rate, FACTORY_BAUD, *BAUD_RATES)):
        line.baud_rate = rate
        with suppress(_NotYet):
            return _answers(line)
    raise LineLost(f"{line.port}: no motor answers at any baud rate; check power, cable and address")


class _NotYet(Exception):  # noqa: N818
    pass


def _answers(line: SerialLine) -> None:
    # 0x80 addresses all motors: bytes sent at a wrong rate may have addressed another. The leading CR ends what the
    # motor may hold of them. An echo, while it is still on, comes before the number and is passed over.
    line.drain()
    line.write(b"\x80\r\x80ECHO_OFF\r")
    for _ in range(2):
        with suppress(ReplyError):
            line.drain(0.05)
            reply = line.ask(RESOLUTION.query + b"\r", 1, REPLY_TIMEOUT)[0][0]
            RESOLUTION.parse(reply)
            return
    raise _NotYet


def _switch(line: SerialLine, baud_rate: int) -> None:
    found = line.baud_rate
    line.write(b"BAUD(0)=%d\r" % baud_rate)
    line.clock.sleep_until(line.clock.now() + line.duration(16) + 0.005)
    line.baud_rate = baud_rate
    try:
        _answers(line)
    except _NotYet:
        raise LineLost(f"{line.port}: the motor answered at {found} baud but not after the change to {baud_rate}") from None


def _identify(line: SerialLine, drive: Drive) -> Motor:
    units = check_units(drive, _ask(line, RESOLUTION), _ask(line, SAMPLE_RATE))
    return Motor(units, _ask(line, POSITION), (_ask(line, STATUS_0), _ask(line, STATUS_1)))
