"""From an experiment to the motion of rod and coil, checked against the bench's limits."""

import dataclasses
import itertools
import math
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PPoly

from mrd_base import InputError
from mrd_base.config import yaml_key
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import REST, State, cut, extremes, from_jerk, hermite, joined, largest, resting, state_at
from mrd_trajectory.transition import TOLERANCE, corner, transition
from mrd_trajectory.waveforms import UNITS, Corners, Holds, Samples, Shape, Smooth, Waveform
from mrd_trajectory.waveforms.waveform import fields_in

Array = NDArray[np.float64]

# Points a period of the fastest part of a smooth waveform: the quintic between them errs by 1e-9 of the amplitude.
_POINTS = 32


class Setpoint(NamedTuple):
    """What rod and coil should do: m, m/s, m/s², A; each of the shape of the times asked for."""

    position: Array
    velocity: Array
    acceleration: Array
    current: Array


class Peak(NamedTuple):
    """A largest value of a plan beside its limit, in the unit people read."""

    quantity: str
    value: float
    limit: float
    unit: str


@dataclass(frozen=True)
class Plan:
    """The motion of one experiment: lead-in from rest at mid-stroke, the body, lead-out to rest at mid-stroke.

    The body is ``repeats`` passes through the waveforms; between two passes the rod returns to the waveform's start
    where it does not end there. The coil is without current outside the passes.

    Attributes
    ----------
    experiment : Experiment
    lead_in, lead_out : PPoly
        Position of the rod in m over s, each from 0.
    body_pass : PPoly
        One pass and the return to its start.
    coil : PPoly
        Current in A during one pass.
    peaks : tuple of Peak
        Largest values of the whole plan beside their limits.
    """

    experiment: Experiment
    lead_in: PPoly
    body_pass: PPoly
    coil: PPoly
    lead_out: PPoly
    peaks: tuple[Peak, ...]

    @property
    def period(self) -> float:
        """From the start of one pass to the start of the next, in s."""
        return float(self.body_pass.x[-1])

    @property
    def body(self) -> tuple[float, float]:
        """Start and end of the body in s; an analysis leaves out what lies outside."""
        start = float(self.lead_in.x[-1])
        return start, start + (self.experiment.repeats - 1) * self.period + self.experiment.duration

    @property
    def duration(self) -> float:
        """Of everything, in s."""
        return self.body[1] + float(self.lead_out.x[-1])

    def at(self, time: ArrayLike) -> Setpoint:
        """Setpoints at times in s since the start; at rest at mid-stroke, without current, before and after."""
        times = np.asarray(time, dtype=float)
        flat = np.atleast_1d(times)
        start, end = self.body
        motion = np.zeros((4, *flat.shape))
        within = (flat >= start) & (flat < end)
        count = np.clip(np.floor((flat[within] - start) / self.period), 0, self.experiment.repeats - 1)
        local = flat[within] - start - count * self.period
        before = (flat > 0) & (flat < start)
        after = (flat >= end) & (flat < self.duration)
        for derivative in range(3):
            motion[derivative, before] = self.lead_in(flat[before], derivative)
            motion[derivative, within] = self.body_pass(local, derivative)
            motion[derivative, after] = self.lead_out(flat[after] - end, derivative)
        motion[3, within] = np.where(local < self.experiment.duration, self.coil(local), 0.0)
        return Setpoint(*motion.reshape(4, *times.shape))

    def times(self) -> Array:
        """Sample times (n,) in s of the whole plan at the experiment's rate."""
        return np.arange(int(self.duration * self.experiment.rate) + 1) / self.experiment.rate


def plan(experiment: Experiment, limits: Limits, envelope: ForceEnvelope) -> Plan:
    """Work out the motion of an experiment and check it against the limits.

    Parameters
    ----------
    experiment : Experiment
    limits : Limits
        None is exceeded by the plan.
    envelope : ForceEnvelope
        The damper's largest force; where rod moves are not given by the waveform, their speed is chosen so that the
        force stays within the limits.

    Raises
    ------
    InputError
        One line with the value, the limit that it exceeds and the remedy.
    """
    duration = experiment.duration
    coil = _coil(experiment, limits)
    body = cut(_rod(experiment, limits, _at_force(limits, envelope, largest(coil))), duration)
    _check_rod(experiment.rod, body, limits)
    force = _expected_force(experiment, body, coil, limits, envelope)

    start, end = state_at(body, 0.0), _last(body)
    idle = _at_force(limits, envelope, 0.0)
    lead_in = _transition(experiment, REST, start, idle, "start")
    lead_out = _transition(experiment, end, REST, idle, "end")
    if experiment.repeats > 1:
        body = joined([body, _transition(experiment, end, start, idle, "end")])
    rod = joined([lead_in, body, lead_out])
    low, high = extremes(coil)
    peaks = (
        Peak("position", largest(rod) * 1e3, limits.reach * 1e3, "mm"),
        Peak("speed", largest(rod, 1) * 1e3, limits.speed * 1e3, "mm/s"),
        Peak("acceleration", largest(rod, 2), limits.acceleration, "m/s²"),
        Peak("jerk", largest(rod, 3), limits.jerk, "m/s³"),
        Peak("least current", low * 1e3, limits.current_min * 1e3, "mA"),
        Peak("largest current", high * 1e3, limits.current_max * 1e3, "mA"),
        Peak("expected force", max(force, envelope.force(largest(rod, 1), 0.0)), limits.force, "N"),
    )
    return Plan(experiment, lead_in, body, coil, lead_out, peaks)


# --- from shapes to paths


def _shape(waveform: Waveform, channel: str, duration: float) -> Shape:
    try:
        return waveform.shape(duration)
    except InputError as error:
        raise InputError(f"{channel}: {error}") from None


def _smooth(shape: Smooth, channel: str, duration: float) -> PPoly:
    count = max(2, math.ceil(duration * shape.highest_frequency * _POINTS))
    if count > 1_000_000:
        raise InputError(
            f"{channel}: {shape.highest_frequency:.4g} Hz for {duration:.4g} s are too many periods to plan; "
            "reduce duration_s and raise repeats"
        )
    times = np.linspace(0, duration, count + 1)
    return hermite(times, *shape.motion(times))


def _coil(experiment: Experiment, limits: Limits) -> PPoly:
    """Current over one pass, within the limits: steps stay steps, corners stay corners."""
    shape = _shape(experiment.coil, "coil", experiment.duration)
    match shape:
        case Smooth():
            path = _smooth(shape, "coil", experiment.duration)
        case Holds():
            path = PPoly(shape.levels[None, :], np.append(shape.times, max(experiment.duration, shape.times[-1]) + 1))
        case Corners() | Samples():
            kept = np.diff(shape.times, prepend=-1) > 0
            times, levels = shape.times[kept], shape.levels[kept]
            path = PPoly(np.array([np.diff(levels) / np.diff(times), levels[:-1]]), times)
    path = cut(path, experiment.duration)
    low, high = extremes(path)
    room = TOLERANCE * limits.current_max
    if high > limits.current_max + room:
        remedy = _reduce(experiment.coil, "coil", limits.current_max / high)
        _refuse("coil: current", high * 1e3, limits.current_max * 1e3, "mA", remedy)
    if low < limits.current_min - room:
        keys = " or ".join(yaml_key(field, UNITS["coil"])[0] for field in fields_in(experiment.coil, "level"))
        raise InputError(
            f"coil: current {low * 1e3:.4g} mA is below {limits.current_min * 1e3:.4g} mA; change {keys} so that it is not"
        )
    return path


def _rod(experiment: Experiment, limits: Limits, moving: Limits) -> PPoly:
    """Position over at least one pass; moves between levels keep the limits ``moving``."""
    shape = _shape(experiment.rod, "rod", experiment.duration)
    match shape:
        case Smooth():
            return _smooth(shape, "rod", experiment.duration)
        case Samples():
            spline = CubicSpline(shape.times, shape.levels)
            return joined([PPoly(spline.c, spline.x)])
        case Holds():
            return _moves(shape, experiment, moving)
        case Corners():
            return _rounded(shape, experiment, limits)


def _moves(shape: Holds, experiment: Experiment, limits: Limits) -> PPoly:
    """Rest at each level; a move to the next starts when its time comes."""
    _check_position(experiment.rod, float(np.abs(shape.levels).max()), limits)
    seconds = " or ".join(yaml_key(field)[0] for field in fields_in(experiment.rod, "s"))
    changes = np.diff(shape.levels, prepend=np.nan) != 0
    times, levels = shape.times[changes], shape.levels[changes]
    ends = np.append(times[1:], max(experiment.duration, times[-1] + 1e-3))
    paths, position = [], float(levels[0])
    for time, end, level in zip(times, ends, levels, strict=True):
        if time >= experiment.duration:
            break
        move = transition(experiment.transition, State(position), State(float(level)), limits)
        rest = end - time - move.x[-1]
        if rest < 0:
            if end < experiment.duration:
                raise InputError(
                    f"rod: the move of {abs(level - position) * 1e3:.4g} mm at {time:.4g} s takes {move.x[-1]:.4g} s, "
                    f"longer than the {end - time:.4g} s until the next; raise {seconds} or bring the levels together"
                )
            rest = 0.0
        paths += [move, resting(float(level), rest)]
        position = float(level)
    return joined(paths)


def _rounded(shape: Corners, experiment: Experiment, limits: Limits) -> PPoly:
    """Straight lines whose corners are rounded, as much before a corner as after it."""
    rod = experiment.rod
    kept = np.diff(shape.times, prepend=-1) > 0
    times, levels = shape.times[kept], shape.levels[kept]
    lengths = np.diff(times)
    slopes = np.diff(levels) / lengths
    speed = float(np.abs(slopes).max())
    if speed > limits.speed * (1 + TOLERANCE):
        remedy = _reduce(rod, "rod", limits.speed / speed, "level/s")
        _refuse("rod: speed", speed * 1e3, limits.speed * 1e3, "mm/s", remedy)
    # Corners repeat, so each pair of slopes is worked out once.
    pairs = list(itertools.pairwise(slopes))
    corners = {pair: corner(experiment.transition, *pair, limits) for pair in set(pairs)}
    halves = np.array([0.0, *(corners[pair].x[-1] / 2 for pair in pairs), 0.0])
    paths = []
    for i, (level, slope, length) in enumerate(zip(levels[:-1], slopes, lengths, strict=True)):
        straight = length - halves[i] - halves[i + 1]
        if straight < 0:
            raise InputError(
                f"rod: turning at the corners around {times[i]:.4g} s takes {halves[i] + halves[i + 1]:.4g} s, longer than "
                f"the {length:.4g} s between them; reduce the slope or lengthen the lines"
            )
        paths.append(from_jerk(State(level + slope * halves[i], slope), [straight], [0.0]))
        if i < len(pairs):
            turn = corners[pairs[i]]
            coefficients = turn.c.copy()
            coefficients[-1] += levels[i + 1] - slope * halves[i + 1]
            paths.append(PPoly(coefficients, turn.x))
    return joined(paths)


def _transition(experiment: Experiment, start: State, end: State, limits: Limits, where: str) -> PPoly:
    """Way to or from the waveform: at half the pace that the limits allow, since no one is in a hurry, if that can be."""
    gentle = dataclasses.replace(limits, speed=limits.speed / 2, acceleration=limits.acceleration / 4, jerk=limits.jerk / 8)
    try:
        return transition(experiment.transition, start, end, gentle)
    except InputError:
        pass
    try:
        return transition(experiment.transition, start, end, limits)
    except InputError as error:
        raise InputError(
            f"rod: at the {where} of the waveform {error}; reduce its levels or let it {where} slower"
        ) from None


def _last(path: PPoly) -> State:
    """State at the end of a path, by its last piece."""
    return state_at(PPoly(path.c[:, -1:], path.x[-2:]), float(path.x[-1]))


# --- checks


def _refuse(what: str, value: float, limit: float, unit: str, remedy: str, sign: str = "") -> NoReturn:
    raise InputError(f"{what} {sign}{_above(value, limit)} {unit} exceeds {sign}{limit:.4g} {unit}; {remedy}")


def _above(value: float, limit: float) -> str:
    """The value with as many digits as show that it is above the limit."""
    return next(
        text for digits in (4, 6, 9, 17) if float(text := f"{value:.{digits}g}") > float(f"{limit:.4g}") or digits == 17
    )


def _below(value: float) -> float:
    """The value rounded down, in magnitude, to four digits."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 3)
    return math.copysign(math.floor(abs(value) / unit + 1e-9) * unit, value)


def _reduce(waveform: Waveform, channel: str, factor: float, unit: str = "level") -> str:
    """Remedy: the parameters that bring the levels (or slopes) down by a factor."""
    changes = []
    for field in fields_in(waveform, unit):
        key, to_si = yaml_key(field, UNITS[channel])
        value = getattr(waveform, field.name)
        if isinstance(value, tuple):
            changes.append(f"{key} by the factor {_below(factor):.4g}")
        elif value:
            changes.append(f"{key} from {value / to_si:.6g} to {_below(factor * value / to_si):.4g}")
    return "reduce " + " and ".join(changes)


def _slower(waveform: Waveform, factor: float) -> str:
    """Remedy: what brings the speed of the rod down by a factor."""
    if fields_in(waveform, "level/s"):
        return _reduce(waveform, "rod", factor, "level/s")
    remedy = _reduce(waveform, "rod", factor)
    frequencies = " and ".join(yaml_key(field)[0] for field in fields_in(waveform, "Hz"))
    return remedy + (f", or lower {frequencies}" if frequencies else "")


def _check_position(waveform: Waveform, value: float, limits: Limits) -> None:
    if value > limits.reach * (1 + TOLERANCE):
        remedy = _reduce(waveform, "rod", limits.reach / value)
        _refuse("rod: position", value * 1e3, limits.reach * 1e3, "mm", remedy, "±")


def _check_rod(waveform: Waveform, body: PPoly, limits: Limits) -> None:
    _check_position(waveform, largest(body), limits)
    checks: list[tuple[str, float, str, float]] = [
        ("speed", limits.speed, "mm/s", 1e3),
        ("acceleration", limits.acceleration, "m/s²", 1.0),
        ("jerk", limits.jerk, "m/s³", 1.0),
    ]
    for derivative, (what, limit, unit, factor) in enumerate(checks, 1):
        value = largest(body, derivative)
        if value > limit * (1 + TOLERANCE):
            _refuse(f"rod: {what}", value * factor, limit * factor, unit, _slower(waveform, limit / value))


def _at_force(limits: Limits, envelope: ForceEnvelope, current: float) -> Limits:
    """Limits whose speed keeps the force too, at a current."""
    speed = float(envelope.speed(limits.force, current))
    # Where the current alone is too much, `_expected_force` will say so.
    return dataclasses.replace(limits, speed=min(speed, limits.speed)) if speed > 0 else limits


def _expected_force(experiment: Experiment, body: PPoly, coil: PPoly, limits: Limits, envelope: ForceEnvelope) -> float:
    """Largest force to expect in a pass, in N; refused when it exceeds the limit."""
    count = int(np.clip(1000 * experiment.duration, 1000, 200_000))
    times = np.unique(np.concatenate([np.linspace(0, experiment.duration, count), body.x, coil.x]))
    # In each interval the larger of both ends, the current as it is before a step at the interval's end.
    speeds, before = np.abs(body(times, 1)), np.abs(coil(np.nextafter(times[1:], 0)))
    speed, current = np.maximum(speeds[:-1], speeds[1:]), np.maximum(np.abs(coil(times[:-1])), before)
    force = envelope.force(speed, current)
    worst = int(force.argmax())
    if force[worst] <= limits.force * (1 + TOLERANCE):
        return float(force[worst])

    flowing, fed = current > 0, speed > 0
    less_current = float((envelope.current(limits.force, speed[flowing]) / current[flowing]).min(initial=np.inf))
    less_speed = float((envelope.speed(limits.force, current[fed]) / speed[fed]).min(initial=np.inf))
    remedies = []
    if 0 < less_current < 1:
        remedies.append(_reduce(experiment.coil, "coil", less_current))
    if 0 < less_speed < 1 and not isinstance(_shape(experiment.rod, "rod", experiment.duration), Holds):
        remedies.append(_slower(experiment.rod, less_speed))
    _refuse(
        f"expected force at {times[worst]:.4g} s ({speed[worst] * 1e3:.4g} mm/s, {current[worst] * 1e3:.4g} mA)",
        force[worst],
        limits.force,
        "N",
        ", or ".join(remedies) or "raise limits.force_N if load cell and drive bear it",
    )
