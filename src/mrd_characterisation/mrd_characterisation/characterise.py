"""Characterise a damper: all numbers that its recordings show, and what they do not show."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mrd_base import InputError
from mrd_characterisation.average import Average
from mrd_characterisation.characterisation import QUANTITIES, SAME_CURRENT, Characterisation, Loop, Value, by_size
from mrd_characterisation.current_response import response_values, steps_of
from mrd_characterisation.cycles import asymmetries, cycle_values, dynamic_ranges, representative_loop
from mrd_characterisation.force_speed import (
    DIRECTIONS,
    check_speeds,
    curve_of,
    forces_at_speeds,
    peak_and_mean_forces,
    round_speeds,
)
from mrd_characterisation.slow_strokes import SLOW, gas_values, long_strokes
from mrd_characterisation.strokes import SETTLED, Cycle, Stroke, cycles_of, grouped, rounded, strokes_of
from mrd_runs import Run
from mrd_runs.run import checked_runs
from mrd_runs.signals.current import current_noise
from mrd_runs.signals.smoothed_run import smooth_run

SPEED_GROUP, STROKE_GROUP = 0.05, 0.05
"""Relative differences up to which cycles have the same peak speed and the same stroke."""

LEAST_LENGTH = 0.1
"""Length of a stroke over that of the longest one, below which it shows no force at a speed: the fluid hardly
yields in it, and it may lie at an end of the stroke."""

CURRENT_NOISES = 5.0
"""Largest current over the noise of its sensor, up to which there is none."""

ENOUGH_CYCLES = 3
"""Cycles below which the scatter of a mean is hardly known."""


def characterise(
    runs: Sequence[Run] | Run, *, name: str = "damper", speeds: Sequence[float] | None = None, round_to: float = 1e-3
) -> Characterisation:
    """Characterise a damper by any number of its recordings.

    Parameters
    ----------
    runs : sequence of Run
        Of one damper.
    name : str
        Name or serial number of the damper.
    speeds : sequence of float, optional
        Speeds in m/s at which the force is given; by default round ones within those that were recorded.
    round_to : float
        Unit in m/s in which the default speeds are round.

    Returns
    -------
    Characterisation

    Raises
    ------
    InputError
        When nothing can be characterised, or when no stroke at steady current shows the force at one of ``speeds``.
    """
    listed = checked_runs(runs)
    # The positions alone tell the speed of strokes well enough, and an accelerometer would take most of the time.
    smoothed = [smooth_run(replace(run, acceleration=None)) for run in listed]
    scale = max(float(np.quantile(np.abs(one.current), 0.99)) for one in smoothed)
    moved = [np.abs(one.motion.velocity) for one in smoothed]
    fast = max(float(np.quantile(speed, 0.95)) for speed in moved)
    of_runs = [strokes_of(one, scale) for one in smoothed]
    noise = max(current_noise(run.current) for run in listed)
    if scale <= CURRENT_NOISES * noise:
        scale = 0.0  # the coil was not used
    tolerance = max(SAME_CURRENT * scale, 2.0 * noise)
    of_runs = _at_levels(of_runs, tolerance)
    strokes = [stroke for of_run in of_runs for stroke in of_run if stroke.steady]
    cycles = [cycle for of_run in of_runs for cycle in cycles_of(of_run)]
    steps = [step for one in smoothed for step in steps_of(one, scale, fast)] if scale > 0.0 else []
    currents = by_size(stroke.current for stroke in strokes)
    levels = [[stroke for stroke in strokes if stroke.current == level] for level in currents]
    groups = _equal_cycles(cycles)
    periodic = {id(stroke) for cycle in cycles for stroke in (cycle.first, cycle.second)}
    least = LEAST_LENGTH * max((stroke.length for stroke in strokes), default=0.0)
    shown = [[stroke for stroke in level if stroke.constant_speed or id(stroke) in periodic] for level in levels]
    read = [[stroke for stroke in level if stroke.length >= least] for level in shown]
    short = [stroke for level in shown for stroke in level if stroke.length < least]
    readable = [stroke for level in read for stroke in level]
    if speeds:
        check_speeds(speeds, readable)
    forces = forces_at_speeds(read, speeds or round_speeds(read, round_to)) if readable else []
    gas, gas_curve = gas_values(levels[0], read[0], fast) if levels else ([], None)
    times, responses, notes = response_values(steps, scale)
    measured = [
        *peak_and_mean_forces(groups),
        *cycle_values(groups),
        *forces,
        *asymmetries(forces),
        *dynamic_ranges(forces),
        *times,
        *gas,
    ]
    if not measured:
        moving = sum(map(len, of_runs))
        if moving and not strokes and not steps:
            raise InputError(
                f"{listed[0].name}{_more(listed)}: the current is steady in none of the {moving} strokes, expected less "
                f"change than {100 * SAME_CURRENT:g} % of the largest current, {scale:.3g} A; hold it from {SETTLED:g} s "
                "before the strokes on, and record at least three cycles of a sine or a triangle"
            )
        which = f"{listed[0].name}{_more(listed)}: hold{'s' * (len(listed) == 1)}"
        raise InputError(
            f"{which} no repeated cycle and no stroke of constant speed at steady current, and no current step at constant "
            "speed to which the force responds; record at least three cycles of a sine or a triangle at a constant current"
        )
    values = [*measured, *_extent(listed)]
    order = list(QUANTITIES)
    values.sort(key=lambda v: (order.index(v.quantity), v.current or 0.0, v.direction != "rebound", v.speed or 0.0))
    curves = [
        curve
        for level in read
        for direction in DIRECTIONS
        if (curve := curve_of([stroke for stroke in level if stroke.direction == direction]))
    ]
    return Characterisation(
        name,
        tuple(listed),
        tuple(values),
        tuple(curves),
        tuple(_loops(groups)),
        tuple(responses),
        gas_curve,
        (*_limitations(levels, groups, gas, bool(steps), fast), *_too_short(short, least), *notes),
    )


def _more(runs: Sequence[Run]) -> str:
    return f" and {len(runs) - 1} more run{'s' * (len(runs) > 2)}" if len(runs) > 1 else ""


def _at_levels(of_runs: Sequence[Sequence[Stroke]], tolerance: float) -> list[list[Stroke]]:
    """Return the strokes of each run with the current of their level: the rounded mean of those that are the same."""
    steady = [stroke for of_run in of_runs for stroke in of_run if stroke.steady]
    level_of: dict[int, float] = {}
    for level in grouped(steady, lambda stroke: stroke.current, lambda _: tolerance):
        mean = float(np.mean([stroke.current for stroke in level]))
        current = rounded(mean, tolerance) if abs(mean) > 0.5 * tolerance else 0.0
        level_of |= {id(stroke): current for stroke in level}
    return [[replace(stroke, current=level_of.get(id(stroke), math.nan)) for stroke in of_run] for of_run in of_runs]


def _equal_cycles(cycles: Sequence[Cycle]) -> list[list[Cycle]]:
    """Group cycles of the same current, peak speed and stroke: those that are like the slowest cycle of the group."""
    groups: list[list[Cycle]] = []
    for cycle in sorted(cycles, key=lambda cycle: (cycle.current, cycle.peak_speed)):
        # By both at once: slower cycles of another stroke must not part equal ones.
        like = (group for group in groups if _equal(group[0], cycle))
        if (group := next(like, None)) is not None:
            group.append(cycle)
        else:
            groups.append([cycle])
    return groups


def _equal(one: Cycle, other: Cycle) -> bool:
    same_speed = abs(other.peak_speed - one.peak_speed) <= SPEED_GROUP * one.peak_speed
    return one.current == other.current and same_speed and abs(other.length - one.length) <= STROKE_GROUP * one.length


def _loops(groups: Sequence[Sequence[Cycle]]) -> list[Loop]:
    return [representative_loop(cycles) for cycles in groups]


def _extent(runs: Sequence[Run]) -> list[Value]:
    """Return the stroke that was used, and the temperatures that were recorded."""
    nan = float("nan")
    position = np.concatenate([run.position for run in runs])
    low, high = np.quantile(position, [0.001, 0.999])
    once = (nan, nan, nan, 0, len(runs))
    values = [
        Value(
            "stroke_used",
            *Average(float(high - low), *once),
            "Distance of the extreme positions of all runs (quantiles of 0.1 and 99.9 %).",
        )
    ]
    warm = [run.temperature for run in runs if run.temperature is not None]
    if warm:
        temperature = np.concatenate(warm)
        text = "{} temperature of the damper in the runs that recorded it."
        once = (nan, nan, nan, 0, len(warm))
        values.append(Value("temperature_least", float(temperature.min()), *once, text.format("Lowest")))
        values.append(Value("temperature_largest", float(temperature.max()), *once, text.format("Highest")))
    return values


def _limitations(
    levels: Sequence[Sequence[Stroke]], groups: Sequence[Sequence[Cycle]], gas: Sequence[Value], has_steps: bool, fast: float
) -> list[str]:
    """Return what the recordings do not show, and what to record for it."""
    sentences = []
    if not levels:
        sentences.append(
            "No strokes at steady current, so no forces over speed. Record sines or triangles, at least three cycles each, "
            "at constant currents."
        )
    if levels and not groups:
        sentences.append(
            "No cycle at steady current is repeated, so there are no peak forces, no energy and no loops. Record at least "
            "three equal cycles of a sine or a triangle at each current."
        )
    few = [group for group in groups if len(group) < ENOUGH_CYCLES]
    if few:
        sentences.append(
            f"{len(few)} of {len(groups)} combinations of current, speed and stroke have fewer than {ENOUGH_CYCLES} "
            "cycles, so that their scatter is hardly known. Record more cycles of each."
        )
    if len(levels) == 1:
        current = levels[0][0].current
        sentences.append(
            f"Only one steady current, {current:.3g} A, so no dynamic range. Repeat the strokes at the smallest and at the "
            "largest current."
        )
    found = {value.quantity for value in gas}
    if levels and "gas_force" not in found:
        slowest = 1e3 * min(stroke.peak_speed for stroke in long_strokes(levels[0]))
        missing = "no gas force" if "seal_drag" in found else "no gas force and no seal drag"
        sentences.append(
            f"No slow strokes over the whole stroke in both directions at the smallest current, so {missing}: the slowest "
            f"has {slowest:.3g} mm/s. Record triangles over the whole stroke at {1e3 * SLOW * fast:.2g} mm/s or less, best "
            "at two speeds, two cycles or more at each."
        )
    if not has_steps:
        sentences.append(
            "No current steps at constant speed, so no response times. Record triangles while the current steps between "
            "levels, each held until the force has settled."
        )
    return sentences


def _too_short(strokes: Sequence[Stroke], least: float) -> list[str]:
    """Return which strokes show no force at a speed, because they are shorter than ``least`` in m."""
    if not strokes:
        return []
    groups = grouped([stroke.peak_speed for stroke in strokes], float, lambda speed: SPEED_GROUP * speed)
    speeds = ", ".join(f"{1e3 * float(np.median(group)):.3g}" for group in groups)
    currents = ", ".join(f"{current:.3g}" for current in by_size(stroke.current for stroke in strokes))
    return [
        f"Strokes of {speeds} mm/s at {currents} A show no force at a speed and no seal drag: they are shorter than "
        f"{1e3 * least:.3g} mm, {100 * LEAST_LENGTH:g} % of the longest one, so that the fluid hardly yields in them. "
        "Record longer strokes at these speeds."
    ]
