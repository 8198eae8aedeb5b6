"""Forward selection of effects: one after the other is added to a model while it predicts unseen runs better."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_identification.least_squares import bounded_step, levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem
from mrd_sim.effects import EFFECTS, Effect

Array = NDArray[np.float64]
Pose = Callable[[Sequence[str]], Problem]
"""Returns the problem of the model with these effects."""

AUTO = "auto"
"""Stands in a list of effects for those that are to be selected."""

MOST_EFFECTS = 6
"""Effects that are added, at most."""

LEAST_SHARE = 0.02
"""Share of the squared error of left-out runs that an effect must remove to be added."""

STANDARD_ERRORS = 1.0
"""Standard errors, over the left-out parts, by which the removed squared error must exceed zero."""

MOST_SAMPLES = 6000
"""Samples of all runs together whose residuals count in the selection. Models are integrated over all samples even so."""

MOST_PARTS = 20
"""Parts that are left out in turn; with more runs, a part is several runs."""

FEWEST_PARTS = 5
"""Parts that are left out in turn; with fewer runs, a part is a stretch of one run."""

MOST_FITTED = 8
"""Effects that are fitted in each step; the others promise less."""

EVALUATIONS = 20
"""Evaluations of the model in one fit, at most."""

CONVERGED = 1e-4
"""Relative decrease of the squared error at which a fit ends."""

LEAST_FACTOR, LARGEST_FACTOR = 0.03, 3.0
"""Multiples of an effect's start value to which its change of the force is scaled."""

STEPS_WITHOUT_PART = 2
"""Steps to the optimum without a part, which is near the one with it."""


@dataclass(frozen=True)
class AddedEffect:
    """One step of the selection.

    Attributes
    ----------
    effect : str
        Id of the effect that was added.
    nrmse_before, nrmse_after : float
        Error on left-out parts of the fitted runs, without and with it.
    improvement : float
        Share of the squared error on left-out parts that it removes.
    standard_error : float
        Standard error of ``improvement`` over the parts.
    equally_good : tuple of str
        Effects that would have removed as much within one standard error of the difference.
    """

    effect: str
    nrmse_before: float
    nrmse_after: float
    improvement: float
    standard_error: float
    equally_good: tuple[str, ...]


@dataclass(frozen=True)
class Selection:
    """The selected effects.

    Attributes
    ----------
    added : tuple of AddedEffect
        In the order in which they were added.
    next_best : AddedEffect or None
        The best of the remaining effects, which was not added.
    parts : int
        Number of parts that were left out in turn.
    of_runs : bool
        Whether the parts are whole runs.
    theta : ndarray (parameters,)
        Parameters of the model with these effects, fitted to some of the samples.
    """

    added: tuple[AddedEffect, ...]
    next_best: AddedEffect | None
    parts: int
    of_runs: bool
    theta: Array


@dataclass(frozen=True)
class Start:
    """Where the fit of a model with one more effect starts.

    Attributes
    ----------
    effect : str
    problem : Problem
        Its ``base`` is the start.
    expected : float
        Sum of squared residuals in N² to be expected of the fit.
    """

    effect: str
    problem: Problem
    expected: float


@dataclass(frozen=True)
class Candidate:
    """A model with effects, fitted to all parts, and its squared errors on each part by fits without it.

    Attributes
    ----------
    effects : tuple of str
    problem : Problem
    theta : ndarray (parameters,)
    left_out : ndarray (parts,)
        Weighted sum of squared errors in N².
    """

    effects: tuple[str, ...]
    problem: Problem
    theta: Array
    left_out: Array


def select_effects(
    pose: Pose, theta: Array, given: Sequence[str] = (), progress: Callable[[float], None] = lambda _share: None
) -> Selection:
    """Add effects of the catalogue to a model, the best first, while the error on left-out parts of the runs falls.

    Forward selection by cross-validation with the one-standard-error rule (Hastie, Tibshirani & Friedman 2009, ch. 3.3 and
    7.10). Each effect is fitted with the model by least squares from the present optimum. The best one is added if it removes
    at least `LEAST_SHARE` of the squared error on left-out parts, and more than `STANDARD_ERRORS` standard errors.

    Parameters
    ----------
    pose : callable
        Returns the problem with some effects. Its samples may be thinned.
    theta : ndarray (parameters,)
        Optimum of the model with the effects ``given``.
    given : sequence of str
        Ids of effects that the model has in any case.
    progress : callable
        Called with the share of the work that is done at most.
    """
    problem = pose(given)
    parts, of_runs = parts_of(problem)
    present = _fit(problem, theta, parts, tuple(given))
    added: list[AddedEffect] = []
    next_best: AddedEffect | None = None
    while len(added) < MOST_EFFECTS:
        starts = _promising(pose, present)
        if not starts:
            break
        finished = itertools.count(1)

        def fit(start: Start, present: Candidate = present) -> Candidate:
            candidate = _fit(start.problem, start.problem.base, parts, (*present.effects, start.effect))
            progress((len(added) + next(finished) / len(starts)) / MOST_EFFECTS)
            return candidate

        candidates = sorted(in_threads(fit, starts), key=lambda candidate: candidate.left_out.sum())
        best = candidates[0]
        step = _step(present, best, candidates[1:])
        if not (step.improvement > LEAST_SHARE and step.improvement > STANDARD_ERRORS * step.standard_error):
            next_best = step
            break
        added.append(step)
        present = best
    progress(1.0)
    return Selection(tuple(added), next_best, len(parts), of_runs, present.theta)


def parts_of(problem: Problem) -> tuple[list[NDArray[np.intp]], bool]:
    """Return the samples of each part that is left out in turn, and whether the parts are whole runs."""
    blocks = [np.arange(block.start, block.stop) for block in problem.blocks]
    if len(blocks) >= FEWEST_PARTS:
        groups = np.array_split(np.arange(len(blocks)), min(len(blocks), MOST_PARTS))
        return [np.concatenate([blocks[run] for run in group]) for group in groups], True
    stretches = -(-FEWEST_PARTS // len(blocks))
    return [stretch for block in blocks for stretch in np.array_split(block, stretches)], False


def _step(present: Candidate, best: Candidate, others: Sequence[Candidate]) -> AddedEffect:
    """Describe the addition of the best candidate."""
    before, after = present.left_out.sum(), best.left_out.sum()
    force = present.problem.counted(present.problem.force - present.problem.force.mean())
    size = float(force @ force)
    equally_good = tuple(
        other.effects[-1]
        for other in others
        if is_improvement_over(present, other)
        and other.left_out.sum() - after <= _standard_error(other.left_out - best.left_out)
    )
    return AddedEffect(
        best.effects[-1],
        float(np.sqrt(before / size)),
        float(np.sqrt(after / size)),
        float((before - after) / before),
        float(_standard_error(present.left_out - best.left_out) / before),
        equally_good,
    )


def is_improvement_over(present: Candidate, candidate: Candidate) -> bool:
    """Whether a candidate would be added by itself."""
    gain = present.left_out - candidate.left_out
    return bool(gain.sum() > max(LEAST_SHARE * present.left_out.sum(), STANDARD_ERRORS * _standard_error(gain)))


def _standard_error(values: Array) -> float:
    """Return the standard error of the sum of independent values."""
    return float(np.sqrt(len(values)) * np.std(values, ddof=1))


def _promising(pose: Pose, present: Candidate) -> list[Start]:
    """Return the start of a fit with each of the most promising effects that the model does not have yet.

    Each start value of an effect changes the force. The change, scaled to fit, and small changes of the model's own parameters
    together remove some of the squared error: the larger this share, the more promising the effect.
    """
    unit = present.problem.unit(present.theta)
    residuals = present.problem.residuals(present.theta)
    jacobian = present.problem.jacobian(unit)
    known = dict(zip(present.problem.model.names, present.theta, strict=True))

    def start(effect: Effect) -> Start | None:
        problem = pose((*present.effects, effect.id))
        best: Start | None = None
        for trial in start_values(effect, problem.force):
            theta = np.array([known.get(p.name, trial.get(p.name, p.default)) for p in problem.model.parameters])
            change = problem.residuals(theta) - residuals
            if not (np.isfinite(change).all() and change.any()):
                continue
            columns = np.concatenate([jacobian, change[:, None]], axis=1)
            lower, upper = np.append(-unit, LEAST_FACTOR), np.append(1.0 - unit, LARGEST_FACTOR)
            step = _bounded_solution(columns.T @ columns, columns.T @ residuals, lower, upper)
            expected = float(np.sum((residuals + columns @ step) ** 2))
            if best is None or expected < best.expected:
                point = dict(known)
                point |= dict(
                    zip(
                        (p.name for p in present.problem.parameters),
                        present.problem.theta(np.clip(unit + step[:-1], 0.0, 1.0))[list(present.problem.free)],
                        strict=True,
                    )
                )
                theta = np.array([point.get(p.name, trial.get(p.name, p.default)) for p in problem.model.parameters])
                best = Start(effect.id, replace(problem, base=theta), expected)
        return best

    effects = [effect for name, effect in EFFECTS.items() if name not in present.effects and not effect.outlasts_run]
    starts = [start for start in in_threads(start, effects) if start is not None]
    return sorted(starts, key=lambda start: start.expected)[:MOST_FITTED]


def _bounded_solution(gram: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Return `bounded_step`, also where the recordings do not determine some direction."""
    return bounded_step(
        gram + np.diag(np.maximum(1e-8 * np.diag(gram), 1e-12 * np.diag(gram).max())), gradient, lower, upper
    )


def start_values(effect: Effect, force: Array) -> list[dict[str, float]]:
    """Return values of an effect's parameters, by their names in a model, from which fits to a force (n,) start."""
    size = effect.parameters[0]
    typical = {p.name: effect.typical.get(p.name, p.default) for p in effect.parameters}
    sizes = effect.starts(force) if effect.starts else [typical[size.name]]
    if size.lower < 0.0:
        sizes = [*sizes, *(-value for value in sizes)]
    trials = [typical | {size.name: float(np.clip(value, size.lower, size.upper))} for value in sizes]
    trials += [trials[0] | variant for variant in effect.variants]
    return [{f"{effect.id}.{name}": value for name, value in trial.items()} for trial in trials]


def _fit(problem: Problem, theta: Array, parts: Sequence[NDArray[np.intp]], effects: tuple[str, ...]) -> Candidate:
    unit, _ = levenberg_marquardt(
        problem, problem.unit(theta), np.arange(len(problem.free)), EVALUATIONS, tolerance=CONVERGED, renewal=3
    )
    return Candidate(effects, problem, problem.theta(unit), left_out_errors(problem, unit, parts))


def left_out_errors(problem: Problem, unit: Array, parts: Sequence[NDArray[np.intp]]) -> Array:
    """Return the sum of squared residuals (parts,) in N² of each part, predicted by a fit without it.

    The optimum without a part is near the one with it, ``unit`` (free,). So a few Gauss-Newton steps with the derivatives at
    ``unit`` lead there.
    """
    jacobian, residuals = problem.jacobian(unit), problem.residuals(problem.theta(unit))
    root = problem.robust_weights(residuals)

    def without(part: NDArray[np.intp]) -> float:
        kept = np.ones(len(residuals))
        kept[part] = 0.0
        weighted = jacobian * (kept * root)[:, None]
        gram = weighted.T @ weighted
        point, present = unit, residuals
        for _ in range(STEPS_WITHOUT_PART):
            step = _bounded_solution(gram, weighted.T @ (present * root), -point, 1.0 - point)
            trial = np.clip(point + step, 0.0, 1.0)
            errors = problem.residuals(problem.theta(trial))
            if not np.sum((errors * root * kept) ** 2) < np.sum((present * root * kept) ** 2):
                break
            point, present = trial, errors
        return float(np.sum((present * root)[part] ** 2))

    return np.array(in_threads(without, parts))
