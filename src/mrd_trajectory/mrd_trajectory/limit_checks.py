"""Checks of planned motion, current and force against the limits; a refusal names the limit and a remedy."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from mrd_base import InputError
from mrd_base.config import yaml_key
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import extremes, largest_magnitude
from mrd_trajectory.transition import TOLERANCE
from mrd_trajectory.waveforms import CHANNEL_UNITS, Waveform
from mrd_trajectory.waveforms.waveform import fields_in

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# The force is checked at this many instants per second, within these bounds.
_INSTANTS_PER_SECOND, _FEWEST_INSTANTS, _MOST_INSTANTS = 1000, 1000, 200_000


def check_position(waveform: Waveform, position: float, limits: Limits) -> None:
    """Check the largest distance of the rod from mid-stroke, in m."""
    if position > limits.reach * (1 + TOLERANCE):
        remedy = _reduce(waveform, "rod", limits.reach / position)
        raise _excess("rod: position", position * 1e3, limits.reach * 1e3, "mm", remedy, "±")


def check_slope(waveform: Waveform, speed: float, limits: Limits) -> None:
    """Check the largest slope of the lines of a waveform of the rod, in m/s."""
    if speed > limits.speed * (1 + TOLERANCE):
        remedy = _reduce(waveform, "rod", limits.speed / speed, "level/s")
        raise _excess("rod: speed", speed * 1e3, limits.speed * 1e3, "mm/s", remedy)


def check_rod(waveform: Waveform, path: PPoly, limits: Limits) -> None:
    """Check position, speed, acceleration and jerk of the rod."""
    check_position(waveform, largest_magnitude(path), limits)
    checks: list[tuple[str, float, str, float]] = [
        ("speed", limits.speed, "mm/s", 1e3),
        ("acceleration", limits.acceleration, "m/s²", 1.0),
        ("jerk", limits.jerk, "m/s³", 1.0),
    ]
    for derivative, (quantity, limit, unit, factor) in enumerate(checks, 1):
        value = largest_magnitude(path, derivative)
        if value > limit * (1 + TOLERANCE):
            raise _excess(f"rod: {quantity}", value * factor, limit * factor, unit, _slow_down(waveform, limit / value))


def check_coil(waveform: Waveform, path: PPoly, limits: Limits) -> None:
    """Check the current of the coil."""
    low, high = extremes(path)
    tolerance = TOLERANCE * limits.current_max
    if high > limits.current_max + tolerance:
        remedy = _reduce(waveform, "coil", limits.current_max / high)
        raise _excess("coil: current", high * 1e3, limits.current_max * 1e3, "mA", remedy)
    if low < limits.current_min - tolerance:
        keys = " or ".join(yaml_key(field, CHANNEL_UNITS["coil"])[0] for field in fields_in(waveform, "level"))
        raise InputError(
            f"coil: current {low * 1e3:.4g} mA is below {limits.current_min * 1e3:.4g} mA; change {keys} so that it is not"
        )


def force_limited(limits: Limits, envelope: ForceEnvelope, current: float) -> Limits:
    """Return limits whose speed also keeps the limit of the force at a current in A."""
    speed = float(envelope.speed(limits.force, current))
    # Where the current alone gives too much force, `check_force` refuses the experiment.
    return dataclasses.replace(limits, speed=min(speed, limits.speed)) if speed > 0 else limits


def check_force(
    experiment: Experiment, rod: PPoly, coil: PPoly, limits: Limits, envelope: ForceEnvelope, *, speed_is_chosen: bool
) -> float:
    """Check the largest force to expect in a pass, and return it in N.

    With ``speed_is_chosen``, the plan chooses the speed of the rod, so that a slower waveform is no remedy.
    """
    count = int(np.clip(_INSTANTS_PER_SECOND * experiment.duration, _FEWEST_INSTANTS, _MOST_INSTANTS))
    times = np.unique(np.concatenate([np.linspace(0, experiment.duration, count), rod.x, coil.x]))
    # The larger value at both ends of each interval; at its end, the current before a step there.
    speeds, before_step = np.abs(rod(times, 1)), np.abs(coil(np.nextafter(times[1:], 0)))
    speed, current = np.maximum(speeds[:-1], speeds[1:]), np.maximum(np.abs(coil(times[:-1])), before_step)
    force = envelope.force(speed, current)
    worst = int(force.argmax())
    if force[worst] <= limits.force * (1 + TOLERANCE):
        return float(force[worst])

    with_current, moving = current > 0, speed > 0
    current_factor = (envelope.current(limits.force, speed[with_current]) / current[with_current]).min(initial=np.inf)
    speed_factor = (envelope.speed(limits.force, current[moving]) / speed[moving]).min(initial=np.inf)
    remedies = []
    if 0 < current_factor < 1:
        remedies.append(_reduce(experiment.coil, "coil", float(current_factor)))
    if 0 < speed_factor < 1 and not speed_is_chosen:
        remedies.append(_slow_down(experiment.rod, float(speed_factor)))
    raise _excess(
        f"expected force at {times[worst]:.4g} s ({speed[worst] * 1e3:.4g} mm/s, {current[worst] * 1e3:.4g} mA)",
        force[worst],
        limits.force,
        "N",
        ", or ".join(remedies) or "raise limits.force_N if load cell and drive bear it",
    )


def _excess(quantity: str, value: float, limit: float, unit: str, remedy: str, sign: str = "") -> InputError:
    """Return the error about a value above its limit, with as many digits as show that it is above."""
    texts = [f"{value:.{digits}g}" for digits in (4, 6, 9, 17)]
    shown = next((text for text in texts if float(text) > float(f"{limit:.4g}")), texts[-1])
    return InputError(f"{quantity} {sign}{shown} {unit} exceeds {sign}{limit:.4g} {unit}; {remedy}")


def _rounded_down(value: float) -> float:
    """Return the value with its magnitude rounded down to four digits."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 3)
    return math.copysign(math.floor(abs(value) / unit + 1e-9) * unit, value)


def _reduce(waveform: Waveform, channel: str, factor: float, unit: str = "level") -> str:
    """Return the remedy that reduces the levels (or slopes) of a waveform by a factor."""
    changes = []
    for field in fields_in(waveform, unit):
        key, to_si = yaml_key(field, CHANNEL_UNITS[channel])
        value = getattr(waveform, field.name)
        if isinstance(value, tuple):
            changes.append(f"{key} by the factor {_rounded_down(factor):.4g}")
        elif value:
            changes.append(f"{key} from {value / to_si:.6g} to {_rounded_down(factor * value / to_si):.4g}")
    return "reduce " + " and ".join(changes)


def _slow_down(waveform: Waveform, factor: float) -> str:
    """Return the remedy that reduces the speed of the rod by a factor."""
    if fields_in(waveform, "level/s"):
        return _reduce(waveform, "rod", factor, "level/s")
    remedy = _reduce(waveform, "rod", factor)
    frequencies = " and ".join(yaml_key(field)[0] for field in fields_in(waveform, "Hz"))
    return remedy + (f", or lower {frequencies}" if frequencies else "")
