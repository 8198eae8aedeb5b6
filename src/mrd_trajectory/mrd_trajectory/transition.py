"""Transitions between setpoints: linear, cubic-spline and quintic interpolation under limits.

All three keep position, velocity and acceleration continuous:

- ``linear``: constant speed, its corners rounded by pieces of constant jerk (double-S profile; Biagiotti & Melchiorri,
  *Trajectory Planning for Automatic Machines and Robots*, 2008, §3.4);
- ``cubic``: a cubic spline of three pieces that last a quarter, a half and a quarter of the time;
- ``quintic``: one polynomial of fifth order (minimum jerk between rests; Flash & Hogan 1985).
"""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import PPoly
from scipy.optimize import brentq

from mrd_base import InputError
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import State, from_jerk, hermite, joined, largest

# Rounding may carry a peak this far, relatively, beyond the limit that the duration was made for.
TOLERANCE = 1e-6

# Peaks between rests for distance 1 in time 1: speed, acceleration, jerk.
_REST_PEAKS = {"cubic": (2.0, 8.0, 32.0), "quintic": (15 / 8, 10 / np.sqrt(3), 60.0)}
# Peaks of a change of speed by 1 in time 1 that ends with no acceleration: acceleration, jerk.
_CORNER_PEAKS = {"cubic": (4 / 3, 16 / 3), "quintic": (1.5, 6.0)}

KINDS = ("linear", "cubic", "quintic")


def transition(kind: str, start: State, end: State, limits: Limits) -> PPoly:
    """Path from one state to another, as short as the kind and the limits allow.

    Between rests the duration is minimal; where an end moves, it is the shortest found by a fine search.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    start, end : State
        Within the limits.
    limits : Limits
        On speed, acceleration, jerk and reach.

    Returns
    -------
    PPoly
        From time 0; of no duration when the states are the same.

    Raises
    ------
    InputError
        When no path of this kind keeps the limits.
    """
    if np.allclose(start, end, rtol=0, atol=(1e-9, 1e-7, 1e-5)):
        return from_jerk(start, [0.0], [0.0])
    if kind == "linear":
        path = _linear(start, end, limits)
        if not _within(path, start, end, limits):
            raise _impossible(kind, start, end)
        return path
    interpolate = _INTERPOLATIONS[kind]
    distance = abs(end.position - start.position)
    if start[1:] == end[1:] == (0.0, 0.0):
        speed, acceleration, jerk = _REST_PEAKS[kind]
        return interpolate(
            max(
                speed * distance / limits.speed,
                (acceleration * distance / limits.acceleration) ** (1 / 2),
                (jerk * distance / limits.jerk) ** (1 / 3),
            ),
            start,
            end,
        )

    def fits(duration: float) -> bool:
        return _within(interpolate(duration, start, end), start, end, limits)

    least = max(
        1e-3,
        distance / limits.speed,
        abs(end.velocity - start.velocity) / limits.acceleration,
        abs(end.acceleration - start.acceleration) / limits.jerk,
    )
    # A longer path is not always gentler (it may swing further), so the shortest is sought from below.
    step = 1.02
    duration = next((trial for trial in least * step ** np.arange(300) if fits(trial)), None)
    if duration is None:
        raise _impossible(kind, start, end)
    low, high = duration / step, duration
    while high - low > 1e-4 * high:
        middle = (low + high) / 2
        low, high = (low, middle) if fits(middle) else (middle, high)
    return interpolate(high, start, end)


def corner(kind: str, before: float, after: float, limits: Limits) -> PPoly:
    """Change of velocity around a corner between two straight lines.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    before, after : float
        Slopes of the lines in m/s.

    Returns
    -------
    PPoly
        From time 0 and position 0; half its duration before the corner it leaves the one line, half after it meets the
        other.
    """
    change = abs(after - before)
    if change < 1e-9:
        return from_jerk(State(0.0, before), [0.0], [0.0])
    if kind == "linear":
        return from_jerk(State(0.0, before), *_speed_change(before, after, limits))
    acceleration, jerk = _CORNER_PEAKS[kind]
    duration = max(acceleration * change / limits.acceleration, (jerk * change / limits.jerk) ** (1 / 2))
    return _INTERPOLATIONS[kind](duration, State(0.0, before), State((before + after) / 2 * duration, after))


def _impossible(kind: str, start: State, end: State) -> InputError:
    def show(state: State) -> str:
        return f"{state.position * 1e3:.4g} mm at {state.velocity * 1e3:.4g} mm/s and {state.acceleration:.3g} m/s²"

    return InputError(f"no {kind} transition from {show(start)} to {show(end)} keeps the limits")


def _within(path: PPoly, start: State, end: State, limits: Limits) -> bool:
    room = 1 + TOLERANCE
    reach = max(limits.reach, abs(start.position), abs(end.position))
    bounds = (reach, limits.speed, limits.acceleration, limits.jerk)
    return all(largest(path, derivative) <= room * bound for derivative, bound in enumerate(bounds))


def _quintic(duration: float, start: State, end: State) -> PPoly:
    return hermite(np.array([0.0, duration]), *np.array([start, end]).T)


def _cubic(duration: float, start: State, end: State) -> PPoly:
    pieces = duration * np.array([0.25, 0.5, 0.25])
    remaining = duration * np.array([1.0, 0.75, 0.25, 0.0])
    # What a unit jerk in each piece adds to acceleration, velocity and position at the end.
    effect = np.array([-np.diff(remaining**n) / (1, 2, 6)[n - 1] for n in (1, 2, 3)])
    x, v, a = start
    wanted = [end.acceleration - a, end.velocity - v - a * duration, end.position - x - v * duration - a * duration**2 / 2]
    # Rows of one scale: without it, short durations make the system look singular.
    scale = duration ** np.array([1.0, 2.0, 3.0])
    return from_jerk(start, list(pieces), list(np.linalg.solve(effect / scale[:, None], wanted / scale)))


_INTERPOLATIONS: dict[str, Callable[[float, State, State], PPoly]] = {"cubic": _cubic, "quintic": _quintic}


def _speed_change(before: float, after: float, limits: Limits) -> tuple[list[float], list[float]]:
    """Durations and jerks of the shortest change of velocity between two states without acceleration."""
    change = abs(after - before)
    jerk = float(np.copysign(limits.jerk, after - before))
    rounding = min(limits.acceleration / limits.jerk, (change / limits.jerk) ** 0.5)
    steady = max(0.0, change / limits.acceleration - rounding) if change else 0.0
    return [rounding, steady, rounding], [jerk, 0.0, -jerk]


def _linear(start: State, end: State, limits: Limits) -> PPoly:
    """Speed change to a cruising speed, cruise, speed change; accelerations at the ends are ramped off and on."""
    off = from_jerk(start, [abs(start.acceleration) / limits.jerk], [-np.copysign(limits.jerk, start.acceleration)])
    # The ramp before the end, seen backwards in time from it: velocity and jerk change their sign.
    back = State(end.position, -end.velocity, end.acceleration)
    on = from_jerk(back, [abs(end.acceleration) / limits.jerk], [-np.copysign(limits.jerk, end.acceleration)])
    first = float(off(off.x[-1])), float(off(off.x[-1], 1))
    last = float(on(on.x[-1])), -float(on(on.x[-1], 1))
    distance = last[0] - first[0]

    def cruising(speed: float, duration: float = 0.0) -> PPoly:
        times, jerks = _speed_change(first[1], speed, limits)
        more_times, more_jerks = _speed_change(speed, last[1], limits)
        return from_jerk(State(first[0], first[1]), [*times, duration, *more_times], [*jerks, 0.0, *more_jerks])

    def travel(speed: float) -> float:
        path = cruising(speed)
        return float(path(path.x[-1])) - first[0]

    top = limits.speed
    if distance >= travel(top):
        middle = cruising(top, (distance - travel(top)) / top)
    elif distance <= travel(-top):
        middle = cruising(-top, (travel(-top) - distance) / top)
    else:
        middle = cruising(brentq(lambda speed: travel(speed) - distance, -top, top, xtol=1e-15, rtol=1e-15))
    onwards = from_jerk(State(*last), [float(on.x[-1])], [float(np.copysign(limits.jerk, end.acceleration))])
    return joined([off, middle, onwards])
