"""Bins of the axes over which the excess error is located: their bounds, their labels, and the bin of every sample."""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Axis
from mrd_diagnosis.localisation.events import distance_to_end, span_of_positions, travel_since_reversal
from mrd_diagnosis.wording.quantities import SMALLEST
from mrd_identification.recording import Recording, current_levels
from mrd_runs.scales import scales_of
from mrd_runs.signals.current_steps import time_since_step
from mrd_runs.text import named_run

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Labels = tuple[str, str, str]
"""Templates of the labels of the first bin, of a bin between others, and of the last bin."""

PLACES: tuple[Axis, ...] = ("reversal", "end", "step", "time", "sign", "run", "current", "position")
"""Axes on which a place tells where to look at the machine. Speed, acceleration and frequency of the motion do not."""

NEAREST_REVERSAL, NEAREST_END = 0.01, 0.02
"""First edge of the travel since a reversal, and of the distance to an end, over half the span of the position: around the
usual yield travels, and where end stops act."""

EDGES_OF_TRAVEL, EDGES_OF_DISTANCE = 5, 4
"""Edges of these axes."""

STEP_EDGES = (0.01, 0.03, 0.1, 0.3)
"""Edges in s of the time since a step of the current: coil, driver and eddy currents settle within tens of ms, whatever the
size of the damper."""

NEAR_LABELS: dict[Axis, Labels] = {
    "reversal": ("within {} mm after a reversal", "{} to {} mm after a reversal", "more than {} mm after a reversal"),
    "end": (
        "within {} mm of an end of the stroke",
        "{} to {} mm from an end of the stroke",
        "more than {} mm from the ends of the stroke",
    ),
    "step": (
        "within {} ms after a step of the current",
        "{} to {} ms after a step of the current",
        "away from steps of the current, by more than {} ms",
    ),
}
"""Labels of the axes that count from an event, in mm or ms."""

TIME_LABELS = ("the first {} s of the recordings", "{} to {} s into the recordings", "from {} s of the recordings on")

MOST_LEVELS = 9
"""Levels of the current, at most, that have a bin each; a current with more has even bins."""

LEVEL_BINS = 64
"""Bins of the histogram in which levels of the current are looked for."""

LEAST_SHARE_OF_LEVEL = 0.002
"""Share of the samples from which a bin of the histogram belongs to a level."""

WIDEST_LEVEL = 0.1
"""Share of the range of the current within which a level counts as one value."""

ROUNDING = 0.025
"""Share of the range of the current to which labels of its levels are rounded, at most: they differ, and show no noise."""

MOST_EVEN_BINS = 8
"""Even bins of an axis, at most."""

RANGE = (0.002, 0.998)
"""Quantiles of the values between which the edges lie, so that outliers do not make the bins wide."""


@dataclass(frozen=True)
class Bins:
    """Bins of one axis: their bounds in ``unit``, and their labels."""

    axis: Axis
    unit: str
    bounds: Sequence[tuple[float, float]]
    labels: Sequence[str]


def bins_of_axes(recordings: Sequence[Recording]) -> list[tuple[Bins, Indices]]:
    """Return the bins of every axis but the frequency, and the bin of every counted sample; -1 is no bin."""
    runs = [recording.run for recording in recordings]
    scales, span = scales_of(runs), span_of_positions(recordings)
    starts = np.cumsum([0.0, *(run.duration for run in runs)])

    def joined(series: Iterable[Array]) -> Array:
        return np.concatenate([values[of_run.counted] for of_run, values in zip(recordings, series, strict=True)])

    motions = [recording.motion for recording in recordings]
    positions = [motion.position for motion in motions]
    position, velocity = joined(positions), joined(motion.velocity for motion in motions)
    speed, acceleration = np.abs(velocity), np.abs(joined(motion.acceleration for motion in motions))
    time = joined(run.time + start for run, start in zip(runs, starts, strict=False))
    near: list[tuple[Axis, Iterable[Array], str]] = [
        ("reversal", (travel_since_reversal(of_run.path) for of_run in recordings), "m"),
        ("end", (distance_to_end(position, span) for position in positions), "m"),
        ("step", (time_since_step(of_run.run.time, of_run.smoothed.current, scales.current) for of_run in recordings), "s"),
    ]
    edges: dict[Axis, Array] = {
        "reversal": preferred_numbers(NEAREST_REVERSAL * scales.stroke, EDGES_OF_TRAVEL),
        "end": preferred_numbers(NEAREST_END * scales.stroke, EDGES_OF_DISTANCE),
        "step": np.array(STEP_EDGES),
    }
    return [
        *(_bins_between(axis, joined(series), unit, 1e3, edges[axis], NEAR_LABELS[axis]) for axis, series, unit in near),
        _bins_between("time", time, "s", 1.0, _even_edges(time), TIME_LABELS),
        _sign_bins(velocity),
        _run_bins(recordings),
        _current_bins(joined(of_run.smoothed.current for of_run in recordings), current_levels(runs)[0]),
        _bins_between("position", position, "m", 1e3, _even_edges(position), range_labels("positions", "mm")),
        _bins_between("velocity", speed, "m/s", 1e3, log_edges(speed), range_labels("speeds", "mm/s")),
        _bins_between(
            "acceleration", acceleration, "m/s²", 1.0, log_edges(acceleration), range_labels("accelerations", "m/s²")
        ),
    ]


def near_label(axis: Axis, upper: float) -> str:
    """Return where the values of an axis of `NEAR_LABELS` below ``upper``, in SI units, lie."""
    return NEAR_LABELS[axis][0].format(_number(1e3 * upper))


def preferred_numbers(first: float, count: int) -> Array:
    """Return ``count`` successive numbers of the series 1, 2, 5, 10, beginning with the one nearest to ``first``."""
    decade = np.floor(np.log10(first))
    series = np.outer(10.0 ** np.arange(decade, decade + count + 1), (1, 2, 5)).ravel()
    nearest = int(np.argmin(np.abs(np.log(series[:4] / first))))
    return np.array([float(f"{number:.1g}") for number in series[nearest : nearest + count]])


def labelled_bins(axis: Axis, unit: str, edges: Array, labelled_per_unit: float, labels: Labels) -> Bins:
    """Make bins between edges, the ends of the axis included; there are none without an inner edge.

    Parameters
    ----------
    axis, unit : str
    edges : ndarray (bins + 1,)
    labelled_per_unit : float
        Factor from ``unit`` to the unit of the labels.
    labels : tuple of str
    """
    bounds = list(itertools.pairwise(map(float, edges)))
    if len(bounds) < 2:
        return Bins(axis, unit, [], [])
    first, between, last = labels
    inner = [_number(edge * labelled_per_unit) for edge in edges[1:-1]]
    texts = [first.format(inner[0]), *(between.format(*pair) for pair in itertools.pairwise(inner)), last.format(inner[-1])]
    return Bins(axis, unit, bounds, texts)


def range_labels(quantity: str, unit: str) -> Labels:
    """Return the templates of labels such as "speeds of 20 to 50 mm/s"."""
    return f"{quantity} below {{}} {unit}", f"{quantity} of {{}} to {{}} {unit}", f"{quantity} above {{}} {unit}"


def log_edges(values: Array, decades: float = 2.0, series: Sequence[int] = (1, 2, 5)) -> Array:
    """Return inner edges at a series of preferred numbers within the uppermost ``decades`` of the values."""
    high = float(np.quantile(values, RANGE[1]))
    if high <= 0.0:
        return np.empty(0)
    top = int(np.floor(np.log10(high)))
    candidates = np.outer(10.0 ** np.arange(top - np.ceil(decades), top + 1), series).ravel()
    return np.asarray(candidates[(candidates > high / 10**decades) & (candidates < high)])


def _even_edges(values: Array) -> Array:
    """Return inner edges at multiples of 1, 2 or 5 times a power of ten."""
    low, high = np.quantile(values, RANGE)
    if high <= low:
        return np.empty(0)
    steps_within = MOST_EVEN_BINS - 1
    exponent = np.floor(np.log10((high - low) / steps_within))
    step = next(s for s in 10.0**exponent * np.array([1, 2, 5, 10]) if (high - low) / s <= steps_within)
    return np.asarray(np.arange(np.floor(low / step) + 1, np.ceil(high / step)) * step)


def _bins_between(
    axis: Axis, values: Array, unit: str, labelled_per_unit: float, edges: Array, labels: Labels
) -> tuple[Bins, Indices]:
    """Return the bins between edges, as far as they lie within the values, and the bin of every value."""
    low, high = float(values.min()), float(np.max(values, where=np.isfinite(values), initial=values.min()))
    inner = edges[(edges > low) & (edges < high)]
    bins = labelled_bins(axis, unit, np.array([low, *inner, high]), labelled_per_unit, labels)
    return bins, np.searchsorted(inner, values, "right")


def _run_bins(recordings: Sequence[Recording]) -> tuple[Bins, Indices]:
    places = [(float(k), float(k)) for k in range(1, len(recordings) + 1)]
    bins = Bins("run", "", places, [named_run(recording.run.name) for recording in recordings])
    return bins, np.repeat(np.arange(len(recordings)), [len(recording.force) for recording in recordings])


def _sign_bins(velocity: Array) -> tuple[Bins, Indices]:
    bin_of_sample = np.where(velocity < 0, 0, np.where(velocity > 0, 1, -1))
    return Bins("sign", "", [(-1.0, -1.0), (1.0, 1.0)], ["while compressing", "while extending"]), bin_of_sample


def _current_bins(current: Array, levels: int) -> tuple[Bins, Indices]:
    """Return a bin for each level of the current if there are few levels, and even bins otherwise."""
    if levels < 2:
        return Bins("current", "A", [], []), np.zeros(len(current), dtype=np.intp)
    counts, edges = np.histogram(current, LEVEL_BINS)
    occupied = np.flatnonzero(counts > LEAST_SHARE_OF_LEVEL * len(current))
    gaps = np.flatnonzero(np.diff(occupied) > 1)
    inner = 0.5 * (edges[occupied[gaps] + 1] + edges[occupied[gaps + 1]])
    unit, per_ampere = ("mA", 1e3) if np.abs(current).max() < SMALLEST else ("A", 1.0)
    if not 1 <= len(inner) < MOST_LEVELS:
        labels = f"at up to {{}} {unit}", f"at {{}} to {{}} {unit}", f"at more than {{}} {unit}"
        return _bins_between("current", current, "A", per_ampere, _even_edges(current), labels)
    bin_of_sample = np.searchsorted(inner, current)
    ends = [float(current.min()), *map(float, inner), float(current.max())]
    step = 10.0 ** np.floor(np.log10(ROUNDING * np.ptp(current)))

    def text(value: float) -> str:
        return _number(per_ampere * step * round(value / step))

    texts = []
    for level in range(len(inner) + 1):
        low, middle, high = np.quantile(current[bin_of_sample == level], (0.05, 0.5, 0.95))
        # Levels that overlap because of noise are one bin.
        wide = high - low > WIDEST_LEVEL * np.ptp(current)
        texts.append(f"at {text(low)} to {text(high)} {unit}" if wide else f"at {text(middle)} {unit}")
    return Bins("current", "A", list(itertools.pairwise(ends)), texts), bin_of_sample


def _number(value: float) -> str:
    return f"{value + 0.0:.4g}".replace("-", "\u2212")
