"""How far the gap closes: errors before and after, on what the parameters have not seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Interval, RunNoise, Trace
from mrd_diagnosis.model_comparison import Contest
from mrd_diagnosis.noise_model import run_noise
from mrd_diagnosis.refit import GapProblem, Refit, own_error, without_each
from mrd_diagnosis.statistics import closed, nrmse, resampled
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording

Array = NDArray[np.float64]

BEYOND = 1.15
"""A run goes beyond the others where its stroke, speed or current is larger than theirs by this factor."""

ALONE = 0.8
"""Share of what all runs say of an effect's parameter that makes one run the only one to say it."""


_NOTHING = {"stroke": 1e-4, "speed": 1e-3, "current": 0.02}
"""m, m/s, A: less is no difference."""


@dataclass(frozen=True)
class HowFar:
    """Errors as NRMSE with intervals, and the runs they come from.

    Attributes
    ----------
    floor, before, after : Interval
    closed : Interval
        Share of the explainable gap; nan without effects.
    extrapolated : Interval or None
        The same on the runs that go beyond the others, each predicted from the others alone.
    traces : tuple of Trace
    counted : tuple of Trace
        Those that the figures are of: the held-out runs where there are any.
    """

    floor: Interval
    before: Interval
    after: Interval
    closed: Interval
    extrapolated: Interval | None
    traces: tuple[Trace, ...]
    counted: tuple[Trace, ...]


def how_far(found: Contest, unseen: Sequence[Recording], rng: np.random.Generator) -> HowFar:
    """Errors of the model without and with the effects that were found.

    Parameters
    ----------
    found : Contest
    unseen : sequence of Recording
        Set aside from the start; without them, each of the fitted runs is judged by a fit to the others, and a run that goes
        beyond the others by fits to all but a part of it.
    rng : numpy Generator
    """
    recordings = found.ground.recordings
    beyond = [_beyond(recording, [*recordings[:run], *recordings[run + 1 :]]) for run, recording in enumerate(recordings)]
    in_parts = [bool(respect) or run in _alone_in(found) or len(recordings) == 1 for run, respect in enumerate(beyond)]
    alone, best = (_Left.out(fitted, found, in_parts) for fitted in (found.alone, found.best))
    traces = [
        _trace(found.best.problem, found.best.theta, run, noise, before, after, beyond[run], in_parts[run])
        for run, (noise, before, after) in enumerate(zip(found.ground.noises, alone.known, best.known, strict=True))
    ]
    held = _held_out(found, unseen, rng)
    traces += held
    counted = tuple(held or traces)
    before, after, floor, samples, draws = _units(counted, rng)
    variance = float(np.var(np.concatenate([trace.recording.force for trace in counted])))
    further = (
        [trace for trace in held if trace.extrapolates]
        if held
        else [
            replace(traces[run], before=alone.others[run], after=best.others[run])
            for run, respect in enumerate(beyond)
            if respect
        ]
    )
    extrapolated = None
    if further and found.effects:
        b, a, f, _, d = _units(further, rng)
        extrapolated = closed(b, a, f, d)
    return HowFar(
        nrmse(floor, samples, variance, draws),
        nrmse(before, samples, variance, draws),
        nrmse(after, samples, variance, draws),
        closed(before, after, floor, draws) if found.effects else Interval(np.nan),
        extrapolated,
        tuple(traces),
        counted,
    )


def closed_between(before: Refit, after: Refit, found: Contest, rng: np.random.Generator) -> Interval:
    """Share of the explainable gap that lies between two refits, on parts held out in turn."""
    floor = np.concatenate([noise.sigma for noise in found.ground.noises]) ** 2
    of_parts = np.array([floor[part].sum() for _, part in found.ground.parts])
    gap = found.alone.plain - of_parts
    draws = resampled(len(gap), rng)
    gained = before.plain - after.plain
    if gap.sum() <= 0:
        return Interval(np.nan)
    shares = (draws @ gained) / np.where(draws @ gap > 0, draws @ gap, np.nan)
    ends = np.nanquantile(np.clip(shares, -1.0, 1.0), (0.025, 0.975)) if np.isfinite(shares).any() else (np.nan, np.nan)
    return Interval(float(np.clip(gained.sum() / gap.sum(), -1.0, 1.0)), *map(float, ends))


def _beyond(recording: Recording, others: Sequence[Recording]) -> str:
    """In which respect a run goes beyond others; empty where it does not."""

    def reach(of: Recording) -> dict[str, float]:
        return {
            "stroke": float(np.ptp(of.path.position)),
            "speed": float(np.quantile(np.abs(of.path.velocity), 0.995)),
            "current": float(np.quantile(np.abs(of.path.current), 0.995)),
        }

    if not others:
        return ""
    own, rest = reach(recording), [reach(other) for other in others]
    return " and ".join(
        name for name, value in own.items() if value > BEYOND * max(other[name] for other in rest) + _NOTHING[name]
    )


def _alone_in(found: Contest) -> set[int]:
    """Runs that are (nearly) the only ones to say how large an effect is."""
    problem = found.best.problem
    of_effects = [i for i, parameter in enumerate(problem.parameters) if "." in parameter.name]
    places = np.array([run for run, _ in found.ground.parts])
    told = np.stack([np.diagonal(gram)[of_effects] for gram in found.best.grams])
    by_run = np.stack([told[places == run].sum(axis=0) for run in range(len(found.ground.recordings))])
    shares = by_run / np.maximum(by_run.sum(axis=0), 1e-300)
    return set(map(int, np.flatnonzero((shares > ALONE).any(axis=1))))


def _of_runs(fitted: Refit, found: Contest) -> Array:
    """Parameters (runs, parameters) that have not seen the run: a step from the joint optimum, then fitted to the others."""
    problem = fitted.problem
    places = np.array([run for run, _ in found.ground.parts])
    runs = range(len(found.ground.recordings))
    grams = np.stack([fitted.grams[places == run].sum(axis=0) for run in runs])
    slopes = np.stack([fitted.slopes[places == run].sum(axis=0) for run in runs])
    starts = without_each(problem, problem.unit(fitted.theta), grams, slopes)

    def of(run: int) -> Array:
        silent = problem.whitenings[run].silent()
        others = replace(problem, whitenings=(*problem.whitenings[:run], silent, *problem.whitenings[run + 1 :]))
        unit, _ = levenberg_marquardt(others, problem.unit(starts[run]), np.arange(len(problem.free)), 10, 1e-4, renewal=4)
        return problem.theta(unit)

    return np.stack(in_threads(of, list(runs)))


@dataclass(frozen=True)
class _Left:
    """Measured minus modelled force in N of each run.

    Attributes
    ----------
    others : list of ndarray
        By parameters that have not seen the run.
    known : list of ndarray
        The same, but by such that have not seen the part where no other run reaches as far.
    """

    others: list[Array]
    known: list[Array]

    @classmethod
    def out(cls, fitted: Refit, found: Contest, in_parts: Sequence[bool]) -> "_Left":
        problem, runs = fitted.problem, range(len(in_parts))
        thetas = _of_runs(fitted, found) if len(in_parts) > 1 else [fitted.theta]
        others = [-own_error(problem, thetas[run], run)[1] for run in runs]
        parts = without_each(problem, problem.unit(fitted.theta), fitted.grams, fitted.slopes)
        known = list(others)
        for run in runs:
            if not in_parts[run]:
                continue
            known[run] = np.empty_like(others[run])
            for (place, part), theta in zip(found.ground.parts, parts, strict=True):
                if place == run:
                    here = slice(part.start - problem.blocks[run].start, part.stop - problem.blocks[run].start)
                    known[run][here] = -own_error(problem, theta, run)[1][here]
        return cls(others, known)


def _trace(
    problem: GapProblem, theta: Array, run: int, noise: RunNoise, before: Array, after: Array, beyond: str, in_parts: bool
) -> Trace:
    recording = problem.recordings[run]
    gain, offset = problem.whitenings[run].own @ (recording.force - problem.modelled(theta, run))
    return Trace(recording, noise, before, after, float(offset), float(gain), extrapolates=beyond, in_parts=in_parts)


def _held_out(found: Contest, unseen: Sequence[Recording], rng: np.random.Generator) -> list[Trace]:
    """Runs that were set aside, with the parameters of all others; they count as recorded after these."""
    if not unseen:
        return []
    alone, best, recordings = found.alone, found.best, found.ground.recordings
    noises = run_noise(unseen, best.problem.model, best.theta, rng)
    ground = replace(found.ground, recordings=[*recordings, *unseen], noises=[*found.ground.noises, *noises])
    both = [(ground.problem(fitted.problem.model, fitted.theta), fitted.theta) for fitted in (alone, best)]
    traces = []
    for run, (recording, noise) in enumerate(zip(unseen, noises, strict=True), len(recordings)):
        before, after = (-own_error(problem, theta, run)[1] for problem, theta in both)
        beyond = _beyond(recording, recordings)
        traces.append(replace(_trace(*both[1], run, noise, before, after, beyond, False), held_out=True))
    return traces


def _units(traces: Sequence[Trace], rng: np.random.Generator) -> tuple[Array, Array, Array, Array, Array]:
    """Squared errors in N² before, after and of the floor, samples, and bootstrap draws, by what scatters independently.

    These are runs; of fewer than four, stretches of theirs.
    """
    pieces = 1 if len(traces) >= 4 else -(-8 // len(traces))

    def cut(series: Array) -> list[Array]:
        return np.array_split(series, pieces)

    before = np.array([float(p @ p) for trace in traces for p in cut(trace.before)])
    after = np.array([float(p @ p) for trace in traces for p in cut(trace.after)])
    floor = np.array([float(p @ p) for trace in traces for p in cut(trace.noise.sigma)])
    samples = np.array([float(len(p)) for trace in traces for p in cut(trace.before)])
    return before, after, floor, samples, resampled(len(samples), rng)
