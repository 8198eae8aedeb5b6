"""Series that were recorded each on its own time, put onto one."""

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

Array = NDArray[np.float64]
Series = tuple[Array, Array]

MOTION = ("position", "velocity", "acceleration", "force")
_SLOW = 3.0
"""Intervals of the common time within one of a series, from which that series is held: it is that of a command. A series
of motion that a recording does not need is left out then."""
_MOST_SAMPLES = 10**7
_HOLE = 5.0
"""Interval of a series of motion or force, in its usual ones, from which nothing is interpolated in it."""
_USUAL = 0.95
"""Quantile of the intervals that is the usual one: times of receipt may come in bursts, between which nothing is missing."""


def synchronise(
    series: Mapping[str, Series], rate: float | None, where: str, asked: Collection[str] = ()
) -> tuple[dict[str, Array], list[str]]:
    """Put series onto the time that all of them cover.

    The samples are those of the slower one of position (velocity, where there is no position) and force, so that neither
    gets values that nobody measured; or evenly spaced ones, where a rate is given. A series that is faster is averaged
    between the midpoints of the samples: interpolation would alias its noise. One that is about as fast is interpolated
    linearly. An acceleration, or a velocity beside a position, that is much slower is left out; where it was asked for, the
    samples are its own. A current or a temperature that is much slower keeps its last value. Where motion or force has a
    hole, there are no samples: the time has a gap there.

    Parameters
    ----------
    series : mapping of str to (ndarray (m,), ndarray (m,))
        Increasing times in s, and values, by quantity.
    rate : float, optional
        In Hz.
    where : str
        Prefix of error messages.
    asked : collection of str
        Quantities that are not left out.

    Returns
    -------
    columns : dict of str to ndarray (n,)
        By quantity, with ``time``, which begins at 0.
    notes : list of str
        What was done with each series.

    Raises
    ------
    InputError
        When the series have no time in common.
    """
    intervals = {name: float(np.median(np.diff(time))) if len(time) > 1 else np.inf for name, (time, _) in series.items()}
    needed = ["position" if "position" in series else "velocity", "force"]
    slowest = max(needed, key=intervals.__getitem__)
    slow = [name for name in MOTION if name in series and intervals[name] > _SLOW * intervals[slowest]]
    left_out = [name for name in slow if name not in asked]
    slowest = max([slowest, *(name for name in slow if name in asked)], key=intervals.__getitem__)
    notes = [
        f"the {name} is left out: at {1 / intervals[name]:.4g} Hz it is much slower than the {slowest}; to slow that down "
        f"as well, name the {name} with --map"
        for name in left_out
    ]
    series = {name: values for name, values in series.items() if name not in left_out}
    moving = [series[name][0] for name in MOTION if name in series]
    begin, end = max(time[0] for time in moving), min(time[-1] for time in moving)
    if not begin < end:
        spans = ", ".join(f"{name} {time[0] - begin:.6g} to {time[-1] - begin:.6g} s" for name, (time, _) in series.items())
        raise InputError(f"{where}: the series have no time in common ({spans}); expected one recording of all")
    if rate is not None:
        if (end - begin) * rate > _MOST_SAMPLES:
            raise InputError(f"{where}: {end - begin:.6g} s at {rate:g} Hz are more than {_MOST_SAMPLES} samples")
        common = begin + np.arange(int((end - begin) * rate + 1e-6) + 1) / rate
        origin = f"at {rate:g} Hz, evenly spaced"
    else:
        common = series[slowest][0]
        common = common[(common >= begin) & (common <= end)]
        origin = f"those of the {slowest}, {1 / intervals[slowest]:.4g} Hz, the slowest of motion and force"
    common, holes = _without_holes(series, common)
    if len(common) < 2:
        raise InputError(f"{where}: the series have {len(common)} samples in common; expected one recording of all")
    step = float(np.median(np.diff(common)))
    columns = {"time": common - common[0]}
    done: dict[str, list[str]] = {}
    beyond: list[str] = []
    for name, (time, values) in series.items():
        place = np.minimum(np.searchsorted(time, common), len(time) - 1)
        if np.array_equal(time[place], common) and 1.5 * intervals[name] > step:
            columns[name] = values[place]
            continue
        if name not in MOTION and intervals[name] > _SLOW * step:
            columns[name], how = _held(time, values, common), "keeps its last value"
        elif intervals[name] < step / 1.5:
            columns[name], how = _averaged(time, values, common), "is averaged between them"
        else:
            columns[name], how = np.interp(common, time, values), "is interpolated linearly"
        done.setdefault(how, []).append(name)
        for missing, word in (time[0] - common[0], "begins"), (common[-1] - time[-1], "ends"):
            if missing > max(step, intervals[name]):
                kept = (
                    "later; before that it has its first value" if word == "begins" else "earlier, and keeps its last value"
                )
                beyond.append(f"{name} {word} {missing:.3g} s {kept}")
    told = [f"the samples are {origin}" + "".join(f"; {' and '.join(names)} {how}" for how, names in done.items()), *notes]
    told += beyond + holes
    gap = float(np.diff(common).max())
    if gap > _HOLE * step:
        told.append(f"the longest gap between two samples is {gap:.3g} s, {gap / step:.0f} times the usual one")
    return columns, told if done or notes or holes or rate is not None or gap > _HOLE * step else []


@np.errstate(all="ignore")  # a stranger's numbers may be anything
def _without_holes(series: Mapping[str, Series], common: Array) -> tuple[Array, list[str]]:
    """Leave out the samples within holes of the series of motion and force; return the others and notes on the holes."""
    kept, notes = np.ones(len(common), bool), []
    for name in MOTION:
        if name not in series or len(time := series[name][0]) < 2:
            continue
        steps = np.diff(time)
        before = np.clip(np.searchsorted(time, common, "right") - 1, 0, len(steps) - 1)
        inside = (steps[before] > _HOLE * np.quantile(steps, _USUAL)) & (common > time[before]) & (common < time[before + 1])
        if inside.any():
            kept &= ~inside
            count, longest = len(np.unique(before[inside])), float(steps[before[inside]].max())
            notes.append(
                f"{name} has {count} {'hole' if count == 1 else 'holes'} of up to {longest:.3g} s; the "
                f"{np.count_nonzero(inside)} samples within are left out"
            )
    return common[kept], notes


def _held(time: Array, values: Array, common: Array) -> Array:
    return np.asarray(values[np.maximum(np.searchsorted(time, common, "right") - 1, 0)])


def _extended(time: Array, values: Array, common: Array) -> tuple[Array, Array]:
    """Return a series that covers the common time, with its first and last value beyond its ends."""
    before, after = common[:1][common[:1] < time[0]], common[-1:][common[-1:] > time[-1]]
    held = [np.repeat(values[:1], len(before)), values, np.repeat(values[-1:], len(after))]
    return np.concatenate([before, time, after]), np.concatenate(held)


def _averaged(time: Array, values: Array, common: Array) -> Array:
    """Average a series, linear between its samples, from midpoint to midpoint of the common time, but not over gaps of it;
    beyond its ends it keeps its first and last value.
    """
    time, values = _extended(time, values, common)
    steps = np.diff(common)
    half = 0.5 * np.where(steps > _HOLE * np.median(steps), np.median(steps), steps)
    edges = np.stack([common - np.append(0.0, half), common + np.append(half, 0.0)])
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time))])
    # Between two samples the integral is a parabola.
    index = np.clip(np.searchsorted(time, edges, "right") - 1, 0, len(time) - 2)
    since = edges - time[index]
    slope = (values[index + 1] - values[index]) / (time[index + 1] - time[index])
    at_edges = integral[index] + since * (values[index] + 0.5 * slope * since)
    return np.asarray((at_edges[1] - at_edges[0]) / (edges[1] - edges[0]))
