"""Partial explanation: the effects that can be named although the model's form is wrong, and what remains beside them.

No base model has the form of a measured damper. A cause is named all the same when it holds against three things: a flexible
remainder for the form of the damper (`form_remainder`), the other half of the recordings, and another base model. An effect
that belongs to the form itself holds against the remainder where its formula closes most of what the remainder can close.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.base_fit import BaseFit, global_fit, with_effect
from mrd_diagnosis.closure import closed_fraction_between
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.effect_search import refit_with_effects, search_effects
from mrd_diagnosis.explanation import Explanation
from mrd_diagnosis.form_remainder import form_effects, with_form_remainder
from mrd_diagnosis.model_comparison import NO_EFFECT, ModelComparison, compare_on
from mrd_diagnosis.null_distribution import draw_null_errors, draw_null_gains, p_value
from mrd_diagnosis.refit import Refit, held_out_errors, refit, refit_on, without_each
from mrd_diagnosis.statistics import probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting
from mrd_identification.problem import make_problem
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model

Array = NDArray[np.float64]
Progress = Callable[[float], None]

OTHER_FORMS = ("hyperbolic_tangent", "bouc_wen")
"""Damper models around which a cause has to hold as well: the first that is not the user's own."""

RANDOM_STARTS, EVALUATIONS = 20, 40
"""Random points from which the other model is fitted, and evaluations of the fit."""

MOST_FORM_EFFECTS = 2
"""Effects of the form that are added to the model one after the other, at most."""


@dataclass(frozen=True)
class HeldCause:
    """An effect that holds whatever the form of the damper.

    Attributes
    ----------
    probabilities : dict
        Probability of every alternative to it, itself included, by name.
    p_value : float
        Probability of its improvement in noise alone.
    closed_fraction : Interval
        Share of the gap that it closes beside the others and a freer form of the damper.
    """

    probabilities: dict[str, float]
    p_value: float
    closed_fraction: Interval


def explain_in_part(
    explanation: Explanation, effects: Sequence[str], rng: np.random.Generator, progress: Progress = lambda _fraction: None
) -> Explanation:
    """Find the effects that can be named although the form of the model may be wrong.

    What the model lacks by construction, such as a hysteretic state, belongs to its form: it stays as it was chosen.

    Parameters
    ----------
    explanation : Explanation
        With the model alone. It is returned where it holds beside a freer form as well.
    effects : sequence of str
        Ids of the candidates.
    rng : numpy Generator
    progress : callable
        Called with the fraction of the work that is done.
    """
    comparison = explanation.comparison
    weighting = comparison.weighting
    lacking = lacking_effects(comparison)
    alone = comparison.chain[len(lacking) - 1] if lacking else comparison.base
    other = _other_form(weighting, alone, rng)
    tried = [effect for effect in effects if effect not in lacking]
    beside = _search_beside_remainder(comparison, other, tried, rng, progress)
    progress(0.8)
    causes = beside.causes
    values = alone.values | beside.values
    explained = _with_effects(weighting, alone, list(causes), values)
    freed = refit_on(replace(weighting, remainder=beside.remainder), explained)
    for effect, fitted in _form_chain(weighting, explained, freed, beside.form_effects):
        # Another base model that predicts better has the form without this effect.
        instead = _with_effects(weighting, other, list(causes), values)
        probability = float(probabilities([fitted, instead], rng)[0])
        if probability < THRESHOLDS.named_probability or not _holds_in_halves(explained, fitted):
            break
        gain = float(explained.held_out_cost - fitted.held_out_cost)
        closed = closed_fraction_between(explained, fitted, comparison, rng)
        causes[effect] = HeldCause({effect: probability}, p_value(gain, beside.null_gains), closed)
        values |= fitted.values
        explained = fitted
    progress(0.9)
    named = [*lacking, *causes]
    if explanation.verdict != "unknown_effect" and set(named) == set(comparison.effects):
        return explanation
    freed = refit_on(replace(weighting, remainder=beside.remainder), explained)
    gap = comparison.base.held_out_cost - weighting.noise_cost
    form_fraction = float(np.clip((explained.held_out_cost - freed.held_out_cost) / gap, 0.0, 1.0))
    if not named:
        return replace(explanation, verdict="unknown_effect", form_fraction=form_fraction)
    return Explanation(
        "partly_explained",
        _comparison_with(comparison, named, values),
        {effect: explanation.probabilities[effect] for effect in lacking}
        | {effect: cause.probabilities for effect, cause in causes.items()},
        {effect: explanation.p_values[effect] for effect in lacking}
        | {effect: cause.p_value for effect, cause in causes.items()},
        {effect: cause.closed_fraction for effect, cause in causes.items()},
        form_fraction,
    )


def lacking_effects(comparison: ModelComparison) -> tuple[str, ...]:
    """Return the chosen effects that the model lacks by construction; they are chosen first."""
    return tuple(itertools.takewhile(lambda effect: EFFECTS[effect].structural, comparison.effects))


def rests_on_form(comparison: ModelComparison) -> bool:
    """Whether an explanation needs effects of the form and leaves more than noise: the base model may be wrong instead."""
    if comparison.best.chi_square <= THRESHOLDS.noise_chi_square:
        return False
    return bool(form_effects(comparison.weighting, comparison.base, comparison.effects))


def _other_form(weighting: Weighting, alone: Refit, rng: np.random.Generator) -> Refit:
    """Fit another damper model, without effects."""
    model = find_model(next(name for name in OTHER_FORMS if name != alone.problem.model.id))
    problem, _ = make_problem(model, weighting.recordings, fixed=weighting.fixed)
    theta = global_fit(problem, None, rng, RANDOM_STARTS, EVALUATIONS)
    return refit(weighting.problem(model, theta), theta, weighting.folds)


@dataclass(frozen=True)
class _BesideRemainder:
    """What was found beside the remainder.

    Attributes
    ----------
    remainder : tuple of ndarray
        See `mrd_diagnosis.weighting.WeightedProblem`.
    causes : dict
        The effects that hold, by id.
    values : dict
        Parameters of the model with the chosen effects, by name.
    form_effects : list of str
        Candidates that belong to the form of the damper, so that the remainder takes their place.
    null_gains : ndarray
        See `mrd_diagnosis.null_distribution.draw_null_gains`.
    """

    remainder: tuple[Array, ...]
    causes: dict[str, HeldCause]
    values: dict[str, float]
    form_effects: list[str]
    null_gains: Array


def _search_beside_remainder(
    comparison: ModelComparison, other: Refit, effects: Sequence[str], rng: np.random.Generator, progress: Progress
) -> _BesideRemainder:
    """Search for effects beside the remainder; they have to hold in both halves and around the ``other`` model."""
    weighting, base = with_form_remainder(comparison.weighting, comparison.base)
    of_form = form_effects(weighting, base, effects)
    tried = [effect for effect in effects if effect not in of_form]
    force_noise = [of_run.force for of_run in weighting.noise]
    null_errors = draw_null_errors(base.problem, base.theta, force_noise, weighting.scatter, rng)
    base = refit(base.problem, base.theta, weighting.folds, null_errors)
    chosen, fits = search_effects(weighting, base, tried, null_errors, lambda fraction: progress(0.8 * fraction))
    singles = [fit.refit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, singles, rng) if singles else np.zeros(1)
    if not chosen:
        return _BesideRemainder(weighting.remainder, {}, {}, of_form, null_gains)
    best = chosen[-1].refit
    compared = compare_on(weighting.updated(best.problem.model, best.theta, best.coefficients), base, chosen, fits)
    around_other = with_form_remainder(comparison.weighting, other)
    gains = {fit.effects[-1]: fit.gain for fit in chosen}
    causes = {}
    for effect, others in compared.alternatives.items():
        p = p_value(gains[effect], null_gains)
        if p > THRESHOLDS.p_value or not _holds_in_halves(others[NO_EFFECT], others[effect]):
            continue
        support = _support(around_other, compared.best, effect, rng)
        if support < THRESHOLDS.listed_probability:
            continue
        shares = map(float, probabilities(list(others.values()), rng))
        chances = {name: support * share for name, share in zip(others, shares, strict=True) if name != NO_EFFECT}
        closed = closed_fraction_between(others[NO_EFFECT], others[effect], comparison, rng)
        causes[effect] = HeldCause(chances, p, closed)
    return _BesideRemainder(weighting.remainder, causes, compared.best.values, of_form, null_gains)


def _form_chain(weighting: Weighting, explained: Refit, freed: Refit, effects: Sequence[str]) -> list[tuple[str, Refit]]:
    """Add effects of the form one after the other; return them where they close most of what the remainder closes.

    ``explained`` is the model with all other causes, ``freed`` the same with the remainder.
    """
    available = explained.held_out_cost - freed.held_out_cost
    gap = explained.held_out_cost - weighting.noise_cost
    if available < THRESHOLDS.least_share_first * gap:
        return []
    chain: list[tuple[str, Refit]] = []
    best = explained
    while len(chain) < MOST_FORM_EFFECTS:
        remaining = [effect for effect in effects if effect not in best.effects]
        fits = refit_with_effects(
            weighting, BaseFit.linearise(weighting, best), remaining, len(remaining), present=best.effects
        )
        if not fits:
            break
        fit = min(fits, key=lambda fit: fit.refit.held_out_cost)
        if best.held_out_cost - fit.refit.held_out_cost < THRESHOLDS.least_share_next * (
            best.held_out_cost - freed.held_out_cost
        ):
            break
        best = fit.refit
        chain.append((fit.effects[-1], best))
    closed = explained.held_out_cost - best.held_out_cost
    return chain if closed >= THRESHOLDS.least_form_share * available else []


def _support(form: tuple[Weighting, Refit], best: Refit, effect: str, rng: np.random.Generator) -> float:
    """Return the probability of an effect against none around another form of the damper, the other effects present."""
    weighting, refitted = form
    values = best.values
    # The other model has a hysteretic state of its own.
    present = [other.id for other in best.problem.model.effects if not other.structural]
    fits = [
        _with_effects(weighting, refitted, wanted, values)
        for wanted in (present, [name for name in present if name != effect])
    ]
    return float(probabilities(fits, rng)[0])


def _with_effects(weighting: Weighting, refitted: Refit, effects: Sequence[str], values: Mapping[str, float]) -> Refit:
    """Refit a model with effects, whose parameters start from ``values``."""
    model, theta = refitted.problem.model, refitted.theta
    for effect in effects:
        model, theta = with_effect(model, theta, effect)
    theta = np.array([values[n] if "." in n else v for n, v in zip(model.names, theta, strict=True)])
    return refit(weighting.problem(model, theta), theta, weighting.folds)


def _holds_in_halves(without: Refit, with_effect: Refit) -> bool:
    """Whether an effect lowers the error of either half of the folds with parameters fitted to the other half."""
    return bool((_cost_of_halves(with_effect) < _cost_of_halves(without)).all())


def _cost_of_halves(refitted: Refit) -> Array:
    """Return the sum of squared white residuals (2,) of every second fold, predicted from the others."""
    problem, folds = refitted.problem, refitted.folds
    halves = [np.arange(first, len(folds), 2) for first in (0, 1)]
    matrices = np.stack([refitted.normal_matrices[half].sum(axis=0) for half in halves])
    gradients = np.stack([refitted.gradients[half].sum(axis=0) for half in halves])
    thetas, coefficients = without_each(problem, problem.unit(refitted.theta), refitted.coefficients, matrices, gradients)
    costs = []
    for half, theta, of_remainder in zip(halves, thetas, coefficients, strict=True):
        pieces = [folds[index] for index in half]
        shape = (len(pieces), 1)
        white, _, _ = held_out_errors(problem, np.tile(theta, shape), np.tile(of_remainder, shape), pieces)
        costs.append(float(white.sum()))
    return np.array(costs)


def _comparison_with(comparison: ModelComparison, effects: Sequence[str], values: Mapping[str, float]) -> ModelComparison:
    """Refit the user's model with one effect more at a time, without the remainder."""
    chain = [
        _with_effects(comparison.weighting, comparison.base, effects[: count + 1], values) for count in range(len(effects))
    ]
    alternatives = {effect: {effect: chain[-1]} for effect in effects}
    return replace(comparison, chain=tuple(chain), effects=tuple(effects), alternatives=alternatives)
