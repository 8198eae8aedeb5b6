"""Forward selection of effects: one after the other is added to a model while it predicts unseen runs better."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_identification.least_squares import bounded_step, levenberg_marquardt
from mrd_identification.needs import needs_met
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem
from mrd_sim.effects import EFFECTS, Effect

Array = NDArray[np.float64]
Samples = NDArray[np.intp]
Pose = Callable[[Sequence[str]], Problem]
"""Returns the problem of the model with these effects."""

AUTO = "auto"
"""Stands in a list of effects for those that are selected."""

MOST_EFFECTS = 6
"""Effects that are added, at most."""

LEAST_IMPROVEMENT = 0.02
"""Share of the squared error on left-out parts that an effect must remove to be added."""

STANDARD_ERRORS = 1.0
"""Standard errors, over the left-out parts, by which the removed squared error must exceed zero."""

MOST_PARTS = 20
"""Parts that are left out in turn; with more runs, a part is several runs."""

FEWEST_PARTS = 5
"""Parts that are left out in turn; with fewer runs, a part is a stretch of one run."""

MOST_FITTED = 6
"""Effects that are fitted in each step; the others promise less."""

EVALUATIONS = 20
"""Evaluations of the model in one fit, at most."""

CONVERGED = 1e-4
"""Relative decrease of the squared error at which a fit ends."""

LEAST_FACTOR, LARGEST_FACTOR = 0.03, 3.0
"""Multiples of an effect's start value to which its change of the force is scaled."""

LEAST_CURVATURE = 1e-8
"""Relative to the normal matrix; keeps a step small in a direction that the recordings do not determine."""

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
    values : mapping
        Parameters by name of the model with these effects, fitted to the samples that were counted.
    fixed : mapping
        Those that are not searched although they differ from their default.
    elapsed : float
        Computing time in s, with that of the searches without these effects.
    """

    added: tuple[AddedEffect, ...]
    next_best: AddedEffect | None
    parts: int
    of_runs: bool
    values: Mapping[str, float]
    fixed: Mapping[str, float]
    elapsed: float = 0.0

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects that were added."""
        return tuple(step.effect for step in self.added)

    @property
    def steps(self) -> list[AddedEffect]:
        """The steps, and last the one that was not taken."""
        return [*self.added, *([self.next_best] if self.next_best else [])]

    @property
    def sentences(self) -> list[str]:
        """What was added and why the selection ended, a sentence each."""
        parts = f"{self.parts} {'runs' if self.of_runs else 'segments'} left out in turn"
        steps = [
            f"{step.effect} was added: on {parts} it removes {_share(step)} of the squared error and lowers the NRMSE from "
            f"{step.nrmse_before:.4f} to {step.nrmse_after:.4f}"
            + (f"; {', '.join(step.equally_good)} would do as well" if step.equally_good else "")
            for step in self.added
        ]
        if self.next_best:
            return [
                *steps,
                f"No {'further ' if steps else ''}effect was added: the best, {self.next_best.effect}, removes "
                f"{_share(self.next_best)} of the squared error on {parts}",
            ]
        return [*steps, f"The selection ended at {len(steps)} effects, its limit or all that change the force"]


def _share(step: AddedEffect) -> str:
    return f"{100 * step.improvement:.1f} % (standard error {100 * step.standard_error:.1f} %)"


@dataclass(frozen=True)
class Candidate:
    """A model with effects, fitted, and how it predicts each part by a fit without it.

    Attributes
    ----------
    effects : tuple of str
        In the order in which they were added.
    problem : Problem
    theta : ndarray (parameters,)
    left_out : ndarray (parts,)
        Weighted sum of squared errors in N² of each part.
    """

    effects: tuple[str, ...]
    problem: Problem
    theta: Array
    left_out: Array


def selects(effects: Sequence[str]) -> bool:
    """Whether a list of effects asks for a selection.

    Raises
    ------
    InputError
        When it asks twice.
    """
    if list(effects).count(AUTO) > 1:
        raise InputError(f"effect {AUTO} is named twice, expected once")
    return AUTO in effects


def select_effects(
    pose: Pose, theta: Array, given: Sequence[str] = (), progress: Callable[[float], None] = ignore
) -> Selection:
    """Add effects of the catalogue to a model, the best first, while the error on left-out parts of the runs falls.

    Forward selection by cross-validation (Hastie, Tibshirani & Friedman, 2009, ch. 3.3 and 7.10). In each step the most
    promising effects are fitted with the model by least squares, from the present optimum. An effect may be added if it
    removes more than `LEAST_IMPROVEMENT` of the squared error on left-out parts, and more than `STANDARD_ERRORS` standard
    errors of what it removes; the best of these is added. Effects whose state outlasts a run are not tried: such a state can
    tell runs apart by their order alone, which predicts nothing about a run that comes later.

    Parameters
    ----------
    pose : callable
        Returns the problem with some effects. Every n-th sample of the runs may be enough.
    theta : ndarray (parameters,)
        Optimum of the model with the effects ``given``.
    given : sequence of str
        Ids of effects that the model has in any case.
    progress : callable
        Called with the share that is done, if as many effects are added as may be.
    """
    problem = pose(given)
    parts, of_runs = parts_of(problem)
    present = _fit(problem, theta, parts, tuple(given))
    added: list[AddedEffect] = []
    next_best: AddedEffect | None = None
    while len(added) < MOST_EFFECTS and next_best is None:
        starts = _starts(pose, present)
        if not starts:
            break
        candidates = _fit_each(present, starts, parts, len(added), progress)
        best = next((candidate for candidate in candidates if is_improvement(present, candidate)), candidates[0])
        step = _step(present, best, candidates)
        if is_improvement(present, best):
            added.append(step)
            present = best
        else:
            next_best = step
    progress(1.0)
    model = present.problem.model
    values = dict(zip(model.names, map(float, present.theta), strict=True))
    names = {f"{effect.id}.{p.name}": p for effect in model.effects for p in effect.parameters}
    fixed = {name: values[name] for name, p in names.items() if not p.free and values[name] != p.default}
    return Selection(tuple(added), next_best, len(parts), of_runs, values, fixed)


def _fit_each(
    present: Candidate,
    starts: Sequence[tuple[str, Problem]],
    parts: Sequence[Samples],
    finished_steps: int,
    progress: Callable[[float], None],
) -> list[Candidate]:
    """Fit the present model with each of some effects from its start; the one that predicts left-out parts best is first."""
    finished = itertools.count(1)

    def fit(start: tuple[str, Problem]) -> Candidate:
        effect, problem = start
        candidate = _fit(problem, problem.base, parts, (*present.effects, effect))
        progress((finished_steps + next(finished) / len(starts)) / MOST_EFFECTS)
        return candidate

    return sorted(in_threads(fit, starts), key=lambda candidate: float(candidate.left_out.sum()))


def parts_of(problem: Problem) -> tuple[list[Samples], bool]:
    """Return the samples of each part that is left out in turn, and whether the parts are whole runs."""
    blocks = [np.arange(block.start, block.stop) for block in problem.blocks]
    if len(blocks) >= FEWEST_PARTS:
        groups = np.array_split(np.arange(len(blocks)), min(len(blocks), MOST_PARTS))
        return [np.concatenate([blocks[run] for run in group]) for group in groups], True
    stretches = -(-FEWEST_PARTS // len(blocks))
    return [stretch for block in blocks for stretch in np.array_split(block, stretches)], False


def _step(present: Candidate, best: Candidate, candidates: Sequence[Candidate]) -> AddedEffect:
    """Describe the addition of the best candidate."""
    before, after = present.left_out.sum(), best.left_out.sum()
    force = present.problem.counted(present.problem.force - present.problem.force.mean())
    size = float(force @ force)
    equally_good = tuple(
        other.effects[-1]
        for other in candidates
        if other is not best
        and is_improvement(present, other)
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


def is_improvement(present: Candidate, candidate: Candidate) -> bool:
    """Whether a candidate predicts left-out parts so much better than the present model that it may be added."""
    gain = present.left_out - candidate.left_out
    return bool(gain.sum() > max(LEAST_IMPROVEMENT * present.left_out.sum(), STANDARD_ERRORS * _standard_error(gain)))


def _standard_error(values: Array) -> float:
    """Return the standard error of the sum of independent values."""
    return float(np.sqrt(len(values)) * np.std(values, ddof=1))


def _starts(pose: Pose, present: Candidate) -> list[tuple[str, Problem]]:
    """Return the most promising effects, each with the problem whose ``base`` is where its fit starts; the best first.

    Each start value of an effect changes the force. The change, scaled, and small changes of the model's own parameters
    together remove some of the squared error: the more they remove, the more promising the effect.
    """
    free = list(present.problem.free)
    unit, residuals = present.problem.unit(present.theta), present.problem.residuals(present.theta)
    jacobian = present.problem.jacobian(unit)

    def vector(problem: Problem, own: Array, trial: Mapping[str, float]) -> Array:
        """Return the parameters of the extended model."""
        known = {**dict(zip(present.problem.model.names, own, strict=True)), **trial}
        return np.array([known.get(p.name, p.default) for p in problem.model.parameters])

    def start(effect: Effect) -> tuple[float, str, Problem] | None:
        problem = pose((*present.effects, effect.id))
        least, base = np.inf, problem.base
        for trial in start_values(effect.scaled(problem.model.scales), problem.force):
            change = problem.residuals(vector(problem, present.theta, trial)) - residuals
            if not (np.isfinite(change).all() and change.any()):
                continue
            columns = np.concatenate([jacobian, change[:, None]], axis=1)
            lower, upper = np.append(-unit, LEAST_FACTOR), np.append(1.0 - unit, LARGEST_FACTOR)
            step = _least_squares_step(columns.T @ columns, columns.T @ residuals, lower, upper)
            expected = float(np.sum((residuals + columns @ step) ** 2))
            if expected < least:
                own = present.theta.copy()
                own[free] = present.problem.theta(np.clip(unit + step[:-1], 0.0, 1.0))[free]
                least, base = expected, vector(problem, own, trial)
        return (least, effect.id, replace(problem, base=base)) if np.isfinite(least) else None

    has = needs_met(present.problem.recordings)
    effects = [
        effect
        for name, effect in EFFECTS.items()
        if name not in present.effects
        and not effect.outlasts_run
        and not effect.only_as_change
        and all(has[need] for need in effect.needs)
    ]
    starts = [found for found in in_threads(start, effects) if found is not None]
    return [(effect, problem) for _, effect, problem in sorted(starts, key=lambda found: found[0])[:MOST_FITTED]]


def _least_squares_step(gram: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Return `bounded_step`, also where the recordings do not determine a direction."""
    size = np.diag(gram)
    damping = LEAST_CURVATURE * np.maximum(size, LEAST_CURVATURE * size.max())
    return bounded_step(gram + np.diag(damping), gradient, lower, upper)


def start_values(effect: Effect, force: Array) -> list[dict[str, float]]:
    """Return values of an effect's parameters, by their names in a model, from which fits to a force (n,) start."""
    size = effect.parameters[0]
    typical = {p.name: effect.typical.get(p.name, p.default) for p in effect.parameters}
    sizes = effect.starts(force) if effect.starts else [typical[size.name]]
    if size.lower < 0.0:
        sizes = [*sizes, *(-value for value in sizes)]
    trials = [{**typical, size.name: float(np.clip(value, size.lower, size.upper))} for value in sizes]
    trials += [{**trials[0], **variant} for variant in effect.variants]
    return [{f"{effect.id}.{name}": value for name, value in trial.items()} for trial in trials]


def _fit(problem: Problem, theta: Array, parts: Sequence[Samples], effects: tuple[str, ...]) -> Candidate:
    unit, _ = levenberg_marquardt(
        problem, problem.unit(theta), np.arange(len(problem.free)), EVALUATIONS, tolerance=CONVERGED, renewal=3
    )
    return Candidate(effects, problem, problem.theta(unit), left_out_errors(problem, unit, parts))


def left_out_errors(problem: Problem, unit: Array, parts: Sequence[Samples]) -> Array:
    """Return the sum of squared residuals (parts,) in N² of each part, predicted by a fit without it.

    The optimum without a part is near the one with it, ``unit`` (free,). So a few Gauss-Newton steps with the derivatives at
    ``unit`` lead there. Where the first of them leads nowhere, the model is fitted without the part.
    """
    jacobian, residuals = problem.jacobian(unit), problem.residuals(problem.theta(unit))
    root = problem.robust_weights(residuals)

    def without(part: Samples) -> float:
        weight = root.copy()
        weight[part] = 0.0
        weighted = jacobian * weight[:, None]
        gram = weighted.T @ weighted
        point, present = unit, residuals
        for number in range(STEPS_WITHOUT_PART):
            step = _least_squares_step(gram, weighted.T @ (present * weight), -point, 1.0 - point)
            trial = np.clip(point + step, 0.0, 1.0)
            errors = problem.residuals(problem.theta(trial))
            if not np.sum((errors * weight) ** 2) < np.sum((present * weight) ** 2):
                if number == 0:
                    rest = replace(problem, left_out=part)
                    point, _ = levenberg_marquardt(rest, unit, np.arange(len(unit)), EVALUATIONS, CONVERGED)
                    present = problem.residuals(problem.theta(point))
                break
            point, present = trial, errors
        return float(np.sum((present * problem.robust_weights(present))[part] ** 2))

    return np.array(in_threads(without, parts))
