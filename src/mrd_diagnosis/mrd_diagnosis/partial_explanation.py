"""Partial explanation: the effects that can be named although the model's form is wrong, and what remains beside them.

No base model has the form of a measured damper. So causes are searched around the model of the catalogue that predicts best,
whatever model the simulator has, and a cause is named when it holds against three things: a flexible remainder for the form
of the damper (`form_remainder`), the other half of the recordings, and other damper models, which count as much as they add
to the prediction (`stacking_weights`). An effect that belongs to the form itself holds against the remainder where its
formula closes most of what the remainder can close.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mrd_diagnosis.base_fit import BaseFit, with_effect
from mrd_diagnosis.closure import closed_fraction_between
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.effect_search import ROUGHLY_CONVERGED, refit_with_effects, search_effects
from mrd_diagnosis.explanation import Explanation
from mrd_diagnosis.form_remainder import form_effects, with_form_remainder
from mrd_diagnosis.limitations import contains
from mrd_diagnosis.model_comparison import NO_EFFECT, ModelComparison, compare_on, refit_in_its_place
from mrd_diagnosis.null_distribution import draw_null_errors, draw_null_gains, p_value
from mrd_diagnosis.refit import CONVERGED, Refit, held_out_errors, refit, refit_on, without_each
from mrd_diagnosis.statistics import probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]
Progress = Callable[[float], None]

MOST_FORMS = 3
"""Damper models around which a cause is judged."""

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
    explanation: Explanation,
    other_models: Sequence[Refit],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress = lambda _fraction: None,
) -> Explanation:
    """Find the effects that can be named although the form of the model may be wrong.

    What the model lacks by construction, such as a hysteretic state, belongs to its form: it stays as it was chosen.

    Parameters
    ----------
    explanation : Explanation
        With the model alone. It is returned where it holds beside a freer form as well.
    other_models : sequence of Refit
        Other damper models, without effects.
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
    forms = _weighted_forms(alone, other_models)
    form = forms[0][0]
    best_first = sorted([alone, *other_models], key=lambda other: other.held_out_cost)

    def all_but(own: Refit) -> list[Refit]:
        return [other for other in best_first if other is not own]

    contained = [effect for effect in effects if contains(form.problem.model, effect)]
    tried = [effect for effect in effects if effect not in (*lacking, *contained)]
    chosen = comparison.best
    if form is not alone:
        chosen = _search_around(weighting, form, tried, lambda fraction: progress(0.3 * fraction))
    beside = _search_beside_remainder(comparison, forms, tried, rng, lambda fraction: progress(0.3 + 0.5 * fraction))
    causes, values = beside.causes, alone.values | beside.values
    explained = _with_effects(weighting, form, list(causes), values)
    # What was chosen without the remainder may belong to the form as well, though the remainder cannot quite imitate it.
    of_form = [effect for effect in tried if effect in beside.of_form or (effect in chosen.effects and effect not in causes)]
    reachable = min(_cost_beside(beside.weighting.remainder, weighting, explained), chosen.held_out_cost)
    of_form_causes, explained = _form_causes(
        comparison, explained, reachable, of_form, tried, all_but(form), beside.null_gains, rng
    )
    values |= explained.values
    needed = _still_needed(beside.weighting, form, causes, of_form_causes, values)
    if len(needed) < len(causes):
        explained = _with_effects(weighting, form, [*needed, *of_form_causes], values)
    causes = needed | of_form_causes
    if form is not alone:
        # What the best form contains and the user's model does not tells the two apart. The best form may do so in part
        # only: its linear spring takes the place of most of a gas spring.
        best_cost = explained.held_out_cost
        explained = _with_effects(weighting, alone, list(causes), values)
        lacked = [effect for effect in contained if effect not in lacking and not contains(alone.problem.model, effect)]
        lacked += [effect for effect in comparison.effects if effect not in (*lacking, *lacked, *causes)]
        of_form_causes, explained = _form_causes(
            comparison, explained, best_cost, lacked, [*tried, *lacked], all_but(alone), beside.null_gains, rng
        )
        causes, values = causes | of_form_causes, values | explained.values
    remainder = beside.weighting.remainder if form is alone else with_form_remainder(weighting, alone)[0].remainder
    freed = _cost_beside(remainder, weighting, explained)
    progress(0.9)
    named = [*lacking, *causes]
    if explanation.verdict != "unknown_effect" and set(named) == set(comparison.effects):
        return explanation
    gap = comparison.base.held_out_cost - weighting.noise_cost
    form_fraction = float(np.clip((explained.held_out_cost - freed) / gap, 0.0, 1.0))
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


def holds(probability: float, without: Refit, with_effect: Refit) -> bool:
    """Whether an effect can be named beside a wrong form: it is more likely than not, and not one fold alone speaks for it.

    Without the second, an effect was named whose share in the gap was 100 %, between -4 and 100: without it, the model
    diverged in one of the folds.
    """
    gains = without.held_out_squares - with_effect.held_out_squares
    return bool(probability >= THRESHOLDS.named_support and gains.sum() > max(gains.max(), 0.0))


def stacking_weights(refits: Sequence[Refit]) -> Array:
    """Return the weights (refits,) with which models together predict best: none negative, one in sum.

    They minimise the squared error of the weighted prediction (stacked regressions; Breiman, 1996). The errors are those of
    the joint fit: each model has few parameters for the samples.
    """
    errors = np.stack([refitted.problem.residuals(refitted.theta) for refitted in refits], axis=1)
    sum_is_one = 100.0 * np.linalg.norm(errors)
    matrix = np.linalg.cholesky(errors.T @ errors + sum_is_one**2 + 1e-9 * sum_is_one**2 * np.eye(len(refits))).T
    target = np.linalg.solve(matrix.T, np.full(len(refits), sum_is_one**2))
    weights = nnls(matrix, target)[0]
    return np.asarray(weights / weights.sum())


def _weighted_forms(own: Refit, others: Sequence[Refit]) -> list[tuple[Refit, float]]:
    """Return the damper models that count most with their weights; first the one around which causes are searched.

    Of refits of one model with more or less freedom, the best counts. Among the models that predict about as well as the
    best, the first is the one with the largest weight: another one may err in the same places and in more. The user's
    ``own`` model is preferred where it is among them and has a weight of its own.
    """
    best_by_model: dict[str, Refit] = {}
    for refitted in sorted([own, *others], key=lambda refitted: (refitted.held_out_cost, refitted is not own)):
        best_by_model.setdefault(refitted.problem.model.id, refitted)
    if best_by_model[own.problem.model.id].held_out_cost > own.held_out_cost * (1.0 - THRESHOLDS.formula_error):
        best_by_model[own.problem.model.id] = own
    forms = list(best_by_model.values())
    weights = stacking_weights(forms)
    best = min(form.held_out_cost for form in forms)

    def rank(index: int) -> tuple[bool, bool, float]:
        worse = forms[index].held_out_cost * (1.0 - THRESHOLDS.formula_error) > best
        preferred = forms[index] is own and weights[index] >= THRESHOLDS.listed_probability
        return worse, not preferred, -weights[index]

    first = min(range(len(forms)), key=rank)
    counted = sorted(range(len(forms)), key=lambda index: (index != first, -weights[index]))[:MOST_FORMS]
    total = weights[counted].sum()
    return [(forms[index], float(weights[index] / total)) for index in counted]


@dataclass(frozen=True)
class _BesideRemainder:
    """What was found beside the remainder.

    Attributes
    ----------
    weighting : Weighting
        With the remainder.
    of_form : list of str
        Candidates that belong to the form of the damper, so that the remainder takes their place.
    causes : dict
        The effects that hold, by id.
    values : dict
        Parameters of the model with the chosen effects, by name.
    null_gains : ndarray
        See `mrd_diagnosis.null_distribution.draw_null_gains`.
    """

    weighting: Weighting
    of_form: list[str]
    causes: dict[str, HeldCause]
    values: dict[str, float]
    null_gains: Array


def _search_beside_remainder(
    comparison: ModelComparison,
    forms: Sequence[tuple[Refit, float]],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress,
) -> _BesideRemainder:
    """Search for effects beside the remainder around the first of the forms; they have to hold in both halves and around
    the other forms.
    """
    spaces = [with_form_remainder(comparison.weighting, form) for form, _ in forms]
    weighting, base = spaces[0]
    of_form = form_effects(weighting, base, effects)
    tried = [effect for effect in effects if effect not in of_form]
    force_noise = [of_run.force for of_run in weighting.noise]
    null_errors = draw_null_errors(base.problem, base.theta, force_noise, weighting.scatter, rng)
    base = refit(base.problem, base.theta, weighting.folds, null_errors)
    chosen, fits = search_effects(weighting, base, tried, null_errors, progress)
    singles = [fit.refit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, singles, rng) if singles else np.zeros(1)
    if not chosen:
        return _BesideRemainder(weighting, of_form, {}, {}, null_gains)
    best = chosen[-1].refit
    compared = compare_on(weighting.updated(best.problem.model, best.theta, best.coefficients), base, chosen, fits)
    gains = {fit.effects[-1]: fit.gain for fit in chosen}
    causes = {}
    for effect, others in compared.alternatives.items():
        p = p_value(gains[effect], null_gains)
        if p > THRESHOLDS.p_value or not _holds_in_halves(others[NO_EFFECT], others[effect]):
            continue
        of_forms = [(others[effect], others[NO_EFFECT])] + [
            _with_and_without(*space, compared.best, effect) for space in spaces[1:]
        ]
        support = sum(weight * float(probabilities(pair, rng)[0]) for pair, (_, weight) in zip(of_forms, forms, strict=True))
        if not holds(support, others[NO_EFFECT], others[effect]):
            continue
        chances = _chances(others, support, rng)
        if not _leads(effect, chances):  # something is missing there, but which effect is not known
            continue
        closed = closed_fraction_between(others[NO_EFFECT], others[effect], comparison, rng)
        causes[effect] = HeldCause(chances, p, closed)
    return _BesideRemainder(weighting, of_form, causes, compared.best.values, null_gains)


def _chances(refits: Mapping[str, Refit], support: float, rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each effect among refits in one place; with that of no effect, they sum to ``support``."""
    shares = map(float, probabilities(list(refits.values()), rng))
    return {name: support * share for name, share in zip(refits, shares, strict=True) if name != NO_EFFECT}


def _leads(effect: str, chances: Mapping[str, float]) -> bool:
    """Whether an effect is the most probable one in its place, and not only one of many."""
    return max(chances, key=chances.__getitem__) == effect and chances[effect] >= THRESHOLDS.leading_probability


def _search_around(weighting: Weighting, form: Refit, effects: Sequence[str], progress: Progress) -> Refit:
    """Return a form of the damper with the effects that are chosen around it without the remainder."""
    around = weighting.updated(form.problem.model, form.theta)
    chosen, _ = search_effects(around, refit_on(around, form), effects, progress=progress, quick=True)
    return refit_on(weighting, chosen[-1].refit) if chosen else form


def _still_needed(
    weighting: Weighting,
    form: Refit,
    causes: dict[str, HeldCause],
    of_form: Mapping[str, HeldCause],
    values: Mapping[str, float],
) -> dict[str, HeldCause]:
    """Return the causes that do beside effects of the form at least half of what they do without these.

    The remainder imitates an effect of the form in part only. What it left of it, another effect may have taken up.
    """
    if not of_form:
        return causes

    def closed(cause: str, present: Sequence[str]) -> float:
        """Return by how much a cause lowers the held-out cost beside the remainder and the effects that are present."""
        others = [effect for effect in present if effect != cause]
        without, with_cause = (_with_effects(weighting, form, effects, values) for effects in (others, [*others, cause]))
        return without.held_out_cost - with_cause.held_out_cost

    return {
        cause: held
        for cause, held in causes.items()
        if closed(cause, [*causes, *of_form]) >= 0.5 * closed(cause, list(causes))
    }


def _cost_beside(remainder: tuple[Array, ...], weighting: Weighting, refitted: Refit) -> float:
    """Return the held-out cost of a model beside a remainder, with the weighting of the model alone."""
    return refit_on(replace(weighting, remainder=remainder), refitted).held_out_cost


def _form_causes(
    comparison: ModelComparison,
    explained: Refit,
    reachable: float,
    effects: Sequence[str],
    candidates: Sequence[str],
    others: Sequence[Refit],
    null_gains: Array,
    rng: np.random.Generator,
) -> tuple[dict[str, HeldCause], Refit]:
    """Return the effects that hold as a part of the form, and the model with them.

    Together they close most of what lies between the cost of ``explained``, the model with all other causes, and the cost
    that is ``reachable`` by a freer or a better form. The best of the ``others``, damper models with the best first, that
    lacks one of them does not predict better, and of the ``candidates`` that look like it, none does in its place.
    """
    weighting, causes, without = comparison.weighting, {}, explained
    for effect, fitted in _form_chain(weighting, explained, reachable, effects):
        lacking = [form for form in others if not contains(form.problem.model, effect)]
        instead = [_with_effects(weighting, form, explained.effects, explained.values) for form in lacking[:1]]
        support = float(probabilities([fitted, *instead], rng)[0])
        if (
            support < THRESHOLDS.named_probability
            or not holds(support, explained, fitted)
            or not _holds_in_halves(explained, fitted)
        ):
            break
        alike = [name for name in EFFECTS[effect].confused_with if name in candidates and name not in explained.effects]
        refits = {effect: fitted, NO_EFFECT: explained} | refit_in_its_place(weighting, explained, alike)
        chances = _chances(refits, support, rng)
        if not _leads(effect, chances):
            break
        gain = float(explained.held_out_cost - fitted.held_out_cost)
        closed = closed_fraction_between(explained, fitted, comparison, rng)
        causes[effect] = HeldCause(chances, p_value(gain, null_gains), closed)
        explained = fitted
    # The chain closes most of it, but what holds of the chain may not.
    if not _closes_most(without, explained, reachable):
        return {}, without
    return causes, explained


def _closes_most(without: Refit, with_effects: Refit, reachable: float) -> bool:
    """Whether effects of the form close most of what a freer or a better form can reach."""
    available = without.held_out_cost - reachable
    return bool(without.held_out_cost - with_effects.held_out_cost >= THRESHOLDS.least_form_share * available)


def _form_chain(weighting: Weighting, explained: Refit, reachable: float, effects: Sequence[str]) -> list[tuple[str, Refit]]:
    """Add effects of the form one after the other; return them where they close most of what can be reached."""
    available = explained.held_out_cost - reachable
    gap = explained.held_out_cost - weighting.noise_cost
    if available < THRESHOLDS.least_share_first * gap:
        return []
    chain: list[tuple[str, Refit]] = []
    best = explained
    while len(chain) < MOST_FORM_EFFECTS and not _closes_most(explained, best, reachable):
        remaining = [effect for effect in effects if effect not in best.effects]
        fits = refit_with_effects(
            weighting,
            BaseFit.linearise(weighting, best),
            remaining,
            len(remaining),
            present=best.effects,
            converged=ROUGHLY_CONVERGED if best.effects else CONVERGED,
        )
        if not fits:
            break
        fit = min(fits, key=lambda fit: fit.refit.held_out_cost)
        # What closes less of the gap than a formula may be wrong by is no cause.
        needed = max(THRESHOLDS.least_share_next * (best.held_out_cost - reachable), THRESHOLDS.formula_error * gap)
        if best.held_out_cost - fit.refit.held_out_cost < needed:
            break
        best = fit.refit
        chain.append((fit.effects[-1], best))
    return chain if _closes_most(explained, best, reachable) else []


def _with_and_without(weighting: Weighting, form: Refit, best: Refit, effect: str) -> tuple[Refit, Refit]:
    """Refit another form of the damper with the effects of ``best``, and with all of them but one."""
    without = [other for other in best.effects if other != effect]
    return _with_effects(weighting, form, best.effects, best.values), _with_effects(weighting, form, without, best.values)


def _with_effects(weighting: Weighting, refitted: Refit, effects: Sequence[str], values: Mapping[str, float]) -> Refit:
    """Refit a model with those effects that it does not contain; their parameters start from ``values``."""
    model, theta = refitted.problem.model, refitted.theta
    for effect in effects:
        if not contains(refitted.problem.model, effect):
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
