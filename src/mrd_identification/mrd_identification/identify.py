"""Identify a damper model from recordings: NSGA-II, least squares, and what can be said of the result."""

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_identification.cluster import run_on_cluster
from mrd_identification.fit_warnings import cautions
from mrd_identification.least_squares import fit_from_front, fit_least_squares, with_loss_scale
from mrd_identification.metrics import Metrics, metrics
from mrd_identification.nsga2 import Front, search
from mrd_identification.problem import (
    Loss,
    Problem,
    Recording,
    Weights,
    consecutive_modelled_forces,
    make_problem,
    prepare_recording,
    run_weights,
)
from mrd_identification.uncertainty import uncertainty
from mrd_runs import Run
from mrd_runs.signals.motion import Motion
from mrd_sim.models import DamperModel, Parameter, find_model

Array = NDArray[np.float64]
Progress = Callable[[int, float], None]


def no_progress(_generation: int, _nrmse: float) -> None:
    """Nobody wants to know."""


POPULATION = 40
GENERATIONS = 25
SEEDS = 3


@dataclass(frozen=True)
class Method:
    """How a model is identified.

    Attributes
    ----------
    laws : str or mapping
        Current laws, see `DamperModel.with_laws`.
    effects : sequence of str
        Ids of effects around the model, whose parameters are searched too.
    fixed : mapping
        Values of parameters that are not searched, by name.
    freed : collection of str
        Parameters to be searched that usually keep their default.
    offsets : bool
        Let each fitted run have a force offset of its own; held-out runs are judged without one.
    weights : {"samples", "runs", "force"} or sequence of float
        What counts alike: samples, runs, or errors relative to a run's force; or a number for each run.
    loss : {"linear", "soft_l1", "huber"}
        Of the residuals in least squares.
    population, generations, seed, seeds : int
        NSGA-II's; it runs ``seeds`` times, from ``seed`` on.
    least_squares : bool
        Least squares from the front; without it the knee of the first front is the result.
    profile : bool
        Intervals from profiles of the objective beside those from the covariance.
    """

    laws: str | Mapping[str, str] = field(default_factory=dict)
    effects: Sequence[str] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    freed: Collection[str] = ()
    offsets: bool = False
    weights: Weights | Sequence[float] = "samples"
    loss: Loss = "linear"
    population: int = POPULATION
    generations: int = GENERATIONS
    seed: int = 0
    seeds: int = SEEDS
    least_squares: bool = True
    profile: bool = True


@dataclass(frozen=True)
class Estimate:
    """One identified parameter.

    Attributes
    ----------
    parameter : Parameter
    value : float
    lower, upper : float
        95 % interval from the covariance; nan where there is none (fixed, on a bound, or not determined).
    profile_lower, profile_upper : float
        95 % interval from the profile of the objective; an end on the parameter's bound is open. nan where there is none.
    seeds : tuple of float
        What each seed of the search came to.
    fixed : bool
        Kept at ``value``, not searched.
    on_bound : bool
    """

    parameter: Parameter
    value: float
    lower: float
    upper: float
    profile_lower: float
    profile_upper: float
    seeds: tuple[float, ...]
    fixed: bool
    on_bound: bool


@dataclass(frozen=True)
class RunResult:
    """A run against the model that did or did not see it.

    Attributes
    ----------
    run : Run
    motion : Motion
        Smoothed motion of the run.
    modelled : ndarray (n,)
        Force in N at every sample.
    counted : slice
        Samples that the metrics count.
    metrics : Metrics
    """

    run: Run
    motion: Motion
    modelled: Array
    counted: slice
    metrics: Metrics


@dataclass(frozen=True)
class Fit:
    """An identified model.

    Attributes
    ----------
    model : DamperModel
    method : Method
    theta : ndarray (parameters,)
    estimates : tuple of Estimate
    front : Front
        Of the seed that led to the result, before least squares.
    seed_errors : tuple of float
        NRMSE on the fitted runs that each seed came to.
    fitted, held_out : tuple of RunResult
        Without held-out runs of their own, each fitted run is judged by a fit to the others; a single run has nobody to
        judge it, and ``held_out`` is empty.
    held_out_by : str
        "runs", "leave-one-run-out" or "none".
    pooled_fitted, pooled_held_out : Metrics or None
        Over all samples of the runs together.
    run_offsets : tuple of float
        Force offset in N of each fitted run, where offsets are free.
    correlation : ndarray (free, free)
        Of the estimates that are not fixed, in their order.
    condition : float
        Condition number of the scaled sensitivities.
    elapsed : float
        s.
    warnings : tuple of str
        What limits the trust in this fit, in plain words.
    """

    model: DamperModel
    method: Method
    theta: Array
    estimates: tuple[Estimate, ...]
    front: Front
    seed_errors: tuple[float, ...]
    fitted: tuple[RunResult, ...]
    held_out: tuple[RunResult, ...]
    held_out_by: str
    pooled_fitted: Metrics
    pooled_held_out: Metrics | None
    run_offsets: tuple[float, ...]
    correlation: Array
    condition: float
    elapsed: float
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
    method: Method | None = None,
    scheduler: str | None = None,
    progress: Progress = no_progress,
    **options: Any,
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
    method : Method, optional
        How; the default method otherwise.
    scheduler : str, optional
        Address of a dask.distributed scheduler to work on; the result is the same.
    progress : callable, optional
        Called after every generation with its number, counted over all seeds, and the smallest NRMSE so far; again and again
        with the last of these while the rest is computed. What it raises ends the work.
    **options
        Fields of `Method` that differ from ``method``, e.g. ``seed=1, laws="quadratic"``.

    Returns
    -------
    Fit
        The same for the same input and seed.

    Raises
    ------
    InputError
        For an unknown model, law, effect, parameter, loss or weights, no runs, or runs whose rod or force does not move.
    """
    case = IdentificationTask(tuple(runs), model, tuple(held_out), replace(method or Method(), **options))
    return identify_all([case], scheduler=scheduler, progress=progress)[0]


@dataclass(frozen=True)
class IdentificationTask:
    """One of many identifications: what `identify` takes."""

    runs: tuple[Run, ...]
    model: str
    held_out: tuple[Run, ...] = ()
    method: Method = Method()


def identify_all(
    cases: Sequence[IdentificationTask], *, scheduler: str | None = None, progress: Progress = no_progress
) -> list[Fit]:
    """Identify many cases, batches of runs or models or both; see `identify`.

    First every seed of every case is searched, then every case is judged. On a cluster each of these is one piece of work.
    """
    for case in cases:
        _check(case)
    searches = [(case.runs, case.model, case.method, seed) for case in cases for seed in _seeds(case.method)]
    generations = max((case.method.generations for case in cases), default=0)
    everything = len(searches) * generations
    solutions: list[Solution] = []
    if scheduler is None:
        for index, search_of in enumerate(searches):
            solutions.append(search_and_fit(*search_of, _shifted(progress, index * generations)))
    else:
        solutions = run_on_cluster(scheduler, search_and_fit, searches, lambda done: progress(done * generations, np.nan))
    rest = iter(solutions)
    verdicts = [
        (case.runs, case.held_out, case.model, case.method, [next(rest) for _ in _seeds(case.method)]) for case in cases
    ]
    if scheduler is not None:
        return run_on_cluster(scheduler, judge, verdicts)
    return [judge(*verdict, lambda: progress(everything, np.nan)) for verdict in verdicts]


@dataclass(frozen=True)
class Solution:
    """What one seed came to.

    Attributes
    ----------
    front : Front
        Of NSGA-II.
    theta : ndarray (parameters,)
        The optimum of least squares, or the knee of the front.
    elapsed : float
        s.
    """

    front: Front
    theta: Array
    elapsed: float


def search_and_fit(runs: Sequence[Run], model: str, method: Method, seed: int, progress: Progress = no_progress) -> Solution:
    """Search by NSGA-II from one seed, then least squares."""
    began = time.monotonic()
    problem, _ = _make_problem(_prepare(runs, method), model, method)
    to_nrmse = np.sqrt(len(problem.force)) / np.std(problem.force)
    front = search(problem, method.population, method.generations, seed, lambda g, e2: progress(g, e2 * to_nrmse))
    theta = front.thetas[front.knee]
    if method.least_squares:
        theta = fit_from_front(with_loss_scale(problem, front), front)
    return Solution(front, theta, time.monotonic() - began)


def judge(
    runs: Sequence[Run],
    held_out: Sequence[Run],
    model: str,
    method: Method,
    solutions: Sequence[Solution],
    step: Callable[[], None] = lambda: None,
) -> Fit:
    """Choose the best of several seeds and find out what can be said of it; ``step`` is called now and then."""
    began = time.monotonic()
    recordings = _prepare(runs, method)
    problem, notes = _make_problem(recordings, model, method)
    problem = with_loss_scale(problem, solutions[0].front)
    best = min(solutions, key=lambda solution: problem.cost(solution.theta))
    theta = best.theta
    if method.least_squares and problem.loss != "linear":
        theta, _ = fit_least_squares(problem, theta)  # on the common scale of the loss
    fitted = _results(problem.model, theta, recordings)
    if held_out:
        everything = [*recordings, *map(prepare_recording, held_out)]
        held, by = _results(problem.model, theta, everything)[len(recordings) :], "runs"
    elif len(runs) > 1 and method.least_squares:
        held, poorer = _leave_one_out(recordings, model, method, [s.front for s in solutions], notes, step)
        by = "leave-one-run-out"
        notes = [*notes, *poorer]
    else:
        held, by = (), "none"
    uncertain = uncertainty(problem, theta, profile=method.profile and method.least_squares, step=step)
    at = {index: place for place, index in enumerate(problem.free)}

    def end(of: Array, index: int) -> float:
        return float(of[at[index]]) if index in at else float("nan")

    estimates = tuple(
        Estimate(
            parameter,
            float(theta[i]),
            end(uncertain.lower, i),
            end(uncertain.upper, i),
            end(uncertain.profile_lower, i),
            end(uncertain.profile_upper, i),
            seeds=tuple(float(solution.theta[i]) for solution in solutions),
            fixed=i not in at,
            on_bound=i in at and bool(uncertain.on_bound[at[i]]),
        )
        for i, parameter in enumerate(problem.model.parameters)
    )
    return Fit(
        model=problem.model,
        method=method,
        theta=theta,
        estimates=estimates,
        front=best.front,
        seed_errors=tuple(_nrmse(problem, solution.theta) for solution in solutions),
        fitted=fitted,
        held_out=held,
        held_out_by=by,
        pooled_fitted=pooled(fitted),
        pooled_held_out=pooled(held) if held else None,
        run_offsets=tuple(map(float, problem.offset_of_runs(theta))),
        correlation=uncertain.correlation,
        condition=uncertain.condition,
        elapsed=time.monotonic() - began + sum(solution.elapsed for solution in solutions),
        warnings=(*notes, *cautions(problem, theta, uncertain, [s.theta for s in solutions], by)),
    )


def pooled(results: Sequence[RunResult]) -> Metrics:
    """Metrics over all counted samples of several runs."""
    measured = np.concatenate([r.run.force[r.counted] for r in results])
    return metrics(measured, np.concatenate([r.modelled[r.counted] for r in results]))


def _check(case: IdentificationTask) -> None:
    method = case.method
    find_model(case.model, method.laws, method.effects)
    if method.loss not in get_args(Loss):
        raise InputError(f"loss {method.loss!r}: expected {', '.join(get_args(Loss))}")
    run_weights(case.runs, method.weights)
    if not case.runs:
        raise InputError("no runs to identify from")
    if method.population < 8 or method.generations < 1 or method.seeds < 1:
        raise InputError(
            f"population {method.population}, generations {method.generations}, seeds {method.seeds}: "
            "expected at least 8, 1 and 1"
        )
    for run in (*case.runs, *case.held_out):
        if np.ptp(run.position) == 0 or np.ptp(run.force) == 0:
            quantity = "position" if np.ptp(run.position) == 0 else "force"
            raise InputError(f"{run.name}: {quantity} never changes; nothing can be identified from it")


def _shifted(progress: Progress, before: int) -> Progress:
    return lambda generation, nrmse: progress(before + generation, nrmse)


def _seeds(method: Method) -> range:
    return range(method.seed, method.seed + (method.seeds if method.least_squares else 1))


def _prepare(runs: Sequence[Run], method: Method) -> list[Recording]:
    return [prepare_recording(run, weight) for run, weight in zip(runs, run_weights(runs, method.weights), strict=True)]


def _make_problem(recordings: Sequence[Recording], model: str, method: Method) -> tuple[Problem, list[str]]:
    problem, notes = make_problem(
        find_model(model, method.laws, method.effects),
        recordings,
        fixed=method.fixed,
        freed=method.freed,
        offsets=method.offsets,
    )
    return replace(problem, loss=method.loss), notes


def _nrmse(problem: Problem, theta: Array) -> float:
    return float(np.sqrt(np.mean(problem.errors(theta) ** 2)) / np.std(problem.force))


def _results(model: DamperModel, theta: Array, recordings: Sequence[Recording]) -> tuple[RunResult, ...]:
    """Of runs that were recorded one after the other."""
    modelled = consecutive_modelled_forces(model, theta, recordings)
    return tuple(
        RunResult(
            recording.run, recording.motion, force, recording.counted, metrics(recording.force, force[recording.counted])
        )
        for recording, force in zip(recordings, modelled, strict=True)
    )


def _leave_one_out(
    recordings: Sequence[Recording],
    model: str,
    method: Method,
    fronts: Sequence[Front],
    notes: Sequence[str],
    step: Callable[[], None],
) -> tuple[tuple[RunResult, ...], list[str]]:
    """Each run judged by a fit to the others: what these alone can tell, from the candidate that suits them best.

    The others are fitted as if it had never been: with what outlasts runs, such as heat, its error is on the large side.
    Also says which runs were so judged by a model that knows less than the one fitted to all of them, see ``notes``.
    """
    thetas = np.concatenate([front.thetas for front in fronts])
    results, poorer = [], []
    for index, recording in enumerate(recordings):
        rest, said = _make_problem([*recordings[:index], *recordings[index + 1 :]], model, method)
        starts, norms = rest.project(rest.theta(rest.unit(thetas)))
        order = np.argsort(norms[:, 0], kind="stable")
        front = Front(starts[order], norms[order], 0)
        theta, _ = fit_least_squares(with_loss_scale(rest, front), front.thetas[0])
        results.append(_results(rest.model, theta, recordings[: index + 1])[-1])
        if len(said) > len(notes):
            poorer.append(recording.run.name)
        step()
    warnings = [
        f"left out, {', '.join(poorer)} is judged by a fit that knows less of current: the other runs have too few of "
        "them; give --held-out, or more currents"
    ]
    return tuple(results), warnings if poorer else []
