"""When the bench must stop: pure functions of what is known at one instant."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from mrd_base import quantity
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class Tolerances:
    """How far readings may pass the limits that setpoints keep; the section ``interlocks`` of bench.yaml."""

    overspeed: float = quantity(1.25, doc="measured speed, as a multiple of limits.speed", lower=1, upper=3)
    current: float = quantity(0.1, "A", "measured coil current beyond limits.current", lower=0, upper=2)
    following_error: float = quantity(0.005, "mm", "setpoint minus rod position", lower=1e-5, upper=0.1)
    samples_stale: float = quantity(0.14, "ms", "age of the latest sample", lower=0.08, upper=1)
    servo_stale: float = quantity(0.15, "ms", "age of the latest servo_state", lower=0.02, upper=1)
    setpoint_stale: float = quantity(0.15, "ms", "age of the latest setpoint of an experiment", lower=0.02, upper=1)


@dataclass(frozen=True)
class Snapshot:
    """What is known of the bench at one instant; nan where a value has not been heard yet.

    Attributes
    ----------
    sample_age : float
        Age in s of the latest sample (inf: none).
    position, force : float
        Value farthest from 0 in the latest block; m, N.
    speed, current : float
        Of the rod in m/s by the samples, and of the coil in A, over the latest block.
    servo_age : float
        Age in s of the latest servo state (inf: none).
    servo_connected : bool
        The serial line answers.
    servo_fault : str
        The servo's fault in one line, or empty.
    servo_position : float
        m, by the encoder; nan unless it refers to mid-stroke.
    servo_speed, following_error : float
        m/s, m.
    setpoint_age : float
        Age in s of the latest setpoint while an experiment runs, else 0.
    """

    sample_age: float = math.inf
    position: float = math.nan
    force: float = math.nan
    speed: float = math.nan
    current: float = math.nan
    servo_age: float = math.inf
    servo_connected: bool = False
    servo_fault: str = ""
    servo_position: float = math.nan
    servo_speed: float = math.nan
    following_error: float = math.nan
    setpoint_age: float = 0.0


@dataclass(frozen=True)
class Trip:
    """An interlock that stops the bench."""

    interlock: str
    value: float
    limit: float
    line: str


def stale_samples(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The DAQ has gone silent."""
    limit = tolerances.samples_stale
    if now.sample_age <= limit:
        return None
    heard = f"the latest sample is {1e3 * now.sample_age:.0f} ms old" if now.sample_age < math.inf else "no sample came"
    return Trip(
        "stale samples", now.sample_age, limit, f"{heard}, limit {1e3 * limit:.0f} ms; check the daq and its converter"
    )


def lost_servo(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The servo node or its serial line has gone silent."""
    limit = tolerances.servo_stale
    if not now.servo_age <= limit:
        heard = f"the latest state is {1e3 * now.servo_age:.0f} ms old" if now.servo_age < math.inf else "no state came"
        return Trip("lost servo", now.servo_age, limit, f"{heard}, limit {1e3 * limit:.0f} ms; check the servo node")
    if not now.servo_connected:
        return Trip("lost servo", 0.0, 1.0, "the motor does not answer; check its power and the serial line")
    return None


def servo_fault(now: Snapshot, _limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """The motor or its driver stopped for a fault of its own."""
    return Trip("servo fault", 1.0, 0.0, now.servo_fault) if now.servo_fault else None


def stroke(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """The rod has used up half of the margin that setpoints keep from either end."""
    limit = limits.stroke / 2 - limits.margin / 2
    for sensor, value in (("LVDT", now.position), ("encoder", now.servo_position)):
        if abs(value) > limit or (sensor == "LVDT" and math.isnan(value)):
            return Trip(
                "stroke",
                value,
                limit,
                f"the rod is at {1e3 * value:.2f} mm by the {sensor}, limit ±{1e3 * limit:.2f} mm; home it, "
                "then reduce amplitude or offset",
            )
    return None


def ends(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """The rod is said to be where the damper cannot be; homing may begin anywhere else."""
    limit = limits.stroke / 2 + limits.margin
    if abs(now.position) <= limit:
        return None
    return Trip(
        "stroke",
        now.position,
        limit,
        f"the LVDT says {1e3 * now.position:.2f} mm, the damper ends at ±{1e3 * limits.stroke / 2:.2f} mm; check the LVDT's "
        "wiring and calibration",
    )


def speed(now: Snapshot, limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The rod is faster than any setpoint may ask."""
    limit = tolerances.overspeed * limits.speed
    for sensor, value in (("LVDT", now.speed), ("encoder", now.servo_speed)):
        if abs(value) > limit:
            return Trip(
                "speed",
                value,
                limit,
                f"the rod moves at {1e3 * value:.0f} mm/s by the {sensor}, limit {1e3 * limit:.0f} mm/s; reduce "
                "amplitude or frequency, and check the servo's tuning",
            )
    return None


def force(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> Trip | None:
    """The load cell is loaded beyond its limit."""
    if abs(now.force) <= limits.force:
        return None
    return Trip(
        "force",
        now.force,
        limits.force,
        f"{now.force:.0f} N on the load cell, limit ±{limits.force:.0f} N; reduce coil current or speed, or check the cell",
    )


def following_error(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The rod is not where it was asked to be."""
    limit = tolerances.following_error
    if abs(now.following_error) <= limit:
        return None
    return Trip(
        "following error",
        now.following_error,
        limit,
        f"the rod is {1e3 * now.following_error:.2f} mm off its setpoint, limit ±{1e3 * limit:.2f} mm; "
        "look for something that blocks it, or reduce speed",
    )


def current(now: Snapshot, limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The coil carries more than any setpoint may ask."""
    lower, upper = limits.current_min - tolerances.current, limits.current_max + tolerances.current
    if lower <= now.current <= upper:
        return None
    limit = lower if now.current < lower else upper
    return Trip(
        "current",
        now.current,
        limit,
        f"{now.current:.3f} A through the coil, allowed {lower:.3f} to {upper:.3f} A; check the coil supply, or tare "
        "the sensor at 0 A",
    )


def stale_setpoint(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> Trip | None:
    """The generator went silent in the middle of an experiment."""
    limit = tolerances.setpoint_stale
    if now.setpoint_age <= limit:
        return None
    return Trip(
        "stale setpoint",
        now.setpoint_age,
        limit,
        f"the latest setpoint is {1e3 * now.setpoint_age:.0f} ms old, limit {1e3 * limit:.0f} ms; check the generator",
    )


Interlock = Callable[[Snapshot, Limits, Tolerances], Trip | None]

# What is wrong with the sources comes first: what they said last means nothing.
INTERLOCKS: tuple[Interlock, ...] = (
    stale_samples,
    lost_servo,
    servo_fault,
    stale_setpoint,
    stroke,
    speed,
    force,
    following_error,
    current,
)

# Homing brings the rod back from wherever it stands.
HOMING: tuple[Interlock, ...] = tuple(ends if interlock is stroke else interlock for interlock in INTERLOCKS)

# What must be well before a fault may be reset; a fault of the servo is reset together with the rest.
HEALTH: tuple[Interlock, ...] = (stale_samples, lost_servo, speed, force, current)


def check(
    now: Snapshot, limits: Limits, tolerances: Tolerances, interlocks: tuple[Interlock, ...] = INTERLOCKS
) -> Trip | None:
    """The first interlock that trips, or None when all is well."""
    for interlock in interlocks:
        trip = interlock(now, limits, tolerances)
        if trip is not None:
            return trip
    return None
