"""Closure: how far the gap closes with the causes, on data that the parameters were not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Interval, RunNoise, RunResidual
from mrd_diagnosis.fitting.refit import Refit, without_each
from mrd_diagnosis.fitting.statistics import (
    bootstrap_counts,
    bootstrap_interval,
    closed_fraction,
    finite_costs,
    nrmse_interval,
)
from mrd_diagnosis.fitting.weighting import error_of_run
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording
from mrd_identification.run_start import estimate_starts
from mrd_runs.scales import scales_of

Array = NDArray[np.float64]

NO_DIFFERENCE = {"stroke": 0.005, "speed": 0.01, "current": 0.03}
"""Differences, in the scales of the recordings, that do not count as extrapolation."""

LEAST_RUNS_TO_RESAMPLE = 4
"""Runs from which on a bootstrap draws runs; of fewer, it draws segments of them."""

LEAST_SEGMENTS = 8
"""Segments of all runs together in such a bootstrap."""


@dataclass(frozen=True)
class Closure:
    """Errors as NRMSE with intervals, and the residuals from which they were computed.

    Attributes
    ----------
    noise_floor, before, after : Interval
    closed_fraction : Interval
        Share of the explainable gap; nan without effects.
    is_worse : bool
        Whether whole runs are surely predicted worse with the effects.
    extrapolated : Interval or None
        The same on the runs that exceed the others, each predicted from the others only.
    residuals : tuple of RunResidual
    counted : tuple of RunResidual
        The residuals behind these figures: those of the held-out runs where there are any.
    """

    noise_floor: Interval
    before: Interval
    after: Interval
    closed_fraction: Interval
    is_worse: bool
    extrapolated: Interval | None
    residuals: tuple[RunResidual, ...]
    counted: tuple[RunResidual, ...]


def compute_closure(
    comparison: ModelComparison,
    held_out: Sequence[Recording],
    rng: np.random.Generator,
    held_out_with_effects: Sequence[Recording] | None = None,
) -> Closure:
    """Compute the errors of the model without and with the chosen effects.

    Parameters
    ----------
    comparison : ModelComparison
    held_out : sequence of Recording
        Runs that were set aside from the start. Without them, each fitted run is judged by a fit to the others, and a run
        that exceeds the others by fits to all but one of its folds.
    rng : numpy Generator
    held_out_with_effects : sequence of Recording, optional
        The same runs with what a simulator of the user's own answers to them with the effects.
    """
    recordings = comparison.weighting.recordings
    excesses = [
        exceeded_ranges(recording, [*recordings[:run], *recordings[run + 1 :]]) for run, recording in enumerate(recordings)
    ]
    sole_sources = _sole_sources(comparison)
    # A common remainder predicts parts of a run from its other parts, not a whole run from others.
    always = len(recordings) == 1 or any(recording.without_effects for recording in recordings)
    by_folds = [always or bool(excess) or run in sole_sources for run, excess in enumerate(excesses)]
    best = comparison.best
    changed = [run for run, recording in enumerate(recordings) if not recording.without_effects]
    # A fit without a run costs as much as the joint one, so only where its figures are used.
    alone = [run for run in changed if not by_folds[run] or (excesses[run] and not held_out and comparison.effects)]
    before, after = (_leave_out(refit, comparison, alone, by_folds) for refit in (comparison.base, best))
    noise = comparison.weighting.noise
    residuals = [
        _run_residual(
            best, run, recordings[run], noise[run], before.known[run], after.known[run], excesses[run], by_folds[run]
        )
        for run in changed
    ]
    set_aside = _set_aside(comparison, held_out, held_out_with_effects or held_out, rng)
    residuals += set_aside
    counted = tuple(set_aside or residuals)
    squares_before, squares_after, squares_noise, samples, draws = _bootstrap_units(counted, rng)
    variance = float(np.var(np.concatenate([residual.recording.force for residual in counted])))
    if set_aside or not comparison.effects:
        beyond = [residual for residual in set_aside if residual.extrapolates]
    else:
        beyond = [
            replace(residual, before=before.by_other_runs[run], after=after.by_other_runs[run])
            for run, residual in zip(changed, residuals, strict=True)
            if residual.extrapolates
        ]
    extrapolated = None
    if beyond and comparison.effects:
        b, a, n, _, d = _bootstrap_units(beyond, rng)
        extrapolated = closed_fraction(b, a, n, d)
    closed = quantiles = Interval(np.nan)
    if comparison.effects:
        closed, quantiles = (
            closed_fraction(squares_before, squares_after, squares_noise, draws, widened=widened)
            for widened in (True, False)
        )
    return Closure(
        nrmse_interval(squares_noise, samples, variance, draws),
        nrmse_interval(squares_before, samples, variance, draws),
        nrmse_interval(squares_after, samples, variance, draws),
        closed,
        quantiles.upper < 0.0,
        extrapolated,
        tuple(residuals),
        counted,
    )


def closed_fraction_between(
    before: Refit, after: Refit, comparison: ModelComparison, rng: np.random.Generator, *, widened: bool = True
) -> Interval:
    """Return the share of the gap between two refits, on folds that are held out in turn; in those from before a
    change, there is none.

    ``widened`` is as of `mrd_diagnosis.fitting.statistics.bootstrap_interval`.
    """
    recordings = comparison.weighting.recordings
    acting = [place for place, (run, _) in enumerate(comparison.weighting.folds) if not recordings[run].without_effects]
    variance = np.concatenate([noise.sigma for noise in comparison.weighting.noise]) ** 2
    noise_of_folds = np.array([variance[fold].sum() for _, fold in comparison.weighting.folds])
    without_effects, lacking, fitted = (finite_costs(refit.held_out_squares) for refit in (comparison.base, before, after))
    gap = (without_effects - noise_of_folds)[acting]
    draws = bootstrap_counts(len(gap), rng)
    gained = (lacking - fitted)[acting]
    if gap.sum() <= 0:
        return Interval(np.nan)
    shares = (draws @ gained) / np.where(draws @ gap > 0, draws @ gap, np.nan)
    value, bounds = float(np.clip(gained.sum() / gap.sum(), -1.0, 1.0)), (-1.0, 1.0)
    return bootstrap_interval(value, np.clip(shares, *bounds), len(gap), bounds, widened=widened)


def exceeded_ranges(recording: Recording, others: Sequence[Recording]) -> str:
    """Return in which respect a run exceeds others, such as "stroke and speed"; empty where it does not."""

    def ranges(of_recording: Recording) -> dict[str, float]:
        path = of_recording.path.recorded
        return {
            "stroke": float(np.ptp(path.position)),
            "speed": float(np.quantile(np.abs(path.velocity), 0.995)),
            "current": float(np.quantile(np.abs(path.current), 0.995)),
        }

    if not others:
        return ""
    scales = scales_of([other.run for other in (recording, *others)])
    ranges_of_run, ranges_of_others = ranges(recording), [ranges(other) for other in others]
    return " and ".join(
        name
        for name, value in ranges_of_run.items()
        if value
        > THRESHOLDS.extrapolation * max(other[name] for other in ranges_of_others)
        + NO_DIFFERENCE[name] * getattr(scales, name)
    )


def _sole_sources(comparison: ModelComparison) -> set[int]:
    """Return the runs that are nearly the only ones to determine a parameter of an effect."""
    problem = comparison.best.problem
    of_effects = [i for i, parameter in enumerate(problem.parameters) if "." in parameter.name]
    run_of_fold = np.array([run for run, _ in comparison.weighting.folds])
    information = np.stack([np.diagonal(matrix)[of_effects] for matrix in comparison.best.normal_matrices])
    runs = range(len(comparison.weighting.recordings))
    by_run = np.stack([information[run_of_fold == run].sum(axis=0) for run in runs])
    shares = by_run / np.maximum(by_run.sum(axis=0), 1e-300)
    return set(map(int, np.flatnonzero((shares > THRESHOLDS.sole_information).any(axis=1))))


@dataclass(frozen=True)
class _HeldOutErrors:
    """Measured minus modelled force in N of each run.

    Attributes
    ----------
    by_other_runs : dict
        With parameters that were fitted without the run, by run, where they were.
    known : dict
        The same; where the run exceeds the others, with parameters that were fitted without the fold instead.
    """

    by_other_runs: dict[int, Array]
    known: dict[int, Array]


def _leave_out(refit: Refit, comparison: ModelComparison, alone: Sequence[int], by_folds: Sequence[bool]) -> _HeldOutErrors:
    """Return the errors of runs that are left out ``alone``, and of those whose folds are left out in turn."""
    problem = refit.problem
    fits = _without_each_run(refit, comparison, alone)
    by_other_runs = {
        run: -error_of_run(problem, theta, run, rest).newtons for run, (theta, rest) in zip(alone, fits, strict=True)
    }
    thetas, coefficients = without_each(
        problem, problem.unit(refit.theta), refit.coefficients, refit.normal_matrices, refit.gradients
    )
    known = dict(by_other_runs)
    for run in map(int, np.flatnonzero(by_folds)):
        known[run] = np.empty(problem.blocks[run].stop - problem.blocks[run].start)
        for (run_of_fold, fold), theta, rest in zip(comparison.weighting.folds, thetas, coefficients, strict=True):
            if run_of_fold == run:
                samples = slice(fold.start - problem.blocks[run].start, fold.stop - problem.blocks[run].start)
                known[run][samples] = -error_of_run(problem, theta, run, rest).newtons[samples]
    return _HeldOutErrors(by_other_runs, known)


def _without_each_run(refit: Refit, comparison: ModelComparison, runs: Sequence[int]) -> list[tuple[Array, Array]]:
    """Fit parameters and coefficients of the remainder without each of some runs, from one step off the joint optimum."""
    if not runs:
        return []
    problem = refit.problem
    run_of_fold = np.array([run for run, _ in comparison.weighting.folds])
    matrices = np.stack([refit.normal_matrices[run_of_fold == run].sum(axis=0) for run in runs])
    gradients = np.stack([refit.gradients[run_of_fold == run].sum(axis=0) for run in runs])
    starts, _ = without_each(problem, problem.unit(refit.theta), refit.coefficients, matrices, gradients)

    def fit_without(run: int) -> tuple[Array, Array]:
        weightless = problem.whitenings[run].without_weight()
        others = replace(problem, whitenings=(*problem.whitenings[:run], weightless, *problem.whitenings[run + 1 :]))
        free = np.arange(len(problem.free))
        unit, _ = levenberg_marquardt(others, problem.unit(starts[runs.index(run)]), free, 10, 1e-4, renewal=4)
        theta = problem.theta(unit)
        return theta, others.coefficients(theta)

    return in_threads(fit_without, runs)


def _run_residual(
    best: Refit, run: int, plain: Recording, noise: RunNoise, before: Array, after: Array, extrapolates: str, by_folds: bool
) -> RunResidual:
    problem, recording = best.problem, best.problem.recordings[run]
    modelled = problem.modelled(best.theta, run) + problem.remainder_of_run(best.coefficients, run)
    gain, offset, *_ = problem.whitenings[run].run_errors @ (recording.force - modelled)
    return RunResidual(plain, noise, before, after, float(offset), float(gain), extrapolates=extrapolates, by_folds=by_folds)


def _set_aside(
    comparison: ModelComparison, plain: Sequence[Recording], with_effects: Sequence[Recording], rng: np.random.Generator
) -> list[RunResidual]:
    """Return the residuals of runs that were set aside; they count as recorded after the others."""
    if not plain:
        return []
    base, best, weighting = comparison.base, comparison.best, comparison.weighting
    first = len(weighting.recordings)
    with_effects = estimate_starts(best.problem.model, best.theta, [*best.problem.recordings, *with_effects])[first:]
    noise = estimate_noise(with_effects, best.problem.model, best.theta, rng)
    started = [
        replace(
            recording, path=recording.path.led_in(begun.path.lead_in), counted=begun.counted, other_starts=begun.other_starts
        )
        for recording, begun in zip(plain, with_effects, strict=True)
    ]
    fits = []
    for fit, recordings in ((base, started), (best, with_effects)):
        extended = replace(weighting, recordings=[*fit.problem.recordings, *recordings], noise=[*weighting.noise, *noise])
        fits.append(replace(fit, problem=extended.problem(fit.problem.model, fit.theta)))
    residuals = []
    for run, (recording, noise_of_run) in enumerate(zip(started, noise, strict=True), first):
        before, after = (-error_of_run(fit.problem, fit.theta, run).newtons for fit in fits)
        excess = exceeded_ranges(recording, weighting.recordings)
        residual = _run_residual(fits[1], run, recording, noise_of_run, before, after, excess, False)
        residuals.append(replace(residual, held_out=True))
    return residuals


def _bootstrap_units(residuals: Sequence[RunResidual], rng: np.random.Generator) -> tuple[Array, Array, Array, Array, Array]:
    """Return squared errors in N² (before, after, noise) and samples of each unit, and bootstrap draws of the units.

    The units, which scatter independently, are runs, or segments of them where there are few runs.
    """
    pieces = 1 if len(residuals) >= LEAST_RUNS_TO_RESAMPLE else -(-LEAST_SEGMENTS // len(residuals))

    def squares(series: Sequence[Array]) -> Array:
        return np.array([float(piece @ piece) for whole in series for piece in np.array_split(whole, pieces)])

    before = squares([residual.before for residual in residuals])
    after = squares([residual.after for residual in residuals])
    noise = squares([residual.noise.sigma for residual in residuals])
    samples = np.array([float(len(piece)) for residual in residuals for piece in np.array_split(residual.before, pieces)])
    return before, after, noise, samples, bootstrap_counts(len(samples), rng)
