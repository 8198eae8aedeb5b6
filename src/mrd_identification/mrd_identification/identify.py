"""Identify a damper model from recordings: NSGA-II, its knee, then least squares."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_identification.metrics import Metrics, metrics
from mrd_identification.nsga2 import Front, search
from mrd_identification.polish import Intervals, intervals, polish
from mrd_identification.problem import Problem, Recording, free_parameters, prepare
from mrd_runs import Run
from mrd_sim.models import DamperModel, Parameter, find_model

Array = NDArray[np.float64]

POPULATION = 100
GENERATIONS = 60


@dataclass(frozen=True)
class Estimate:
    """One identified parameter.

    Attributes
    ----------
    parameter : Parameter
    value : float
    lower, upper : float
        95 % interval; nan where there is none (fixed, on a bound, or not determined).
    fixed : bool
        Kept at ``value``, not searched.
    on_bound : bool
    """

    parameter: Parameter
    value: float
    lower: float
    upper: float
    fixed: bool
    on_bound: bool


@dataclass(frozen=True)
class RunResult:
    """A run against the model that did or did not see it.

    Attributes
    ----------
    run : Run
    modelled : ndarray (n,)
        Force in N at every sample.
    counted : slice
        Samples that the metrics count.
    metrics : Metrics
    """

    run: Run
    modelled: Array
    counted: slice
    metrics: Metrics


@dataclass(frozen=True)
class Fit:
    """An identified model.

    Attributes
    ----------
    model : DamperModel
    theta : ndarray (parameters,)
    estimates : tuple of Estimate
    front : Front
        Of NSGA-II, before the polish.
    polished : bool
    fitted, held_out : tuple of RunResult
        Without held-out runs of their own, each fitted run is judged by a fit to the others; a single run has nobody to
        judge it, and ``held_out`` is empty.
    held_out_by : str
        "runs", "leave-one-run-out" or "none".
    pooled_fitted, pooled_held_out : Metrics or None
        Over all samples of the runs together.
    seed, population, generations : int
    elapsed : float
        s.
    condition : float
        Condition number of the scaled sensitivities.
    warnings : tuple of str
        What limits the trust in this fit, in plain words.
    """

    model: DamperModel
    theta: Array
    estimates: tuple[Estimate, ...]
    front: Front
    polished: bool
    fitted: tuple[RunResult, ...]
    held_out: tuple[RunResult, ...]
    held_out_by: str
    pooled_fitted: Metrics
    pooled_held_out: Metrics | None
    seed: int
    population: int
    generations: int
    elapsed: float
    condition: float
    warnings: tuple[str, ...]

    @property
    def current(self) -> float:
        """Mean coil current in A of the fitted runs."""
        return float(np.mean([result.run.current.mean() for result in self.fitted]))

    @property
    def observables(self) -> dict[str, tuple[float, str]]:
        """What the recordings determine of the damper at `current`: value and unit by name."""
        of = self.model.observables
        return of(self.model.at_current(self.theta, self.current)) if of else {}

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name, in SI units."""
        return dict(zip(self.model.names, map(float, self.theta), strict=True))


def identify(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
    population: int = POPULATION,
    generations: int = GENERATIONS,
    seed: int = 0,
    polish_result: bool = True,
    progress: Callable[[int, float], None] | None = None,
) -> Fit:
    """Identify the parameters of a damper model from runs, all jointly.

    Parameters
    ----------
    runs : sequence of Run
        What is fitted.
    model : str
        Id of a model, e.g. ``"bouc_wen"``.
    held_out : sequence of Run
        What judges the fit.
    population, generations, seed : int
        NSGA-II's.
    polish_result : bool
        Least squares from the knee of the front.
    progress : callable, optional
        Called after every generation with its number and the smallest NRMSE so far.

    Returns
    -------
    Fit
        The same for the same input and seed.

    Raises
    ------
    InputError
        For an unknown model, no runs, or runs whose rod or force does not move.
    """
    began = time.monotonic()
    damper = find_model(model)
    if not runs:
        raise InputError("no runs to identify from")
    if population < 8 or generations < 1:
        raise InputError(f"population {population} and generations {generations}: expected at least 8 and 1")
    for run in (*runs, *held_out):
        if np.ptp(run.position) == 0 or np.ptp(run.force) == 0:
            quantity = "position" if np.ptp(run.position) == 0 else "force"
            raise InputError(f"{run.name}: {quantity} never changes; nothing can be identified from it")
    recordings = [prepare(run) for run in runs]
    judges = [prepare(run) for run in held_out]
    problem, notes = _problem(damper, recordings)
    spread = float(np.std(np.concatenate([r.force for r in recordings])))
    samples = sum(len(r.force) for r in recordings)

    def report(generation: int, e2: float) -> None:
        if progress is not None:
            progress(generation, e2 * np.sqrt(samples) / spread)

    front = search(problem, population, generations, seed, report)
    theta = front.thetas[front.knee]
    if polish_result:
        theta = polish(problem, theta)
    fitted = tuple(_judge(damper, theta, recording) for recording in recordings)
    if judges:
        held, by = tuple(_judge(damper, theta, judge) for judge in judges), "runs"
    elif len(recordings) > 1 and polish_result:
        held, by = _leave_one_out(damper, recordings, front), "leave-one-run-out"
    else:
        held, by = (), "none"
    uncertainty = intervals(problem, theta)
    lower, upper = np.full((2, len(theta)), np.nan)
    on_bound = np.zeros(len(theta), dtype=bool)
    free = list(problem.free)
    lower[free], upper[free], on_bound[free] = uncertainty.lower, uncertainty.upper, uncertainty.on_bound
    estimates = tuple(
        Estimate(parameter, float(theta[i]), float(lower[i]), float(upper[i]), i not in free, bool(on_bound[i]))
        for i, parameter in enumerate(damper.parameters)
    )
    return Fit(
        model=damper,
        theta=theta,
        estimates=estimates,
        front=front,
        polished=polish_result,
        fitted=fitted,
        held_out=held,
        held_out_by=by,
        pooled_fitted=pooled(fitted),
        pooled_held_out=pooled(held) if held else None,
        seed=seed,
        population=population,
        generations=generations,
        elapsed=time.monotonic() - began,
        condition=uncertainty.condition,
        warnings=(*notes, *_warnings(estimates, uncertainty, problem, by)),
    )


def pooled(results: Sequence[RunResult]) -> Metrics:
    """Metrics over all counted samples of several runs."""
    measured = np.concatenate([r.run.force[r.counted] for r in results])
    return metrics(measured, np.concatenate([r.modelled[r.counted] for r in results]))


def _judge(model: DamperModel, theta: Array, recording: Recording) -> RunResult:
    modelled = model.force(theta, recording.path)
    return RunResult(
        recording.run, modelled, recording.counted, metrics(recording.force, modelled[recording.counted])
    )


def _problem(model: DamperModel, recordings: Sequence[Recording]) -> tuple[Problem, list[str]]:
    """What these recordings can tell about a model; a parameter that they say nothing of is neutral."""
    free, notes = free_parameters(model, [recording.run for recording in recordings])
    base = model.defaults.copy()
    for index, parameter in enumerate(model.parameters):
        if index not in free and parameter.free:
            base[index] = max(0.0, parameter.lower)
    return Problem(model, recordings, free, base), notes


def _leave_one_out(model: DamperModel, recordings: Sequence[Recording], front: Front) -> tuple[RunResult, ...]:
    """Each run judged by a fit to the others: what these alone can tell, from the candidate that suits them best."""
    results = []
    for index, recording in enumerate(recordings):
        rest, _ = _problem(model, [*recordings[:index], *recordings[index + 1 :]])
        starts = rest.theta(np.array([rest.unit(theta) for theta in front.thetas]))
        theta = polish(rest, starts[int(np.argmin(rest.norms(starts)[:, 0]))])
        results.append(_judge(model, theta, recording))
    return tuple(results)


def _warnings(
    estimates: Sequence[Estimate], uncertainty: Intervals, problem: Problem, held_out_by: str
) -> list[str]:
    found = []
    if not np.isfinite([estimate.lower for estimate in estimates]).any():
        found.append(
            f"no intervals: the errors are independent over {uncertainty.blocks} stretches only, too few for "
            f"{len(problem.free)} parameters; record longer or more runs"
        )
    for estimate in estimates:
        parameter = estimate.parameter
        if estimate.on_bound:
            side = "lower" if abs(estimate.value - parameter.lower) < abs(estimate.value - parameter.upper) else "upper"
            found.append(
                f"{parameter.name} ended on its {side} bound, {f'{estimate.value:g} {parameter.unit}'.rstrip()}: "
                "the runs want a value beyond it, or say nothing about it"
            )
        elif estimate.upper - estimate.lower >= 2 * abs(estimate.value):
            found.append(f"{parameter.name} is not determined: its 95 % interval is wider than twice its value")
    names = [p.name for p in problem.parameters]
    correlation = uncertainty.correlation
    for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > 0.98, 1)), strict=True):
        found.append(f"{names[i]} and {names[j]} cannot be told apart well: correlation {correlation[i, j]:.3f}")
    if held_out_by == "none":
        why = "one run only" if len(problem.recordings) == 1 else "without least squares no run is left out in turn"
        found.append(f"{why}: nothing judges the fit; give --held-out")
    return found
