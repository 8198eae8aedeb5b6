"""Force over speed: peak and mean force of strokes over their peak speed (PVP), force over the instantaneous speed (CVP)."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from mrd_base import InputError
from mrd_characterisation.average import average
from mrd_characterisation.characterisation import SAME_SPEED, Curve, Direction, Value
from mrd_characterisation.strokes import Cycle, Stroke, grouped, rounded

Array = NDArray[np.float64]

DIRECTIONS: tuple[Direction, Direction] = ("rebound", "compression")

PEAK_WINDOW = 0.01
"""Share of the samples of a stroke over which the force is averaged before its peak is taken, against noise."""

SLOWEST_SHARE, FASTEST_SHARE = 0.25, 0.95
"""A stroke of varying speed shows the force at speeds between these shares of its peak speed: below, the fluid is still
yielding after the reversal; above, both branches meet."""

NEAR = 0.1
"""Samples within this share of a speed make the force at it."""

DROP = 0.05
"""Share of the peak speed by which a stroke may slow down and speed up again on a branch."""

SAME_PLATEAU = 0.02
"""Relative difference up to which a stroke of constant speed shows the force at a speed."""

SPEED_BINS, SAMPLES_OF_BIN = 40, 3
"""Most points of a curve of force over speed; samples of a branch for each, below which there are fewer points."""

PEAK_FORCE = (
    "Largest force of a stroke in the direction that resists the motion, averaged over 1 % of the samples of the stroke; "
    "mean over the strokes of periodic cycles of the same current, peak speed and stroke."
)
MEAN_FORCE = (
    "Work of a stroke over its length, the integral of the unfiltered force over the smoothed position; mean over the "
    "strokes of periodic cycles of the same current, peak speed and stroke."
)
FORCE_AT_SPEED = (
    "Mean of the accelerating and the decelerating branch of a stroke at this speed, so that a stiffness cancels: of each "
    "the line through the unfiltered force at smoothed speeds within 10 % of it. Of a stroke of constant speed, the mean "
    "over the middle half of its way. Mean over all strokes of constant speed within 2 % of it, and of periodic cycles "
    "that pass it at 25 to 95 % of their peak speed, at the same current. Strokes shorter than 10 % of the longest one are "
    "left out, because the fluid hardly yields in them."
)


def peak_and_mean_forces(groups: Sequence[Sequence[Cycle]]) -> list[Value]:
    """Return peak and mean force of both directions over the peak speed of a stroke (peak velocity plot, PVP).

    Parameters
    ----------
    groups : sequence of sequences of Cycle
        Cycles of the same current, peak speed and stroke.
    """
    values = []
    for cycles in groups:
        for direction in DIRECTIONS:
            strokes = [getattr(cycle, direction) for cycle in cycles]
            names = [stroke.run.run.name for stroke in strokes]
            condition: dict[str, Any] = {
                "direction": direction,
                "current": strokes[0].current,
                "speed": _mean(strokes, "peak_speed"),
                "stroke": _mean(strokes, "length"),
            }
            values.append(Value("peak_force", *average([peak_force(s) for s in strokes], names), PEAK_FORCE, **condition))
            values.append(Value("mean_force", *average([mean_force(s) for s in strokes], names), MEAN_FORCE, **condition))
    return values


def _mean(strokes: Sequence[Stroke], name: str) -> float:
    return float(np.mean([getattr(stroke, name) for stroke in strokes]))


def peak_force(stroke: Stroke) -> float:
    """Return the largest force in N that resists a stroke, in the signs of the bench."""
    width = max(1, round(PEAK_WINDOW * len(stroke.force)))
    force = np.convolve(stroke.force, np.full(width, 1.0 / width), "valid")
    return float(force.max() if stroke.direction == "rebound" else force.min())


def mean_force(stroke: Stroke) -> float:
    """Return the work of a stroke over its length in N, in the signs of the bench."""
    return float(trapezoid(stroke.force, stroke.position) / (stroke.position[-1] - stroke.position[0]))


def round_speeds(levels: Sequence[Sequence[Stroke]], unit: float = 1e-3) -> list[float]:
    """Return speeds in m/s at which strokes show the force: 1, 2 and 5 times powers of ten of ``unit``, and constant ones.

    A round speed counts where strokes of both directions show it at the same current.

    Parameters
    ----------
    levels : sequence of sequences of Stroke
        The strokes of each current.
    unit : float
        m/s in which the speeds are round.
    """
    strokes = [stroke for level in levels for stroke in level]
    reach = [_reach(stroke) for stroke in strokes]
    least, most = min(low for low, _ in reach), max(high for _, high in reach)
    decades = range(math.floor(math.log10(least / unit)), math.ceil(math.log10(most / unit)) + 1)
    series = [digit * 10.0**decade * unit for decade in decades for digit in (1, 2, 5)]
    speeds = [speed for speed in series if any(_shows(level, speed) for level in levels)]
    constant = [stroke.peak_speed for stroke in strokes if stroke.constant_speed]
    for group in grouped(constant, float, lambda speed: SAME_SPEED * speed):
        middle = float(np.median(group))
        if not any(abs(speed - middle) <= SAME_SPEED * middle for speed in speeds):
            speeds.append(rounded(middle, SAME_SPEED * middle))
    return sorted(speeds)


def _shows(level: Sequence[Stroke], speed: float) -> bool:
    """Return whether strokes of one current show the force at a speed in m/s in all directions that there are."""
    shown = {stroke.direction for stroke in level if _reach(stroke)[0] <= speed <= _reach(stroke)[1]}
    return bool(shown) and shown == {stroke.direction for stroke in level}


def _reach(stroke: Stroke) -> tuple[float, float]:
    """Return the speeds in m/s between which a stroke shows the force."""
    if stroke.constant_speed:
        return (1.0 - SAME_PLATEAU) * stroke.peak_speed, (1.0 + SAME_PLATEAU) * stroke.peak_speed
    return SLOWEST_SHARE * stroke.peak_speed, FASTEST_SHARE * stroke.peak_speed


def forces_at_speeds(levels: Sequence[Sequence[Stroke]], speeds: Sequence[float]) -> list[Value]:
    """Return the force of both directions at speeds in m/s, at each current.

    Parameters
    ----------
    levels : sequence of sequences of Stroke
        The strokes of each current.
    speeds : sequence of float
    """
    values = []
    for strokes in levels:
        for direction in DIRECTIONS:
            of_direction = [stroke for stroke in strokes if stroke.direction == direction]
            for speed in speeds:
                found = [(stroke, force_at_speed(stroke, speed)) for stroke in of_direction]
                found = [(stroke, force) for stroke, force in found if not math.isnan(force)]
                if found:
                    mean = average([force for _, force in found], [stroke.run.run.name for stroke, _ in found])
                    condition: dict[str, Any] = {"current": strokes[0].current, "direction": direction, "speed": speed}
                    values.append(Value("force_at_speed", *mean, FORCE_AT_SPEED, **condition))
    return values


def check_speeds(speeds: Sequence[float], strokes: Sequence[Stroke]) -> None:
    """Check that each speed in m/s was asked for with reason: that some stroke shows the force at it.

    Raises
    ------
    InputError
        Names the first speed that no stroke shows.
    """
    if not strokes:
        raise InputError(
            "--speeds: no stroke at steady current is periodic or of constant speed; record cycles, or leave it out"
        )
    reach = [_reach(stroke) for stroke in strokes]
    for speed in speeds:
        if not speed > 0.0:
            raise InputError(f"--speeds: {1e3 * speed:g} mm/s, expected a positive speed")
        if not any(low <= speed <= high for low, high in reach):
            slowest, fastest = 1e3 * min(low for low, _ in reach), 1e3 * max(high for _, high in reach)
            raise InputError(
                f"--speeds: the force at {1e3 * speed:.4g} mm/s was not recorded, expected speeds within those of the "
                f"strokes at steady current, {slowest:.3g} to {fastest:.3g} mm/s (constant speeds count within "
                f"{100 * SAME_PLATEAU:g} %)"
            )


def force_at_speed(stroke: Stroke, speed: float) -> float:
    """Return the mean force in N of both branches of a stroke at a speed in m/s; nan where it does not show it."""
    low, high = _reach(stroke)
    if not low <= speed <= high:
        return math.nan
    if stroke.constant_speed:
        return _force_at_middle(stroke)
    branches = _branches(stroke)
    return math.nan if branches is None else 0.5 * sum(_force_near(*branch, speed) for branch in branches)


def branch_difference(stroke: Stroke) -> float:
    """Return the force in N of the decelerating less that of the accelerating branch at half the peak speed.

    nan for a stroke of constant speed, or with several peaks of its speed.
    """
    branches = None if stroke.constant_speed else _branches(stroke)
    if branches is None:
        return math.nan
    accelerating, decelerating = (_force_near(*branch, 0.5 * stroke.peak_speed) for branch in branches)
    return decelerating - accelerating


def _force_at_middle(stroke: Stroke) -> float:
    """Return the mean force in N over the middle half of the way of a stroke."""
    middle = 0.5 * (stroke.position[0] + stroke.position[-1])
    return float(stroke.force[np.abs(stroke.position - middle) <= 0.25 * stroke.length].mean())


def _branches(stroke: Stroke) -> tuple[tuple[Array, Array], tuple[Array, Array]] | None:
    """Return speed and force of the accelerating and of the decelerating branch; None where the speed has several peaks."""
    speed = np.abs(stroke.velocity)
    top = int(np.argmax(speed))
    before, after = speed[: top + 1], speed[top:][::-1]
    for branch in (before, after):
        if np.max(np.maximum.accumulate(branch) - branch) > DROP * stroke.peak_speed:
            return None
    return (before, stroke.force[: top + 1]), (after, stroke.force[top:][::-1])


def _force_near(speeds: Array, forces: Array, speed: float) -> float:
    """Return the force in N at a speed by the line through the samples near it; interpolated where there are few."""
    near = np.abs(speeds - speed) <= NEAR * speed
    if np.count_nonzero(near) < 4:
        return float(np.interp(speed, np.maximum.accumulate(speeds), forces))
    return float(np.polynomial.Polynomial.fit(speeds[near] - speed, forces[near], 1)(0.0))


def curve_of(strokes: Sequence[Stroke]) -> Curve | None:
    """Return force over instantaneous speed (continuous velocity plot, CVP) of strokes of one current and direction.

    Those of varying speed whose peak speed is the highest make the curve, averaged in bins of speed; None where there is
    no such stroke.
    """
    curved = [(stroke, branches) for stroke in strokes if not stroke.constant_speed and (branches := _branches(stroke))]
    if not curved:
        return None
    fastest = max(stroke.peak_speed for stroke, _ in curved)
    chosen = [(stroke, branches) for stroke, branches in curved if stroke.peak_speed >= (1.0 - SAME_SPEED) * fastest]
    both = [[np.concatenate([branches[number][part] for _, branches in chosen]) for part in range(2)] for number in range(2)]
    fewest = min(len(speeds) for speeds, _ in both)
    edges = np.linspace(0.0, fastest, min(SPEED_BINS, max(1, fewest // SAMPLES_OF_BIN)) + 1)
    means = []
    for speeds, forces in both:
        counts = np.histogram(speeds, edges)[0]
        with np.errstate(invalid="ignore"):
            means.append(np.histogram(speeds, edges, weights=forces)[0] / counts)
    first = chosen[0][0]
    return Curve(first.current, first.direction, 0.5 * (edges[1:] + edges[:-1]), *means)
