"""The interlocks: when the bench must stop, as pure functions of its state at one instant.

Each interlock returns a message with value, limit and remedy if it trips, else "".
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_base.quantities import ZERO_CELSIUS
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_trajectory.limits import Limits

# Lowest and highest degC that a damper can have: oils and seals freeze or burn beyond. What reads more is no damper.
_POSSIBLE = (-60.0, 220.0)
# Why the time of one node may differ from that of another, and what helps.
_CLOCK = "the machine's clock was set after one node and before another was started: restart the bench"


@dataclass(frozen=True)
class Tolerances:
    """Margins by which readings may exceed the limits of the setpoints; section ``interlocks`` of bench.yaml."""

    overspeed: float = quantity(1.25, doc="measured speed, as a multiple of limits.speed", lower=1, upper=3)
    current: float = quantity(0.1, "A", "measured coil current beyond limits.current", lower=0, upper=2)
    following_error: float = quantity(0.005, "mm", "setpoint minus rod position", lower=1e-5, upper=0.1)
    position_difference: float = quantity(0.002, "mm", "LVDT minus encoder of a homed rod", lower=1e-4, upper=0.1)
    temperature_max: float = quantity(
        71.0, "degC", "highest temperature of the damper, where there is a sensor", lower=-60, upper=220
    )
    start_temperature_low: float = quantity(
        0.0, "degC", "lowest temperature of the damper at which a run starts", lower=-60, upper=220
    )
    start_temperature_high: float = quantity(
        60.0, "degC", "highest temperature of the damper at which a run starts", lower=-60, upper=220
    )
    samples_stale: float = quantity(0.14, "ms", "age of the latest sample", lower=0.08, upper=1)
    servo_stale: float = quantity(0.15, "ms", "age of the latest servo_state", lower=0.02, upper=1)
    setpoint_stale: float = quantity(0.15, "ms", "age of the latest setpoint of an experiment", lower=0.02, upper=1)
    power: float = quantity(120.0, "W", "mean power that the rod puts into the damper in a cycle of a hybrid test", lower=1)
    energy: float = quantity(
        2.0,
        "J",
        "energy that the damper of a hybrid test may seem to give in half a second, more than it can store",
        lower=0.01,
    )

    def __post_init__(self) -> None:
        low, high, most = self.start_temperature_low, self.start_temperature_high, self.temperature_max
        if not low < high <= most:
            raise InputError(
                f"start_temperature_low_degC is {low:g}, start_temperature_high_degC {high:g} and temperature_max_degC "
                f"{most:g}, expected the first below the second, and that at most the third"
            )


@dataclass(frozen=True)
class Trip:
    """An interlock that stops the bench."""

    interlock: str
    message: str


def _stale(name: str, age: float, limit: float, remedy: str) -> str:
    # An age of nan is stale, too, and so is one in the future: it would hide for how long its source is silent.
    if abs(age) <= limit:
        return ""
    if age < 0:
        return f"the latest {name} lies {-age:.3g} s in the future, limit {1e3 * limit:.0f} ms; {_CLOCK}"
    finding = f"the latest {name} is {1e3 * age:.0f} ms old" if age < math.inf else f"no {name} came"
    return f"{finding}, limit {1e3 * limit:.0f} ms; {remedy}"


def check_daq(now: Snapshot, _limits: Limits, _tolerances: Tolerances) -> str:
    """Trip if the DAQ has stopped for a fault or an emergency stop."""
    return now.daq_problem


def check_samples(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the DAQ has fallen silent."""
    return _stale("sample", now.sample_age, tolerances.samples_stale, "check the daq and its converter")


def check_servo_connection(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the servo node has fallen silent or has lost the motor."""
    message = _stale("state", now.servo_age, tolerances.servo_stale, "check the servo node")
    if message or now.servo.connected:
        return message
    return "the motor does not answer; check its power and the serial line"


def check_servo_fault(now: Snapshot, _limits: Limits, _tolerances: Tolerances) -> str:
    """Trip if the motor or its driver stopped for a fault or an emergency stop."""
    if now.servo.fault:
        return now.servo.message or "the motor or its driver stopped"
    return (now.servo.message or "its emergency stop is latched") if now.servo.stopped else ""


def check_setpoint(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the generator, or the controller, has fallen silent during an experiment."""
    remedy, lag = f"check the {now.setpoint_source}", now.setpoint_lag
    if lag:
        when = "before" if lag > 0 else "after"
        remedy = (
            f"those of the {now.setpoint_source} are stamped {abs(lag):.3g} s {when} they come, so that servo or daq "
            f"do not follow them; {_CLOCK}"
        )
    return _stale("setpoint", now.setpoint_age, tolerances.setpoint_stale, remedy)


def check_position_sensors(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if LVDT and encoder of a homed rod disagree: one of them is wrong, or the pinion has slipped."""
    limit = tolerances.position_difference
    # Without a position of the encoder at the time of the samples, the difference is nan.
    if not abs(now.position_difference) > limit:
        return ""
    return (
        f"LVDT and encoder disagree by {1e3 * now.position_difference:.2f} mm, limit ±{1e3 * limit:g} mm; check the LVDT's "
        "wiring, the encoder, and whether the pinion slips, then home again"
    )


def check_stroke(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> str:
    """Trip if the rod has passed half of the margin that setpoints keep from either end of the stroke."""
    limit = limits.stroke / 2 - limits.margin / 2
    encoder = now.servo.position if now.servo.homed else 0.0
    for sensor, value in (("LVDT", now.position), ("encoder", encoder)):
        if abs(value) > limit or (sensor == "LVDT" and math.isnan(value)):
            return (
                f"the rod is at {1e3 * value:.2f} mm by the {sensor}, limit ±{1e3 * limit:.2f} mm; home it, then reduce "
                "amplitude or offset"
            )
    return ""


def check_lvdt_range(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> str:
    """Trip if the LVDT reads a position that the damper cannot have. During homing this replaces `check_stroke`."""
    if abs(now.position) <= limits.stroke / 2 + limits.margin:
        return ""
    return (
        f"the LVDT reads {1e3 * now.position:.2f} mm, the damper ends at ±{1e3 * limits.stroke / 2:.2f} mm; check the "
        "LVDT's wiring and calibration"
    )


def check_speed(now: Snapshot, limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the rod is faster than the setpoints may be."""
    limit = tolerances.overspeed * limits.speed
    for sensor, value in (("LVDT", now.speed), ("encoder", now.servo.velocity)):
        if abs(value) > limit:
            return (
                f"the rod moves at {1e3 * value:.0f} mm/s by the {sensor}, limit {1e3 * limit:.0f} mm/s; reduce amplitude "
                "or frequency, and check the servo's tuning"
            )
    return ""


def check_force(now: Snapshot, limits: Limits, _tolerances: Tolerances) -> str:
    """Trip if the force exceeds its limit."""
    if abs(now.force) <= limits.force:
        return ""
    return (
        f"{now.force:.0f} N on the load cell, limit ±{limits.force:.0f} N; reduce coil current or speed, or check the cell"
    )


def check_following_error(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the rod is too far from its setpoint."""
    limit = tolerances.following_error
    if not now.servo.homed or abs(now.servo.following_error) <= limit:
        return ""
    return (
        f"the rod is {1e3 * now.servo.following_error:.2f} mm off its setpoint, limit ±{1e3 * limit:.2f} mm; look for "
        "something that blocks it, or reduce speed"
    )


def check_current(now: Snapshot, limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the coil current is outside the range of the setpoints."""
    lower, upper = limits.current_min - tolerances.current, limits.current_max + tolerances.current
    if lower <= now.current <= upper:
        return ""
    return (
        f"{now.current:.3f} A through the coil, allowed {lower:.3f} to {upper:.3f} A; check the coil supply, or tare the "
        "sensor at 0 A"
    )


def check_temperature(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the damper is too hot, or if its thermometer cannot be right; without one there is nothing to check."""
    highest = tolerances.temperature_max
    return _unreadable_temperature(now, tolerances) or _outside(now, -math.inf, highest, "let it cool down")


def check_start_temperature(now: Snapshot, tolerances: Tolerances) -> str:
    """Return why a run may not start at the damper's temperature, or ""."""
    low, high = tolerances.start_temperature_low, tolerances.start_temperature_high
    remedy = "wait, or change start_temperature_low_degC and start_temperature_high_degC"
    return _unreadable_temperature(now, tolerances) or _outside(now, low, high, remedy)


def _unreadable_temperature(now: Snapshot, tolerances: Tolerances) -> str:
    celsius = now.temperature - ZERO_CELSIUS
    if not now.has_thermometer or _POSSIBLE[0] <= celsius <= _POSSIBLE[1]:
        return ""
    found = "is at the end of its range" if math.isnan(celsius) else f"reads {celsius:.0f} degC, which no damper has"
    return (
        f"the damper's thermometer {found}, so that the limit of {tolerances.temperature_max:g} degC cannot be watched; "
        'check the sensor, its amplifier and wiring; if there is none, set channels.temperature.input: ""'
    )


def _outside(now: Snapshot, low: float, high: float, remedy: str) -> str:
    celsius = now.temperature - ZERO_CELSIUS
    if not now.has_thermometer or low <= celsius <= high:
        return ""
    limit = f"limit {high:g} degC" if low == -math.inf else f"allowed {low:g} to {high:g} degC"
    return f"the damper has {celsius:.1f} degC, {limit}; {remedy}"


def check_power(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the damper of a hybrid test takes too much power."""
    if abs(now.power) <= tolerances.power:
        return ""
    return f"the rod puts {now.power:.0f} W into the damper, limit {tolerances.power:g} W; reduce the excitation"


def check_energy(now: Snapshot, _limits: Limits, tolerances: Tolerances) -> str:
    """Trip if the damper of a hybrid test seems to give energy: the late rod feeds the loop, which becomes unstable."""
    if now.work >= -tolerances.energy:
        return ""
    return (
        f"the damper seems to have given {-now.work:.1f} J within half a second, limit {tolerances.energy:g} J; the hybrid "
        "loop is becoming unstable: compensate the delay, reduce the largest current, or emulate larger masses"
    )


Interlocks = Mapping[str, Callable[[Snapshot, Limits, Tolerances], str]]

STALE_SAMPLES, LOST_SERVO = "stale samples", "lost servo"

# The sources of the data are checked first: once they are silent, their last values mean nothing. What they say comes before
# their silence. Next come the sensors that can be compared: what a broken one reads is no speed or stroke.
INTERLOCKS: Interlocks = {
    "daq fault": check_daq,
    STALE_SAMPLES: check_samples,
    LOST_SERVO: check_servo_connection,
    "servo fault": check_servo_fault,
    "stale setpoint": check_setpoint,
    "position sensors": check_position_sensors,
    "stroke": check_stroke,
    "speed": check_speed,
    "force": check_force,
    "following error": check_following_error,
    "current": check_current,
    "temperature": check_temperature,
}

# A hybrid test has limits of its own, which a rod that follows a plan cannot reach unseen.
CONTROL_INTERLOCKS: Interlocks = {**INTERLOCKS, "power": check_power, "energy balance": check_energy}

# Homing brings the rod back from wherever it stands, so that it may begin beyond the limit of the stroke. It sets the
# encoder by the LVDT, with a comparison of its own.
HOMING_INTERLOCKS: Interlocks = {
    **{name: check for name, check in INTERLOCKS.items() if check is not check_position_sensors},
    "stroke": check_lvdt_range,
}

# Conditions for the reset of a fault. A fault of the servo is reset together with the others.
RESET_INTERLOCKS: Interlocks = {name: INTERLOCKS[name] for name in (STALE_SAMPLES, LOST_SERVO, "speed", "force", "current")}


def first_trip(now: Snapshot, limits: Limits, tolerances: Tolerances, interlocks: Interlocks = INTERLOCKS) -> Trip | None:
    """Return the first interlock that trips, or None."""
    messages = ((name, check(now, limits, tolerances)) for name, check in interlocks.items())
    return next((Trip(name, message) for name, message in messages if message), None)
