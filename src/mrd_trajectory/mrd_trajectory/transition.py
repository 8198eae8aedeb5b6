"""Transitions between two states of the rod under limits: linear, cubic and quintic.

All three keep position, velocity and acceleration continuous:

- ``linear``: constant speed, with corners rounded by pieces of constant jerk (double-S profile; Biagiotti & Melchiorri,
  *Trajectory Planning for Automatic Machines and Robots*, 2008, §3.4);
- ``cubic``: a cubic spline of three pieces, which take a quarter, a half and a quarter of the time;
- ``quintic``: one polynomial of fifth order (minimum jerk from rest to rest; Flash & Hogan 1985).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy

from mrd_base import InputError
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import MotionState, concatenate, constant_jerk_path, largest_magnitude, quintic_hermite

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# Relative excess over a limit that rounding errors may cause.
TOLERANCE = 1e-6

# Peaks of speed, acceleration and jerk from rest to rest, for distance 1 in time 1.
_REST_TO_REST_PEAKS = {"cubic": (2.0, 8.0, 32.0), "quintic": (15 / 8, 10 / np.sqrt(3), 60.0)}
# Peaks of acceleration and jerk of a change of speed by 1 in time 1, without acceleration at its ends.
_CORNER_PEAKS = {"cubic": (4 / 3, 16 / 3), "quintic": (1.5, 6.0)}

KINDS = ("linear", "cubic", "quintic")


def transition(kind: str, start: MotionState, end: MotionState, limits: Limits) -> PPoly:
    """Return a path from one state to another, as short as the kind and the limits allow.

    From rest to rest the duration is minimal. Otherwise it is the shortest duration that a fine search finds.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    start, end : MotionState
        States within the limits.
    limits : Limits

    Returns
    -------
    PPoly
        A path from time 0; it has no duration when both states are the same.

    Raises
    ------
    InputError
        When no path of this kind keeps the limits.
    """
    if np.allclose(start, end, rtol=0, atol=(1e-9, 1e-7, 1e-5)):
        return constant_jerk_path(start, [0.0], [0.0])
    if kind == "linear":
        path = _linear(start, end, limits)
        if not _within(path, start, end, limits):
            raise _impossible(kind, start, end)
        return path
    interpolate = _INTERPOLATIONS[kind]
    distance = abs(end.position - start.position)
    if start[1:] == end[1:] == (0.0, 0.0):
        speed, acceleration, jerk = _REST_TO_REST_PEAKS[kind]
        duration = max(
            speed * distance / limits.speed,
            (acceleration * distance / limits.acceleration) ** (1 / 2),
            (jerk * distance / limits.jerk) ** (1 / 3),
        )
    else:
        duration = _shortest_duration(kind, start, end, limits)
    return interpolate(duration, start, end)


def _shortest_duration(kind: str, start: MotionState, end: MotionState, limits: Limits) -> float:
    """Return the shortest duration in s in which a path keeps the limits, to 1e-4 of it."""
    interpolate = _INTERPOLATIONS[kind]

    def keeps_limits(duration: float) -> bool:
        return _within(interpolate(duration, start, end), start, end, limits)

    lower_bound = max(
        1e-3,
        abs(end.position - start.position) / limits.speed,
        abs(end.velocity - start.velocity) / limits.acceleration,
        abs(end.acceleration - start.acceleration) / limits.jerk,
    )
    # The search starts from below, because a longer path may swing further and break a limit again.
    step = 1.02
    duration = next((trial for trial in lower_bound * step ** np.arange(300) if keeps_limits(trial)), None)
    if duration is None:
        raise _impossible(kind, start, end)
    low, high = float(duration / step), float(duration)
    while high - low > 1e-4 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if keeps_limits(middle) else (middle, high)
    return high


def corner(kind: str, before: float, after: float, limits: Limits) -> PPoly:
    """Return the change of velocity that rounds the corner between two straight lines.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    before, after : float
        Slopes of the lines in m/s.

    Returns
    -------
    PPoly
        A path from time 0 and position 0. It leaves the first line half of its duration before the corner, and meets the
        second line half of its duration after it.
    """
    change = abs(after - before)
    if change < 1e-9:
        return constant_jerk_path(MotionState(0.0, before), [0.0], [0.0])
    if kind == "linear":
        return constant_jerk_path(MotionState(0.0, before), *_speed_change(before, after, limits))
    acceleration, jerk = _CORNER_PEAKS[kind]
    duration = max(acceleration * change / limits.acceleration, (jerk * change / limits.jerk) ** (1 / 2))
    return _INTERPOLATIONS[kind](duration, MotionState(0.0, before), MotionState((before + after) / 2 * duration, after))


def _impossible(kind: str, start: MotionState, end: MotionState) -> InputError:
    def show(state: MotionState) -> str:
        return f"{state.position * 1e3:.4g} mm at {state.velocity * 1e3:.4g} mm/s and {state.acceleration:.3g} m/s²"

    return InputError(f"no {kind} transition from {show(start)} to {show(end)} keeps the limits")


def _within(path: PPoly, start: MotionState, end: MotionState, limits: Limits) -> bool:
    reach = max(limits.reach, abs(start.position), abs(end.position))
    bounds = (reach, limits.speed, limits.acceleration, limits.jerk)
    # The jerk first, because it is what a path that is much too short breaks, and the quickest to compute.
    return all(largest_magnitude(path, n) <= (1 + TOLERANCE) * bounds[n] for n in (3, 2, 1, 0))


def _quintic(duration: float, start: MotionState, end: MotionState) -> PPoly:
    return quintic_hermite(np.array([0.0, duration]), *np.array([start, end]).T)


def _cubic(duration: float, start: MotionState, end: MotionState) -> PPoly:
    pieces = duration * np.array([0.25, 0.5, 0.25])
    remaining = duration * np.array([1.0, 0.75, 0.25, 0.0])
    # Effect of a unit jerk in each piece on acceleration, velocity and position at the end.
    effect = np.array([-np.diff(remaining**n) / (1, 2, 6)[n - 1] for n in (1, 2, 3)])
    x, v, a = start
    wanted = [end.acceleration - a, end.velocity - v - a * duration, end.position - x - v * duration - a * duration**2 / 2]
    # Without this scaling of the rows, the system looks singular for short durations.
    scale = duration ** np.array([1.0, 2.0, 3.0])
    return constant_jerk_path(start, list(pieces), list(np.linalg.solve(effect / scale[:, None], wanted / scale)))


_INTERPOLATIONS: dict[str, Callable[[float, MotionState, MotionState], PPoly]] = {"cubic": _cubic, "quintic": _quintic}


def _speed_change(before: float, after: float, limits: Limits) -> tuple[list[float], list[float]]:
    """Return durations and jerks of the shortest change of velocity between two states without acceleration."""
    change = abs(after - before)
    jerk = float(np.copysign(limits.jerk, after - before))
    rounding = min(limits.acceleration / limits.jerk, (change / limits.jerk) ** 0.5)
    steady = max(0.0, change / limits.acceleration - rounding) if change else 0.0
    return [rounding, steady, rounding], [jerk, 0.0, -jerk]


def _linear(start: MotionState, end: MotionState, limits: Limits) -> PPoly:
    """Return a change to a cruising speed, a cruise, and a change to the final speed; the end accelerations are ramped."""
    first_ramp = _ramp_off(start, limits)
    # The ramp before the end is computed backwards in time, where velocity and jerk change their sign.
    backwards = _ramp_off(MotionState(end.position, -end.velocity, end.acceleration), limits)
    ramp_duration = float(backwards.x[-1])
    first_position, first_velocity = (float(first_ramp(first_ramp.x[-1], derivative)) for derivative in (0, 1))
    last_position, last_velocity = float(backwards(ramp_duration)), -float(backwards(ramp_duration, 1))
    distance = last_position - first_position

    def cruising(speed: float, duration: float = 0.0) -> PPoly:
        times, jerks = _speed_change(first_velocity, speed, limits)
        last_times, last_jerks = _speed_change(speed, last_velocity, limits)
        start = MotionState(first_position, first_velocity)
        return constant_jerk_path(start, [*times, duration, *last_times], [*jerks, 0.0, *last_jerks])

    def travel(speed: float) -> float:
        path = cruising(speed)
        return float(path(path.x[-1])) - first_position

    top = limits.speed
    if distance >= travel(top):
        middle = cruising(top, (distance - travel(top)) / top)
    elif distance <= travel(-top):
        middle = cruising(-top, (travel(-top) - distance) / top)
    else:
        middle = cruising(scipy.optimize.brentq(lambda speed: travel(speed) - distance, -top, top, xtol=1e-15, rtol=1e-15))
    jerk = float(np.copysign(limits.jerk, end.acceleration))
    last_ramp = constant_jerk_path(MotionState(last_position, last_velocity), [ramp_duration], [jerk])
    return concatenate([first_ramp, middle, last_ramp])


def _ramp_off(state: MotionState, limits: Limits) -> PPoly:
    """Return the path on which the acceleration of a state goes to zero."""
    return constant_jerk_path(
        state, [abs(state.acceleration) / limits.jerk], [-np.copysign(limits.jerk, state.acceleration)]
    )
