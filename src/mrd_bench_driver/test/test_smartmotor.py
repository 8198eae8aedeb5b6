"""MotorUnits, replies and status words of the motor."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_bench_driver.servo.smartmotor import (
    FIRMWARE,
    POSITION,
    RESOLUTION,
    STATUS_0,
    TEMPERATURE,
    Drivetrain,
    MotorUnits,
    ReplyError,
    decode_status,
    encode_move,
    motor_units,
)

UNITS = MotorUnits(Drivetrain())
lengths = st.floats(-0.1, 0.1)


def speed(vt: int) -> float:
    """Rod speed in m/s of a ``VT``, which counts 1/65536 counts per sample."""
    return vt / 65536 * 8000 * abs(UNITS.metres(1))


def acceleration(adt: int) -> float:
    """Rod acceleration in m/s² of an ``ADT``, which counts 1/65536 counts per sample²."""
    return adt / 65536 * 8000**2 * abs(UNITS.metres(1))


def test_counts_of_the_bench():
    # One motor revolution moves the rod by π · 64 mm / 40.
    assert UNITS.counts(math.pi * 0.064 / 40) == 8000
    assert UNITS.metres(1) == pytest.approx(0.6283e-6, rel=1e-4)
    assert UNITS.counts(-0.01) < 0 < MotorUnits(Drivetrain(reversed=True)).counts(-0.01)


def test_velocity_and_acceleration_follow_the_guide():
    # 10 rev/s and 200 rev/s² on a 5 mm lead, 8000 counts, 8 kHz (Moog Animatics, Class 5).
    lead = MotorUnits(Drivetrain(gear_ratio=1.0, pinion_diameter=0.005 / math.pi))
    assert lead.vt(0.05) == 655360
    assert lead.adt(1.0) == 1640  # 1638.4 rounded up to even
    assert lead.adt(1638 / 65536 * 8000**2 / 1.6e6) == 1638  # 1.6e6 counts per metre
    # Another trajectory rate rescales both.
    half = MotorUnits(Drivetrain(gear_ratio=1.0, pinion_diameter=0.005 / math.pi), 4000)
    assert half.vt(0.05) == 2 * 655360


@given(st.integers(-(10**6), 10**6))
def test_counts_come_back(counts):
    assert UNITS.counts(UNITS.metres(counts)) == counts


@given(lengths)
def test_metres_come_back_within_half_a_count(position):
    assert abs(UNITS.metres(UNITS.counts(position)) - position) <= 0.5001 * UNITS.metres(1)


@given(st.floats(1e-6, 2.0))
def test_speed_comes_back(wanted):
    assert speed(UNITS.vt(wanted)) == pytest.approx(wanted, rel=1e-6, abs=speed(1))


@given(st.floats(1e-3, 200.0))
def test_acceleration_comes_back_even_and_never_less(wanted):
    adt = UNITS.adt(wanted)
    assert adt % 2 == 0
    assert -1e-9 <= acceleration(adt) - wanted <= acceleration(2) * (1 + 1e-9)


def test_zero_is_never_sent():
    # Zero means no motion to the motor, not a slow one.
    assert UNITS.vt(0.0) == 1
    assert UNITS.adt(0.0) == 2


@given(st.binary(max_size=40))
def test_replies_are_numbers_in_range_or_refused(reply):
    for report in (POSITION, STATUS_0, TEMPERATURE, RESOLUTION, FIRMWARE):
        try:
            value = report.parse(reply)
        except ReplyError:
            continue
        assert report.lower <= value <= report.upper
        if report is not FIRMWARE:
            assert int(reply) == value


@pytest.mark.parametrize("reply", [b"", b"-", b"12 34", b"1.5", b"+5", b" 5", b"5\n", b"RPA", b"99999999999", b"2147483648"])
def test_garbled_positions_are_refused(reply):
    with pytest.raises(ReplyError, match="RPA was answered by"):
        POSITION.parse(reply)


def test_firmware_and_numbers_are_not_confused():
    assert FIRMWARE.parse(b"12500/5.0.3.44") == 12500
    with pytest.raises(ReplyError):
        FIRMWARE.parse(b"8000")
    with pytest.raises(ReplyError):
        RESOLUTION.parse(b"12500/5.0.3.44")


def test_motion_command():
    assert encode_move(-15915, 613000, 1638) == b"PT=-15915 VT=613000 ADT=1638 G "
    assert encode_move(5, 1, None) == b"PT=5 VT=1 G "


def test_another_motor_is_refused():
    assert motor_units(Drivetrain(), 8000, 8000) == UNITS
    with pytest.raises(InputError, match="4000 counts per revolution"):
        motor_units(Drivetrain(), 4000, 8000)
    with pytest.raises(InputError, match="RSAMP"):
        motor_units(Drivetrain(), 8000, 1234)


def test_status_after_power_up():
    status = decode_status(3 | 3 << 14, 0)
    assert status.off
    assert not status.moving
    assert len(status.faults) == 2  # both limit inputs are active until they are made plain inputs


@pytest.mark.parametrize(
    ("bit", "word"),
    [(3, "bus voltage"), (5, "over-temperature"), (6, "position error"), (7, "velocity limit"), (15, "negative hardware")],
)
def test_faults_in_plain_words(bit, word):
    assert [word in fault for fault in decode_status(1 | 1 << bit, 0).faults] == [True]


def test_healthy_motor_has_no_faults():
    assert decode_status(0b101, 1 << 10).faults == ()
    assert decode_status(0b101, 1 << 10).soft_limits


@given(st.integers(0, 65535), st.integers(0, 65535))
def test_any_status_is_decoded(word_0, word_1):
    assert all(fault for fault in decode_status(word_0, word_1).faults)
