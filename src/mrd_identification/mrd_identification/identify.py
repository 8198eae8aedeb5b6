"""Identify a damper model from recordings: NSGA-II, least squares, and an assessment of the result."""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_identification.cluster import run_on_cluster
from mrd_identification.effect_selection import AUTO, Selection, select_effects
from mrd_identification.fit import Estimate, Fit, RunResult, evaluate_model, pooled_metrics
from mrd_identification.fit_warnings import fit_warnings
from mrd_identification.least_squares import fit_from_front, fit_least_squares, with_loss_scale
from mrd_identification.low_pass import filter_notes
from mrd_identification.method import SELECTION_SEARCHES, Method
from mrd_identification.metrics import nrmse
from mrd_identification.nsga2 import Front, search
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, prepare_recording, run_weights
from mrd_identification.run_start import estimate_starts, fit_with_starts
from mrd_identification.uncertainty import Uncertainty, uncertainty
from mrd_runs import Run
from mrd_runs.run import checked_runs, same_samples
from mrd_runs.scales import Scales, scales_of
from mrd_sim.models import DamperModel, find_model

Array = NDArray[np.float64]
T = TypeVar("T")
Watch = Callable[[Array], None]
"""Called with e2 and einf (candidates, 2) in N of the Pareto front after every generation of a search, before `Progress`."""
Progress = Callable[[int, float], None]
"""Called with the number of finished generations, over all searches, and the smallest NRMSE so far. A selection of effects
counts as `SELECTION_SEARCHES` searches."""

MOST_SELECTION_SAMPLES = 6000
"""Samples of all runs together that count in the selection of effects. Models are integrated along all samples even so."""

SELECTED_WITH_ALL_RUNS = (
    "The held-out error is too small: the run that is left out helped to select the effects; give --held-out to judge them"
)

NO_INTERVALS_AT_KNEE = "There are no confidence intervals: without least squares, the result is no optimum of the error"


@dataclass(frozen=True)
class IdentificationTask:
    """The arguments of one identification, see `identify`."""

    runs: tuple[Run, ...]
    model: str
    held_out: tuple[Run, ...] = ()
    method: Method = Method()

    def check(self) -> None:
        """Raise `InputError` for what cannot be identified, see `identify`."""
        self.method.check()
        find_model(self.model, self.method.laws, self.method.given_effects)
        run_weights(self.runs, self.method.weights)
        if not self.runs:
            raise InputError("no runs to identify from")
        for run in (*self.runs, *self.held_out):
            for signal, values in (("position", run.position), ("force", run.force)):
                if np.ptp(values) == 0:
                    raise InputError(f"{run.name}: {signal} never changes; nothing can be identified from it")
        for run, other in itertools.combinations((*self.runs, *self.held_out), 2):
            if same_samples(run, other):
                raise InputError(
                    f"{run.name} and {other.name} are the same recording; expected each once, either fitted or held out"
                )


def identify(
    runs: Sequence[Run],
    model: str,
    *,
    held_out: Sequence[Run] = (),
    method: Method | None = None,
    scheduler: str | None = None,
    progress: Progress = ignore,
    watch: Watch = ignore,
    **options: Any,
) -> Fit:
    """Identify the parameters of a damper model from all runs jointly.

    Parameters
    ----------
    runs : sequence of Run
        Runs that are fitted.
    model : str
        Id of a model, e.g. ``"bouc_wen"``.
    held_out : sequence of Run
        Runs that are not fitted and measure how well the model predicts.
    method : Method, optional
        Options of the identification; the default method otherwise.
    scheduler : str, optional
        Address of a dask.distributed scheduler to work on; the result is the same.
    progress : callable, optional
        Called after every generation with its number, counted over all seeds, and the smallest NRMSE so far; repeatedly
        with the last number while the rest is computed. An exception that it raises ends the work.
    watch : callable, optional
        Called before ``progress`` with the Pareto front so far, e2 and einf (candidates, 2) in N; not on a cluster.
    **options
        Fields of `Method` that differ from ``method``, e.g. ``seed=1, laws="quadratic"``.

    Returns
    -------
    Fit
        The same for the same input and seed.

    Raises
    ------
    InputError
        For an unknown model, law, effect, parameter, loss or weights, no runs, runs whose rod or force does not move, or a
        run that is given twice.
    """
    fitted, set_aside = checked_runs(runs, least=0), checked_runs(held_out, "held_out", least=0)
    task = IdentificationTask(tuple(fitted), model, tuple(set_aside), replace(method or Method(), **options))
    return identify_all([task], scheduler=scheduler, progress=progress, watch=watch)[0]


def identify_all(
    tasks: Sequence[IdentificationTask], *, scheduler: str | None = None, progress: Progress = ignore, watch: Watch = ignore
) -> list[Fit]:
    """Identify several models, or one model from several sets of runs; see `identify`.

    First the searches from every seed of every task run. Where effects are to be selected, the selection follows, then the
    searches with the selected effects. Last, every task is assessed. On a cluster each search, each selection and each
    assessment is one piece of work.
    """
    for task in tasks:
        task.check()
    total, finished = sum(task.method.total_generations for task in tasks), 0

    def work(function: Callable[..., T], pieces: Sequence[tuple[Any, ...]], generations: Sequence[int]) -> list[T]:
        """Call ``function`` for every piece, which takes about as long as a number of generations."""
        nonlocal finished
        ends = finished + np.cumsum([0, *generations])
        finished = int(ends[-1])
        if scheduler is not None and pieces:
            return run_on_cluster(scheduler, function, pieces, lambda done: progress(int(ends[done]), np.nan))
        return [function(*piece, _shifted(progress, int(end))) for piece, end in zip(pieces, ends[:-1], strict=True)]

    methods = [replace(task.method, effects=task.method.given_effects) for task in tasks]
    solutions: dict[int, list[Solution]] = {}
    selections: dict[int, Selection] = {}

    def search(indices: Sequence[int]) -> None:
        """Search for the solutions of some tasks, with what their selections know."""
        pieces = [
            (tasks[i].runs, tasks[i].model, methods[i], seed, selections[i].values if i in selections else None)
            for i in indices
            for seed in methods[i].search_seeds
        ]
        one_search = search_and_fit_from if scheduler else partial(search_and_fit_from, watch=watch)
        found = iter(work(one_search, pieces, [piece[2].generations for piece in pieces]))
        for i in indices:
            solutions[i] = [next(found) for _ in methods[i].search_seeds]

    search(range(len(tasks)))
    selecting = [i for i, task in enumerate(tasks) if AUTO in task.method.effects]
    unselected = [(tasks[i].runs, tasks[i].model, methods[i], solutions[i]) for i in selecting]
    found = work(select, unselected, [SELECTION_SEARCHES * methods[i].generations for i in selecting])
    for i, selection in zip(selecting, found, strict=True):
        selections[i] = selection
        effects, fixed = (*methods[i].effects, *selection.effects), {**methods[i].fixed, **selection.fixed}
        methods[i] = replace(methods[i], effects=effects, fixed=fixed)
    search([i for i in selecting if selections[i].added])
    # Runs are arguments of their own, so that a cluster gets runs that several tasks share only once.
    assessments = [
        (task.runs, task.held_out, task.model, methods[i], solutions[i], selections.get(i)) for i, task in enumerate(tasks)
    ]
    if scheduler is not None:
        return run_on_cluster(scheduler, assess, assessments)
    return [assess(*arguments, lambda: progress(total, np.nan)) for arguments in assessments]


def _shifted(progress: Progress, finished: int) -> Progress:
    """Return the progress of a search that begins after ``finished`` generations."""
    return lambda generation, nrmse: progress(finished + generation, nrmse)


@dataclass(frozen=True)
class Solution:
    """The result of the search from one seed.

    Attributes
    ----------
    front : Front
        Pareto front of NSGA-II.
    theta : ndarray (parameters,)
        The optimum of least squares, or the knee of the front.
    elapsed : float
        Computing time in s.
    """

    front: Front
    theta: Array
    elapsed: float


def search_and_fit(runs: Sequence[Run], model: str, method: Method, seed: int, progress: Progress = ignore) -> Solution:
    """Search by NSGA-II from one seed, then continue by least squares."""
    return search_and_fit_from(runs, model, method, seed, None, progress)


def search_and_fit_from(
    runs: Sequence[Run],
    model: str,
    method: Method,
    seed: int,
    known: Mapping[str, float] | None,
    progress: Progress = ignore,
    watch: Watch = ignore,
) -> Solution:
    """Search as `search_and_fit`, with the parameters ``known`` by name in the first population."""
    began = time.monotonic()
    problem, _ = _pose(_prepare(runs, method), model, method, scales_of(runs))
    nrmse_per_e2 = np.sqrt(len(problem.force)) / np.std(problem.force)
    theta = np.array([known[name] for name in problem.model.names]) if known else None
    population, generations = method.population, method.generations
    front = search(problem, population, generations, seed, lambda g, e2: progress(g, e2 * nrmse_per_e2), theta, watch)
    theta = front.thetas[front.knee]
    if method.least_squares:
        theta = fit_from_front(with_loss_scale(problem, front), front)
    return Solution(front, theta, time.monotonic() - began)


def select(
    runs: Sequence[Run], model: str, method: Method, solutions: Sequence[Solution], progress: Progress = ignore
) -> Selection:
    """Select the effects that are added to those of the method, see `mrd_identification.effect_selection`."""
    began = time.monotonic()
    recordings = _prepare(runs, method)
    stride = -(-sum(len(recording.force) for recording in recordings) // MOST_SELECTION_SAMPLES)
    scales = scales_of(runs)
    problem, _ = _pose(recordings, model, method, scales)
    problem = with_loss_scale(problem, solutions[0].front)
    best = min(solutions, key=lambda solution: problem.cost(solution.theta))
    recordings = estimate_starts(problem.model, best.theta, recordings)
    thinned = [replace(r, counted=slice(r.counted.start, r.counted.stop, stride)) for r in recordings]
    problem = replace(problem, recordings=recordings)
    loss_scale = with_loss_scale(problem, best.front).loss_scale

    def pose(effects: Sequence[str]) -> Problem:
        return replace(_pose(thinned, model, replace(method, effects=effects), scales)[0], loss_scale=loss_scale)

    def share_done(share: float) -> None:
        progress(int(share * SELECTION_SEARCHES * method.generations), np.nan)

    selection = select_effects(pose, best.theta, tuple(method.effects), share_done)
    before = sum(solution.elapsed for solution in solutions) if selection.added else 0.0
    return replace(selection, elapsed=before + time.monotonic() - began)


def assess(
    runs: Sequence[Run],
    held_out: Sequence[Run],
    model: str,
    method: Method,
    solutions: Sequence[Solution],
    selection: Selection | None = None,
    step: Callable[[], None] = lambda: None,
) -> Fit:
    """Choose the best of the solutions, and determine its uncertainty and its error on held-out runs.

    ``step`` is called repeatedly during the work.
    """
    began = time.monotonic()
    recordings = _prepare(runs, method)
    scales = scales_of(runs)
    problem, notes = _pose(recordings, model, method, scales)
    notes = [*notes, *filter_notes([*runs, *held_out])]
    problem = with_loss_scale(problem, solutions[0].front)
    best = min(solutions, key=lambda solution: problem.cost(solution.theta))
    theta = best.theta
    if method.least_squares:
        # The searches did not know the starts of the runs, and the scales of their losses differ.
        problem, theta = fit_with_starts(problem, theta)
        recordings = list(problem.recordings)
    fitted = evaluate_model(problem.model, theta, recordings)
    if held_out:
        predicted = _predicted(problem.model, theta, recordings, list(map(prepare_recording, held_out)))
        held_out_by = "runs"
    elif len(runs) > 1 and method.least_squares:
        predicted, warnings = _leave_one_out(problem, model, method, scales, [s.front for s in solutions], step)
        held_out_by = "leave-one-run-out"
        if selection:
            warnings = [*warnings, SELECTED_WITH_ALL_RUNS]
        notes = [*notes, *warnings]
    else:
        predicted, held_out_by = (), "none"
    uncertain = uncertainty(problem, theta, intervals=method.least_squares, profile=method.profile, step=step)
    notes = [*notes, *([] if method.least_squares else [NO_INTERVALS_AT_KNEE])]
    thetas = [solution.theta for solution in solutions]
    return Fit(
        model=problem.model,
        method=method,
        theta=theta,
        estimates=_estimates(problem, theta, uncertain, thetas),
        front=best.front,
        seed_errors=tuple(_nrmse(problem, theta) for theta in thetas),
        fitted=fitted,
        held_out=predicted,
        held_out_by=held_out_by,
        pooled_fitted=pooled_metrics(fitted),
        pooled_held_out=pooled_metrics(predicted) if predicted else None,
        run_offsets=tuple(map(float, problem.offset_of_runs(theta))),
        correlation=uncertain.correlation,
        condition=uncertain.condition,
        elapsed=time.monotonic()
        - began
        + sum(solution.elapsed for solution in solutions)
        + (selection.elapsed if selection else 0.0),
        warnings=(*notes, *fit_warnings(problem, theta, uncertain, thetas, held_out_by)),
        selection=selection,
    )


def _estimates(problem: Problem, theta: Array, uncertain: Uncertainty, thetas: Sequence[Array]) -> tuple[Estimate, ...]:
    """Return the estimate of every parameter of the model, free or fixed."""
    position = {index: place for place, index in enumerate(problem.free)}

    def end(ends: Array, index: int) -> float:
        return float(ends[position[index]]) if index in position else float("nan")

    return tuple(
        Estimate(
            parameter,
            value=float(theta[index]),
            lower=end(uncertain.lower, index),
            upper=end(uncertain.upper, index),
            profile_lower=end(uncertain.profile_lower, index),
            profile_upper=end(uncertain.profile_upper, index),
            by_seed=tuple(float(seed_theta[index]) for seed_theta in thetas),
            fixed=index not in position,
            on_bound=index in position and bool(uncertain.on_bound[position[index]]),
        )
        for index, parameter in enumerate(problem.model.parameters)
    )


def _prepare(runs: Sequence[Run], method: Method) -> list[Recording]:
    return [prepare_recording(run, weight) for run, weight in zip(runs, run_weights(runs, method.weights), strict=True)]


def _pose(recordings: Sequence[Recording], model: str, method: Method, scales: Scales) -> tuple[Problem, list[str]]:
    """Return the problem that a method poses, and notes as `make_problem` returns them."""
    problem, notes = make_problem(
        find_model(model, method.laws, method.effects, scales),
        recordings,
        fixed=method.fixed,
        freed=method.freed,
        offsets=method.offsets,
    )
    return replace(problem, loss=method.loss), notes


def _nrmse(problem: Problem, theta: Array) -> float:
    return nrmse(problem.errors(theta), problem.force)


def _predicted(
    model: DamperModel, theta: Array, before: Sequence[Recording], unseen: Sequence[Recording]
) -> tuple[RunResult, ...]:
    """Predict runs that were not fitted, in the order of recording: a state such as heat is carried over from those before.

    Their starts are estimated anew, so that no start that was found with other parameters misleads them.
    """
    every = [*before, *(replace(recording, path=recording.path.led_in(None), other_starts=None) for recording in unseen)]
    every[len(before) :] = estimate_starts(model, theta, every)[len(before) :]
    return evaluate_model(model, theta, every)[len(before) :]


def _leave_one_out(
    full: Problem, model: str, method: Method, scales: Scales, fronts: Sequence[Front], step: Callable[[], None]
) -> tuple[tuple[RunResult, ...], list[str]]:
    """Predict each run by a fit to the other runs, which starts at the candidate of the fronts that suits these best.

    The other runs are fitted as if the run had never happened. If a state such as heat outlasts a run, this makes the error
    too large rather than too small. Also returns a warning that names the runs without which more parameters have to be
    fixed than in the ``full`` problem of all runs.
    """
    recordings = full.recordings
    outlasts = any(effect.outlasts_run for effect in full.model.effects)
    thetas = np.concatenate([front.thetas for front in fronts])
    results: list[RunResult] = []
    less_determined: list[str] = []
    for index, recording in enumerate(recordings):
        problem, _ = _pose([*recordings[:index], *recordings[index + 1 :]], model, method, scales)
        starts, norms = problem.project(problem.theta(problem.unit(thetas)))
        order = np.argsort(norms[:, 0], kind="stable")
        front = Front(starts[order], norms[order], 0)
        theta, _ = fit_least_squares(with_loss_scale(problem, front), front.thetas[0])
        results += _predicted(problem.model, theta, recordings[:index] if outlasts else [], [recording])
        if len(problem.free) < len(full.free):
            less_determined.append(recording.run.name)
        step()
    if not less_determined:
        return tuple(results), []
    return tuple(results), [
        f"The held-out error of {', '.join(less_determined)} is too large: without the run, the other runs have too few "
        "currents to determine all current laws; give --held-out, or record more currents"
    ]
