"""A lamp for each interlock, by the same checks as the supervisor's.

The lamps only show. The supervisor alone stops the bench, by what it hears itself.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from mrd_base.lease import Mode
from mrd_base.quantities import ZERO_CELSIUS
from mrd_bench_driver.supervision.interlocks import CONTROL_INTERLOCKS, HOMING_INTERLOCKS, Tolerances
from mrd_bench_driver.supervision.snapshot import Snapshot
from mrd_trajectory.limits import Limits

Status = Literal["ok", "warning", "tripped"]


@dataclass(frozen=True)
class Lamp:
    """An interlock, as the page shows it.

    Attributes
    ----------
    name : str
        Name of the interlock.
    status : {"ok", "warning", "tripped"}
        ``tripped``: it has stopped the bench; ``warning``: it would, if the rod were to move now.
    value, limit : str
        Present value and limit with their unit; empty for an interlock without a number.
    cause, remedy : str
        What was found and what to do; empty while all is well.
    """

    name: str
    status: Status
    value: str = ""
    limit: str = ""
    cause: str = ""
    remedy: str = ""


Reading = Callable[[Snapshot, Limits, Tolerances], tuple[str, str]]


def _milliseconds(age: float, limit: float) -> tuple[str, str]:
    return f"{max(0.0, 1e3 * age):.0f} ms" if math.isfinite(age) else "none", f"{1e3 * limit:.0f} ms"


def _state(problem: object) -> tuple[str, str]:
    return "stopped" if problem else "works", ""


def _millimetres(value: float, limit: float) -> tuple[str, str]:
    return f"{1e3 * value:.2f} mm" if math.isfinite(value) else "none", f"±{1e3 * limit:g} mm"


# Value and limit of each interlock.
READINGS: dict[str, Reading] = {
    "daq fault": lambda now, _limits, _t: _state(now.daq_problem),
    "stale samples": lambda now, _limits, t: _milliseconds(now.sample_age, t.samples_stale),
    "lost servo": lambda now, _limits, t: _milliseconds(now.servo_age, t.servo_stale),
    "servo fault": lambda now, _limits, _t: _state(now.servo.fault or now.servo.stopped),
    "stale setpoint": lambda now, _limits, t: _milliseconds(now.setpoint_age, t.setpoint_stale),
    "position sensors": lambda now, _limits, t: _millimetres(now.position_difference, t.position_difference),
    "stroke": lambda now, limits, _t: _millimetres(now.position, limits.stroke / 2 - limits.margin / 2),
    "speed": lambda now, limits, t: (f"{1e3 * abs(now.speed):.0f} mm/s", f"{1e3 * t.overspeed * limits.speed:.0f} mm/s"),
    "force": lambda now, limits, _t: (f"{now.force:.0f} N", f"±{limits.force:.0f} N"),
    "following error": lambda now, _limits, t: _millimetres(now.servo.following_error, t.following_error),
    "current": lambda now, limits, t: (
        f"{now.current:.3f} A",
        f"{limits.current_min - t.current:g} to {limits.current_max + t.current:g} A",
    ),
    "temperature": lambda now, _limits, t: (
        f"{now.temperature - ZERO_CELSIUS:.1f} °C" if math.isfinite(now.temperature) else "none",
        f"{t.temperature_max:g} °C",
    ),
    "power": lambda now, _limits, t: (f"{now.power:.0f} W", f"±{t.power:g} W"),
    "energy balance": lambda now, _limits, t: (f"{now.work:.1f} J", f"≥ {-t.energy:g} J"),
}


def lamps(now: Snapshot, limits: Limits, tolerances: Tolerances, mode: Mode, reason: str) -> list[Lamp]:
    """Return a lamp for each interlock; none for the temperature where there is no sensor.

    Parameters
    ----------
    now : Snapshot
        State of the bench.
    limits, tolerances : Limits, Tolerances
        As the supervisor has them.
    mode, reason : Mode, str
        Mode of the bench and its reason. In a fault, the interlock that has tripped is named by the reason, and keeps its
        lamp until the reset although its value may be within the limit again.
    """
    # Power and energy balance are zero but in a hybrid test.
    checks = HOMING_INTERLOCKS if mode is Mode.HOMING else CONTROL_INTERLOCKS
    found = []
    for name, reading in READINGS.items():
        if name == "temperature" and not now.has_thermometer:
            continue
        value, limit = reading(now, limits, tolerances)
        latched = f"interlock {name}: "
        tripped = mode is Mode.FAULT and reason.startswith(latched)
        message = (
            reason.removeprefix(latched) if tripped else checks[name](now, limits, tolerances) if name in checks else ""
        )
        cause, _, remedy = message.partition("; ")
        status: Status = "tripped" if tripped else "warning" if message else "ok"
        found.append(Lamp(name, status, value, limit, cause, remedy))
    return found
