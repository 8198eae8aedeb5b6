"""What the motion and the current of the runs let be seen."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Finding
from mrd_diagnosis.preflight.channels import MOVED, SHORT_STROKE, View, milli
from mrd_runs import Run
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

FEWEST_REVERSALS = 10
"""Of all runs together: before, loops cannot be told from drift."""
ONE_SPEED = 1.5
"""Ratio of the peak speeds of strokes; within it, speed and frequency do not separate effects."""


def coverage(views: Sequence[View], model: DamperModel | None) -> Iterator[Finding]:
    """Currents, strokes, reversals and speeds that are lacking, and what there is."""
    current = np.array([[view.run.current.min(), view.run.current.max(), view.run.current.mean()] for view in views])
    changing = [view for view in views if view.varies]
    dependent = f", nor how {model.id} depends on the current" if model is not None and model.laws else ""
    if not changing and np.ptp(current[:, 2]) < max(0.01, 0.02 * float(np.abs(current).max())):
        yield Finding(
            "coverage",
            "limitation",
            f"the current never changes ({current[:, 2].mean():.3g} A): effects of the magnetics stage cannot be tested"
            f"{dependent}; record runs with steps of the current",
            channel="current",
        )
    elif not changing:
        yield Finding(
            "coverage",
            "limitation",
            "the current is constant within every run: how the force follows a change of it (lag, hysteresis) cannot be "
            "tested; record a run with steps of the current",
            channel="current",
        )
    reversals = sum(len(view.strokes) - 1 for view in views)
    for view in views:
        if view.stroke < MOVED / 10:
            yield view.finding("coverage", "limitation", "position", "the rod rests: says nothing of the damper in motion")
        elif len(view.strokes) < 3:
            yield view.finding(
                "coverage",
                "limitation",
                "position",
                f"is shorter than one stroke to and fro ({len(view.strokes) - 1} reversals): no loop; record longer",
            )
    if all(len(view.strokes) < 3 for view in views):
        yield Finding(
            "coverage",
            "fault",
            "no run holds a stroke to and fro: there is no loop to compare; record longer",
            channel="position",
        )
    elif reversals < FEWEST_REVERSALS:
        yield Finding(
            "coverage",
            "limitation",
            f"{reversals} reversals in all runs, expected {FEWEST_REVERSALS} at least: effects at reversals (hysteresis, "
            "play, compliance) rest on too little; record longer",
            channel="position",
        )
    stroke = max(view.stroke for view in views)
    if stroke < SHORT_STROKE:
        yield Finding(
            "coverage",
            "limitation",
            f"no stroke is longer than {milli(stroke)} mm, expected {milli(SHORT_STROKE)} mm at least: the damper may "
            "never leave its pre-yield loop; record longer strokes",
            channel="position",
        )
    peaks, frequencies = _peaks_and_frequencies(views)
    if _alike(peaks):
        several = not _alike(frequencies)
        yield Finding(
            "coverage",
            "limitation",
            f"all strokes peak at one speed ({milli(float(np.median(peaks)))} mm/s): what grows with "
            f"{'it' if several else 'it, or with frequency,'} cannot be told from what does not; record other speeds",
            channel="position",
        )
    lowest = min(float(view.run.position.min()) for view in views)
    highest = max(float(view.run.position.max()) for view in views)
    at = f" at {frequencies.min():.2g} to {frequencies.max():.2g} Hz" if len(frequencies) else ""
    yield Finding(
        "coverage",
        "remark",
        f"{len(views)} runs, {sum(view.run.duration for view in views):.4g} s: position {milli(lowest)} to "
        f"{milli(highest)} mm, speed up to {milli(max(view.speed for view in views))} mm/s, current {current.min():.3g} "
        f"to {current.max():.3g} A, {reversals} reversals{at}",
    )


def one_speed(runs: Sequence[Run]) -> bool:
    """Whether all full strokes peak at about the same speed."""
    return _alike(_peaks_and_frequencies([View(run) for run in runs])[0])


def _alike(values: Array) -> bool:
    return bool(len(values) and np.quantile(values, 0.95) < ONE_SPEED * np.quantile(values, 0.05))


def _peaks_and_frequencies(views: Sequence[View]) -> tuple[Array, Array]:
    """Peak speed in m/s and frequency in Hz of every full stroke."""
    peaks, frequencies = [np.empty(0)], [np.empty(0)]
    for view in views:
        if len(view.strokes) > 2:
            peaks.append(np.maximum.reduceat(np.abs(view.run.velocity), view.strokes)[1:-1])
            frequencies.append(0.5 / np.diff(view.run.time[view.strokes])[1:])
    return np.concatenate(peaks), np.concatenate(frequencies)
