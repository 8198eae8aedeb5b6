"""From an experiment to the motion of the rod and the current of the coil, within the limits of the bench."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrd_base import InputError
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.force import ForceEnvelope
from mrd_trajectory.limit_checks import check_force, check_rod, force_limited
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import REST, MotionState, concatenate, cut, end_state, extremes, largest_magnitude, state_at
from mrd_trajectory.transition import transition
from mrd_trajectory.waveform_paths import coil_path, rod_path, waveform_shape
from mrd_trajectory.waveforms import Holds, Waveform
from mrd_trajectory.waveforms.waveform import fields_in

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

REDUCTION, MOST_SIZES = 0.8, 8
"""Factor from one size of an experiment to the next smaller one, and number of sizes; the last is a fifth of the first."""

Array = NDArray[np.float64]


class SetpointSeries(NamedTuple):
    """Setpoints of rod and coil, each with the shape of the times at which they were asked for.

    Attributes
    ----------
    position, velocity, acceleration : ndarray
        Motion of the rod in m, m/s, m/s².
    current : ndarray
        Current of the coil in A.
    """

    position: Array
    velocity: Array
    acceleration: Array
    current: Array


class Peak(NamedTuple):
    """Largest value of a quantity in a plan, and its limit, in the unit that people read."""

    quantity: str
    value: float
    limit: float
    unit: str


@dataclass(frozen=True)
class Plan:
    """Motion and current of an experiment: lead-in from rest at mid-stroke, body, lead-out to rest at mid-stroke.

    The body is ``repeats`` passes of the waveforms. Between two passes the rod returns to the start of the waveform, unless
    the waveform ends there. The coil has no current outside of the passes.

    Attributes
    ----------
    experiment : Experiment
    lead_in, lead_out : PPoly
        Position of the rod in m over the time in s, each from time 0.
    body_pass : PPoly
        One pass and the return to its start.
    coil : PPoly
        Current in A during one pass.
    peaks : tuple of Peak
        Largest values in the whole plan.
    """

    experiment: Experiment
    lead_in: PPoly
    body_pass: PPoly
    coil: PPoly
    lead_out: PPoly
    peaks: tuple[Peak, ...]

    @property
    def period(self) -> float:
        """Time in s from the start of one pass to the start of the next."""
        return float(self.body_pass.x[-1])

    @property
    def body(self) -> tuple[float, float]:
        """Start and end of the body in s."""
        start = float(self.lead_in.x[-1])
        return start, start + (self.experiment.repeats - 1) * self.period + self.experiment.duration

    @property
    def duration(self) -> float:
        """Duration of the whole plan in s."""
        return self.body[1] + float(self.lead_out.x[-1])

    def at(self, time: ArrayLike) -> SetpointSeries:
        """Return the setpoints at times in s since the start.

        Before and after the plan, the rod is at rest at mid-stroke and the coil has no current.
        """
        times = np.asarray(time, dtype=float)
        flat = np.atleast_1d(times)
        start, end = self.body
        setpoints = np.zeros((4, *flat.shape))
        before = (flat > 0) & (flat < start)
        within = (flat >= start) & (flat < end)
        after = (flat >= end) & (flat < self.duration)
        passes = np.clip(np.floor((flat[within] - start) / self.period), 0, self.experiment.repeats - 1)
        time_in_pass = flat[within] - start - passes * self.period
        for derivative in range(3):
            setpoints[derivative, before] = self.lead_in(flat[before], derivative)
            setpoints[derivative, within] = self.body_pass(time_in_pass, derivative)
            setpoints[derivative, after] = self.lead_out(flat[after] - end, derivative)
        setpoints[3, within] = np.where(time_in_pass < self.experiment.duration, self.coil(time_in_pass), 0.0)
        return SetpointSeries(*setpoints.reshape(4, *times.shape))

    def ending_after(self, time: float) -> Plan:
        """Return the plan that ends with the first pass whose end comes after a time in s; until then it is the same.

        A rod that is on its way from one pass to the next goes through that one.
        """
        first_end = self.body[1] - (self.experiment.repeats - 1) * self.period
        passes = 1 + max(0, math.floor((time - first_end) / self.period) + 1)
        if passes >= self.experiment.repeats:
            return self
        return dataclasses.replace(self, experiment=dataclasses.replace(self.experiment, repeats=passes, until=None))

    def times(self) -> Array:
        """Return the sample times (n,) in s of the whole plan at the rate of the experiment."""
        return np.arange(int(self.duration * self.experiment.rate) + 1) / self.experiment.rate


def plan(experiment: Experiment, limits: Limits, envelope: ForceEnvelope) -> Plan:
    """Plan the motion and the current of an experiment and check them against the limits.

    Parameters
    ----------
    experiment : Experiment
    limits : Limits
    envelope : ForceEnvelope
        Largest force of the damper. Where the waveform does not give the speed of the rod, the speed is chosen so that the
        force keeps its limit.

    Raises
    ------
    InputError
        With one line: the value, the limit that it exceeds, and a remedy.
    """
    coil = coil_path(experiment, limits)
    shape = waveform_shape(experiment.rod, "rod", experiment.duration)
    move_limits = force_limited(limits, envelope, largest_magnitude(coil))
    body = cut(rod_path(shape, experiment, limits, move_limits), experiment.duration)
    check_rod(experiment.rod, body, limits)
    force = check_force(experiment, body, coil, limits, envelope, speed_is_chosen=isinstance(shape, Holds))

    start, end = state_at(body, 0.0), end_state(body)
    without_current = force_limited(limits, envelope, 0.0)
    lead_in = _gentle_transition(experiment, REST, start, without_current, "start")
    lead_out = _gentle_transition(experiment, end, REST, without_current, "end")
    if experiment.repeats > 1:
        body = concatenate([body, _gentle_transition(experiment, end, start, without_current, "end")])
    rod = concatenate([lead_in, body, lead_out])
    low, high = extremes(coil)
    speed = largest_magnitude(rod, 1)
    peaks = (
        Peak("position", largest_magnitude(rod) * 1e3, limits.reach * 1e3, "mm"),
        Peak("speed", speed * 1e3, limits.speed * 1e3, "mm/s"),
        Peak("acceleration", largest_magnitude(rod, 2), limits.acceleration, "m/s²"),
        Peak("jerk", largest_magnitude(rod, 3), limits.jerk, "m/s³"),
        Peak("least current", low * 1e3, limits.current_min * 1e3, "mA"),
        Peak("largest current", high * 1e3, limits.current_max * 1e3, "mA"),
        Peak("expected force", max(force, envelope.force(speed, 0.0)), limits.force, "N"),
    )
    return Plan(experiment, lead_in, body, coil, lead_out, peaks)


def plan_scaled(experiment: Experiment, limits: Limits, envelope: ForceEnvelope) -> Plan | None:
    """Plan an experiment, with motion and current scaled down where they exceed the limits; None if no size fits.

    Each of the two is reduced as far as it must be: of all pairs of sizes that fit, the one with the fewest reductions. The
    description, which may name the sizes, then tells how far they are reduced.
    """

    def attempt(of_motion: int, of_current: int) -> Plan | None:
        motion, current = REDUCTION**of_motion, REDUCTION**of_current
        reduced = " and ".join(
            f"{name} reduced to {100 * factor:.0f} %"
            for name, factor in (("motion", motion), ("current", current))
            if factor < 1.0
        )
        said = experiment.description
        scaled = dataclasses.replace(
            experiment,
            rod=_scaled(experiment.rod, motion),
            coil=_scaled(experiment.coil, current),
            description=f"{said} ({reduced} to keep the limits)" if said and reduced else said,
        )
        try:
            return plan(scaled, limits, envelope)
        except InputError:
            return None

    if fitting := attempt(0, 0):
        return fitting
    best, fewest = None, 2 * MOST_SIZES
    # The smaller the motion, the larger the current that fits.
    of_current = MOST_SIZES - 1
    for of_motion in range(MOST_SIZES):
        planned = attempt(of_motion, of_current)
        while planned and of_current and (larger := attempt(of_motion, of_current - 1)):
            planned, of_current = larger, of_current - 1
        if planned and of_motion + of_current < fewest:
            best, fewest = planned, of_motion + of_current
    return best


def _scaled(waveform: Waveform, factor: float) -> Waveform:
    """Return a waveform with its levels, and the slopes between them, multiplied by a factor."""
    changes = {}
    for field in (*fields_in(waveform, "level"), *fields_in(waveform, "level/s")):
        value = getattr(waveform, field.name)
        changes[field.name] = tuple(factor * item for item in value) if isinstance(value, tuple) else factor * value
    return dataclasses.replace(waveform, **changes)  # type: ignore[type-var]


def _gentle_transition(experiment: Experiment, start: MotionState, end: MotionState, limits: Limits, where: str) -> PPoly:
    """Return a transition to or from the waveform, at half the pace that the limits allow where that is possible."""
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
