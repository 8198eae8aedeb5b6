"""The interlocks: when the bench must stop, as pure functions of its state at one instant."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from mrd_base import quantity
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class Tolerances:
    """How far readings may exceed the limits of the setpoints; section ``interlocks`` of bench.yaml."""

    overspeed: float = quantity(1.25, doc="measured speed, as a multiple of limits.speed", lower=1, upper=3)
    current: float = quantity(0.1, "A", "measured coil current beyond limits.current", lower=0, upper=2)
    following_error: float = quantity(0.005, "mm", "setpoint minus rod position", lower=1e-5, upper=0.1)
    samples_stale: float = quantity(0.14, "ms", "age of the latest sample", lower=0.08, upper=1)
    servo_stale: float = quantity(0.15, "ms", "age of the latest servo_state", lower=0.02, upper=1)
    setpoint_stale: float = quantity(0.15, "ms", "age of the latest setpoint of an experiment", lower=0.02, upper=1)


@dataclass(frozen=True)
class Trip:
    """An interlock that stops the bench: its name, the value that tripped it, the limit, and a message with the remedy."""

    interlock: str
    value: float
    limit: float
    message: str


STALE_SAMPLES, LOST_SERVO = "stale samples", "lost servo"


def check_samples(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the DAQ has fallen silent."""
    limit = tolerances.samples_stale
    if now.sample_age <= limit:
        return None
    age = f"the latest sample is {1e3 * now.sample_age:.0f} ms old" if now.sample_age < math.inf else "no sample came"
    message = f"{age}, limit {1e3 * limit:.0f} ms; check the daq and its converter"
    return Trip(STALE_SAMPLES, now.sample_age, limit, message)


def check_servo_connection(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the servo node has fallen silent or has lost the motor."""
    limit = tolerances.servo_stale
    if not now.servo_age <= limit:
        age = f"the latest state is {1e3 * now.servo_age:.0f} ms old" if now.servo_age < math.inf else "no state came"
        return Trip(LOST_SERVO, now.servo_age, limit, f"{age}, limit {1e3 * limit:.0f} ms; check the servo node")
    if not now.servo_connected:
        return Trip(LOST_SERVO, 0.0, 1.0, "the motor does not answer; check its power and the serial line")
    return None


def check_servo_fault(now: Snapshot, _limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """Trip if the motor or its driver stopped for a fault."""
    return Trip("servo fault", 1.0, 0.0, now.servo_fault) if now.servo_fault else None


def check_setpoint(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the generator has fallen silent during an experiment."""
    limit = tolerances.setpoint_stale
    if now.setpoint_age <= limit:
        return None
    age = f"the latest setpoint is {1e3 * now.setpoint_age:.0f} ms old"
    return Trip("stale setpoint", now.setpoint_age, limit, f"{age}, limit {1e3 * limit:.0f} ms; check the generator")


def check_stroke(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """Trip if the rod has passed half of the margin that setpoints keep from either end of the stroke."""
    limit = limits.stroke / 2 - limits.margin / 2
    for sensor, value in (("LVDT", now.position), ("encoder", now.servo_position)):
        if abs(value) > limit or (sensor == "LVDT" and math.isnan(value)):
            message = (
                f"the rod is at {1e3 * value:.2f} mm by the {sensor}, limit ±{1e3 * limit:.2f} mm; home it, then reduce "
                "amplitude or offset"
            )
            return Trip("stroke", value, limit, message)
    return None


def check_lvdt_range(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """Trip if the LVDT reads a position that the damper cannot have. During homing this replaces `check_stroke`."""
    limit = limits.stroke / 2 + limits.margin
    if abs(now.position) <= limit:
        return None
    message = (
        f"the LVDT reads {1e3 * now.position:.2f} mm, the damper ends at ±{1e3 * limits.stroke / 2:.2f} mm; check the "
        "LVDT's wiring and calibration"
    )
    return Trip("stroke", now.position, limit, message)


def check_speed(now: Snapshot, limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the rod is faster than the setpoints may be."""
    limit = tolerances.overspeed * limits.speed
    for sensor, value in (("LVDT", now.speed), ("encoder", now.servo_speed)):
        if abs(value) > limit:
            message = (
                f"the rod moves at {1e3 * value:.0f} mm/s by the {sensor}, limit {1e3 * limit:.0f} mm/s; reduce amplitude "
                "or frequency, and check the servo's tuning"
            )
            return Trip("speed", value, limit, message)
    return None


def check_force(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """Trip if the force exceeds its limit."""
    if abs(now.force) <= limits.force:
        return None
    message = (
        f"{now.force:.0f} N on the load cell, limit ±{limits.force:.0f} N; reduce coil current or speed, or check the cell"
    )
    return Trip("force", now.force, limits.force, message)


def check_following_error(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the rod is too far from its setpoint."""
    limit = tolerances.following_error
    if abs(now.following_error) <= limit:
        return None
    message = (
        f"the rod is {1e3 * now.following_error:.2f} mm off its setpoint, limit ±{1e3 * limit:.2f} mm; look for something "
        "that blocks it, or reduce speed"
    )
    return Trip("following error", now.following_error, limit, message)


def check_current(now: Snapshot, limits: Limits, tolerances: Tolerances) -> Trip | None:
    """Trip if the coil current is outside the range of the setpoints."""
    lower, upper = limits.current_min - tolerances.current, limits.current_max + tolerances.current
    if lower <= now.current <= upper:
        return None
    message = (
        f"{now.current:.3f} A through the coil, allowed {lower:.3f} to {upper:.3f} A; check the coil supply, or tare the "
        "sensor at 0 A"
    )
    return Trip("current", now.current, lower if now.current < lower else upper, message)


Interlock = Callable[[Snapshot, Limits, Tolerances], Trip | None]

# The sources of the data are checked first: once they are silent, their last values mean nothing.
INTERLOCKS: tuple[Interlock, ...] = (
    check_samples,
    check_servo_connection,
    check_servo_fault,
    check_setpoint,
    check_stroke,
    check_speed,
    check_force,
    check_following_error,
    check_current,
)

# Homing brings the rod back from wherever it stands, so that it may begin beyond the limit of the stroke.
HOMING_INTERLOCKS: tuple[Interlock, ...] = tuple(
    check_lvdt_range if interlock is check_stroke else interlock for interlock in INTERLOCKS
)

# Conditions for the reset of a fault. A fault of the servo is reset together with the others.
RESET_INTERLOCKS: tuple[Interlock, ...] = (check_samples, check_servo_connection, check_speed, check_force, check_current)


def first_trip(
    now: Snapshot, limits: Limits, tolerances: Tolerances, interlocks: tuple[Interlock, ...] = INTERLOCKS
) -> Trip | None:
    """Return the first interlock that trips, or None."""
    trips = (interlock(now, limits, tolerances) for interlock in interlocks)
    return next((trip for trip in trips if trip is not None), None)
