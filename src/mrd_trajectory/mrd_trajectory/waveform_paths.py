"""Paths of rod and coil over one pass of their waveforms."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

import numpy as np
import scipy

from mrd_base import InputError
from mrd_base.config import yaml_key
from mrd_trajectory.experiment import Experiment
from mrd_trajectory.limit_checks import check_coil, check_position, check_slope
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import MotionState, concatenate, constant_jerk_path, cut, quintic_hermite, rest_path
from mrd_trajectory.transition import corner, transition
from mrd_trajectory.waveforms import Corners, Holds, Samples, Shape, Smooth, Waveform
from mrd_trajectory.waveforms.waveform import Array, fields_in

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

# Points of the spline in a period of the highest frequency; the quintic between them errs by 1e-9 of the amplitude.
_POINTS_PER_PERIOD = 32
# Points of the spline that still fit into the memory.
_MOST_POINTS = 1_000_000


def waveform_shape(waveform: Waveform, channel: str, duration: float) -> Shape:
    """Return the shape of a waveform; an error names the channel."""
    try:
        return waveform.shape(duration)
    except InputError as error:
        raise InputError(f"{channel}: {error}") from None


def coil_path(experiment: Experiment, limits: Limits) -> PPoly:
    """Return the current in A over one pass, within the limits; steps and corners stay sharp."""
    shape = waveform_shape(experiment.coil, "coil", experiment.duration)
    match shape:
        case Smooth():
            path = _smooth_path(shape, "coil", experiment.duration)
        case Holds():
            path = scipy.interpolate.PPoly(
                shape.levels[None, :], np.append(shape.times, max(experiment.duration, shape.times[-1]) + 1)
            )
        case Corners() | Samples():
            times, levels = _distinct_points(shape)
            path = scipy.interpolate.PPoly(np.array([np.diff(levels) / np.diff(times), levels[:-1]]), times)
    path = cut(path, experiment.duration)
    check_coil(experiment.coil, path, limits)
    return path


def rod_path(shape: Shape, experiment: Experiment, limits: Limits, move_limits: Limits) -> PPoly:
    """Return the position in m over at least one pass; moves between levels keep ``move_limits``."""
    match shape:
        case Smooth():
            return _smooth_path(shape, "rod", experiment.duration)
        case Samples():
            spline = scipy.interpolate.CubicSpline(shape.times, shape.levels)
            return concatenate([scipy.interpolate.PPoly(spline.c, spline.x)])
        case Holds():
            return _path_of_moves(shape, experiment, move_limits)
        case Corners():
            return _path_with_rounded_corners(shape, experiment, limits)


def _smooth_path(shape: Smooth, channel: str, duration: float) -> PPoly:
    intervals = max(2, math.ceil(duration * shape.highest_frequency * _POINTS_PER_PERIOD))
    if intervals > _MOST_POINTS:
        raise InputError(
            f"{channel}: {shape.highest_frequency:.4g} Hz for {duration:.4g} s are too many periods to plan; "
            "reduce duration_s and raise repeats"
        )
    times = np.linspace(0, duration, intervals + 1)
    return quintic_hermite(times, *shape.motion(times))


def _distinct_points(shape: Corners | Samples) -> tuple[Array, Array]:
    """Return times and levels of the points without those at the time of the point before."""
    distinct = np.diff(shape.times, prepend=-1) > 0
    return shape.times[distinct], shape.levels[distinct]


def _path_of_moves(shape: Holds, experiment: Experiment, limits: Limits) -> PPoly:
    """Return a path that rests at each level and starts to move at the time of the next one."""
    check_position(experiment.rod, float(np.abs(shape.levels).max()), limits)
    changes = np.diff(shape.levels, prepend=np.nan) != 0
    times, levels = shape.times[changes], shape.levels[changes]
    ends = np.append(times[1:], max(experiment.duration, times[-1] + 1e-3))
    paths, position = [], float(levels[0])
    for time, end, level in zip(times, ends, levels, strict=True):
        if time >= experiment.duration:
            break
        move = transition(experiment.transition, MotionState(position), MotionState(float(level)), limits)
        rest = end - time - move.x[-1]
        if rest < 0 and end < experiment.duration:
            durations = " or ".join(yaml_key(field)[0] for field in fields_in(experiment.rod, "s"))
            raise InputError(
                f"rod: the move of {abs(level - position) * 1e3:.4g} mm at {time:.4g} s takes {move.x[-1]:.4g} s, "
                f"longer than the {end - time:.4g} s until the next; raise {durations} or bring the levels together"
            )
        paths += [move, rest_path(float(level), max(rest, 0.0))]
        position = float(level)
    return concatenate(paths)


def _path_with_rounded_corners(shape: Corners, experiment: Experiment, limits: Limits) -> PPoly:
    """Return straight lines with rounded corners; a corner's rounding begins as long before it as it ends after it."""
    times, levels = _distinct_points(shape)
    lengths = np.diff(times)
    slopes = np.diff(levels) / lengths
    check_slope(experiment.rod, float(np.abs(slopes).max()), limits)
    # Most pairs of slopes repeat; each different pair is computed once.
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
        paths.append(constant_jerk_path(MotionState(level + slope * halves[i], slope), [straight], [0.0]))
        if i < len(pairs):
            turn = corners[pairs[i]]
            coefficients = turn.c.copy()
            coefficients[-1] += levels[i + 1] - slope * halves[i + 1]
            paths.append(scipy.interpolate.PPoly(coefficients, turn.x))
    return concatenate(paths)
