"""Checks of the excitation: what the motion and the current of the runs let a diagnosis see."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.preflight.channels import CheckedRun, counted, milli
from mrd_identification.preflight.finding import Finding
from mrd_identification.recording import current_levels
from mrd_runs import Run
from mrd_runs.faults import relative_work
from mrd_runs.scales import scales_of
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

RESTING = 0.005
"""Share of half the span of all positions, up to which a rod rests."""
SPRING_WORK = 0.25
"""Work done on the damper over the largest work of the same forces, up to which it acts like a spring."""
FEWEST_REVERSALS = 10
"""Reversals in all runs together, below which hysteresis loops cannot be told from drift."""
ONE_SPEED_RATIO = 1.5
"""Ratio of the peak speeds of strokes (95 % to 5 % quantile) below which they count as one speed. Within it, speed and
frequency do not separate effects."""
SAME_SPEED_RATIO = 1.1
"""Ratio of the peak speeds (95 % to 5 % quantile) below which strokes of one frequency count as the same stroke."""


def check_excitation(runs: Sequence[CheckedRun], model: DamperModel | None) -> Iterator[Finding]:
    """Find currents, strokes, reversals and speeds that the runs lack, and sum up what the runs have."""
    yield from _check_currents(runs, model)
    yield from _check_reversals(runs)
    yield from _check_strokes_and_speeds(runs)
    yield _summary(runs)


def _check_currents(runs: Sequence[CheckedRun], model: DamperModel | None) -> Iterator[Finding]:
    levels, varies = current_levels([checked.run for checked in runs])
    if varies:
        return
    if levels == 1:
        mean = np.mean([checked.run.current.mean() for checked in runs])
        dependence = f", and neither can how {model.id} depends on the current" if model is not None and model.laws else ""
        text = (
            f"the current never changes ({mean:.3g} A): effects of the magnetics stage cannot be tested{dependence}."
            " Record runs with steps of the current."
        )
    else:
        text = (
            "the current is constant within every run: the lag and the hysteresis of the force behind a change of the "
            "current cannot be tested. Record a run with steps of the current."
        )
    yield Finding("coverage", "limitation", text, channel="current")


def _check_reversals(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    for checked in runs:
        reversals = len(checked.stroke_starts) - 1
        if checked.stroke < RESTING * checked.scales.stroke:
            text = "the rod rests: this run says nothing about the damper in motion. Record it with motion, or leave it out."
        elif reversals < 2:
            text = (
                f"the run is shorter than one stroke to and fro: it has {counted(reversals, 'reversal')}, expected at "
                "least 2. It holds no loop of force over position. Record a longer run."
            )
        else:
            continue
        yield checked.finding("coverage", "limitation", "position", text)
    reversals = _reversals(runs)
    if all(len(checked.stroke_starts) < 3 for checked in runs):
        text = "no run holds a stroke to and fro: expected at least one loop of force over position. Record longer runs."
        yield Finding("coverage", "fault", text, channel="position")
    elif reversals < FEWEST_REVERSALS:
        text = (
            f"{counted(reversals, 'reversal')} in all runs, expected at least {FEWEST_REVERSALS}: effects at reversals "
            "(hysteresis, play, compliance) rest on too few data. Record longer runs."
        )
        yield Finding("coverage", "limitation", text, channel="position")


def _check_strokes_and_speeds(runs: Sequence[CheckedRun]) -> Iterator[Finding]:
    if max(relative_work(checked.run) for checked in runs) < SPRING_WORK:
        longest = milli(max(checked.stroke for checked in runs))
        text = (
            f"the damper gives back most of the work that is done on it, with strokes of up to {longest} mm: expected that "
            "it dissipates it. It may never leave its pre-yield loop. Record longer strokes."
        )
        yield Finding("coverage", "limitation", text, channel="position")
    peaks, frequencies = _peaks_and_frequencies(runs)
    if _are_alike(peaks):
        speed = "speed or frequency" if _are_alike(frequencies) else "speed"
        text = (
            f"all strokes peak at one speed ({milli(float(np.median(peaks)))} mm/s): effects that grow with {speed} cannot "
            "be told from effects that do not. Record other speeds."
        )
        yield Finding("coverage", "limitation", text, channel="position")


def _summary(runs: Sequence[CheckedRun]) -> Finding:
    current = np.array([[checked.run.current.min(), checked.run.current.max()] for checked in runs])
    lowest = min(float(checked.run.position.min()) for checked in runs)
    highest = max(float(checked.run.position.max()) for checked in runs)
    _, frequencies = _peaks_and_frequencies(runs)
    band = f", motion at {frequencies.min():.2g} to {frequencies.max():.2g} Hz" if len(frequencies) else ""
    rates = sorted({f"{1 / checked.sampling_interval:.4g}" for checked in runs}, key=float)
    text = (
        f"{counted(len(runs), 'run')}, {sum(checked.run.duration for checked in runs):.4g} s, sampled at "
        f"{' to '.join(dict.fromkeys((rates[0], rates[-1])))} Hz: position {milli(lowest)} to {milli(highest)} mm, speed up "
        f"to {milli(max(checked.top_speed for checked in runs))} mm/s, current {current.min():.3g} to {current.max():.3g} "
        f"A, {counted(_reversals(runs), 'reversal')}{band}."
    )
    return Finding("coverage", "remark", text.replace("-", "\u2212"))


def has_one_peak_speed(runs: Sequence[Run]) -> bool:
    """Whether all full strokes of the runs have about the same peak speed."""
    return _are_alike(_peaks_and_frequencies([CheckedRun(run, scales_of(runs)) for run in runs])[0])


def repeats_one_stroke(runs: Sequence[Run]) -> bool:
    """Whether all full strokes of the runs are the same: a single sine, at whatever currents."""
    peaks, frequencies = _peaks_and_frequencies([CheckedRun(run, scales_of(runs)) for run in runs])
    return _are_alike(peaks, SAME_SPEED_RATIO) and _are_alike(frequencies)


def _reversals(runs: Sequence[CheckedRun]) -> int:
    return sum(len(checked.stroke_starts) - 1 for checked in runs)


def _are_alike(values: Array, ratio: float = ONE_SPEED_RATIO) -> bool:
    return bool(len(values) and np.quantile(values, 0.95) < ratio * np.quantile(values, 0.05))


def _peaks_and_frequencies(runs: Sequence[CheckedRun]) -> tuple[Array, Array]:
    """Return the peak speed in m/s and the frequency in Hz of every full stroke."""
    peaks, frequencies = [np.empty(0)], [np.empty(0)]
    for checked in runs:
        starts = checked.stroke_starts
        if len(starts) > 2:
            peaks.append(np.maximum.reduceat(np.abs(checked.run.velocity), starts)[1:-1])
            frequencies.append(0.5 / np.diff(checked.run.time[starts])[1:])
    return np.concatenate(peaks), np.concatenate(frequencies)
