"""Partial explanation: the effects that can be named although the model's form is wrong, and what remains beside them.

No base model has the form of a measured damper. So causes are searched around the model of the catalogue that predicts best,
whatever model the simulator has, and a cause is named when it holds against three things: a flexible remainder for the form
of the damper (`form_remainder`), the other half of the recordings, and other damper models, which count as much as they add
to the prediction (`weighted_forms`). An effect that belongs to the form itself holds against the remainder where its
formula closes most of what the remainder can close.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.closure import closed_fraction_between
from mrd_diagnosis.effect_search import search_effects
from mrd_diagnosis.explanation import Explanation
from mrd_diagnosis.form_causes import name_form_causes
from mrd_diagnosis.form_remainder import form_effects, with_form_remainder
from mrd_diagnosis.held_cause import HeldCause, holds, holds_in_halves, leads, probabilities_in_place, with_effects
from mrd_diagnosis.limitations import contains
from mrd_diagnosis.model_comparison import NO_EFFECT, ModelComparison, compare_on
from mrd_diagnosis.null_distribution import NullGains, draw_null_errors, draw_null_gains
from mrd_diagnosis.refit import Refit, refit, refit_on
from mrd_diagnosis.statistics import probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighted_forms import weighted_forms
from mrd_diagnosis.weighting import Weighting
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]
Progress = Callable[[float], None]


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
    forms = weighted_forms(alone, other_models)
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
    explained = with_effects(weighting, form, list(causes), values)
    # What was chosen without the remainder may belong to the form as well, though the remainder cannot quite imitate it.
    of_form = [effect for effect in tried if effect in beside.of_form or (effect in chosen.effects and effect not in causes)]
    reachable = min(_cost_beside(beside.weighting.remainder, weighting, explained), chosen.held_out_cost)
    of_form_causes, explained = name_form_causes(
        comparison, explained, reachable, of_form, tried, all_but(form), beside.null_gains, rng
    )
    values |= explained.values
    needed = _still_needed(beside.weighting, form, causes, of_form_causes, values)
    if len(needed) < len(causes):
        explained = with_effects(weighting, form, [*needed, *of_form_causes], values)
    causes = needed | of_form_causes
    if form is not alone:
        # What the best form contains and the user's model does not tells the two apart. The best form may do so in part
        # only: its linear spring takes the place of most of a gas spring.
        best_cost = explained.held_out_cost
        explained = with_effects(weighting, alone, list(causes), values)
        lacked = [effect for effect in contained if effect not in lacking and not contains(alone.problem.model, effect)]
        lacked += [effect for effect in comparison.effects if effect in tried and effect not in causes]
        of_form_causes, explained = name_form_causes(
            comparison,
            explained,
            best_cost,
            lacked,
            [*tried, *lacked],
            all_but(alone),
            beside.null_gains,
            rng,
            complete=True,
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
    null_gains : NullGains
        Of the effects beside the remainder.
    """

    weighting: Weighting
    of_form: list[str]
    causes: dict[str, HeldCause]
    values: dict[str, float]
    null_gains: NullGains


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
    null_gains = draw_null_gains(base, singles, rng)
    if not chosen:
        return _BesideRemainder(weighting, of_form, {}, {}, null_gains)
    best = chosen[-1].refit
    compared = compare_on(weighting.updated(best.problem.model, best.theta, best.coefficients), base, chosen, fits)
    p_values = {fit.effects[-1]: null_gains.p_value(fit.gain, fit.refit.problem) for fit in chosen}
    causes = {}
    for effect, others in compared.alternatives.items():
        if p_values[effect] > THRESHOLDS.p_value or not holds_in_halves(others[NO_EFFECT], others[effect]):
            continue
        of_forms = [(others[effect], others[NO_EFFECT])] + [
            _with_and_without(*space, compared.best, effect) for space in spaces[1:]
        ]
        support = sum(weight * float(probabilities(pair, rng)[0]) for pair, (_, weight) in zip(of_forms, forms, strict=True))
        if not holds(support, others[NO_EFFECT], others[effect]):
            continue
        chances = probabilities_in_place(others, support, rng)
        if not leads(effect, chances):  # something is missing there, but which effect is not known
            continue
        closed = closed_fraction_between(others[NO_EFFECT], others[effect], comparison, rng)
        causes[effect] = HeldCause(chances, p_values[effect], closed)
    return _BesideRemainder(weighting, of_form, causes, compared.best.values, null_gains)


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
    """Return the causes that close beside effects of the form enough of what they close without these, see
    `Thresholds.least_share_beside_form`.

    The remainder imitates an effect of the form in part only. What it left of it, another effect may have taken up.
    """
    if not of_form:
        return causes

    def closed(cause: str, present: Sequence[str]) -> float:
        """Return by how much a cause lowers the held-out cost beside the remainder and the effects that are present."""
        others = [effect for effect in present if effect != cause]
        without, with_cause = (with_effects(weighting, form, effects, values) for effects in (others, [*others, cause]))
        return without.held_out_cost - with_cause.held_out_cost

    return {
        cause: held
        for cause, held in causes.items()
        if closed(cause, [*causes, *of_form]) >= THRESHOLDS.least_share_beside_form * closed(cause, list(causes))
    }


def _cost_beside(remainder: tuple[Array, ...], weighting: Weighting, refitted: Refit) -> float:
    """Return the held-out cost of a model beside a remainder, with the weighting of the model alone."""
    return refit_on(replace(weighting, remainder=remainder), refitted).held_out_cost


def _with_and_without(weighting: Weighting, form: Refit, best: Refit, effect: str) -> tuple[Refit, Refit]:
    """Refit another form of the damper with the effects of ``best``, and with all of them but one."""
    without = [other for other in best.effects if other != effect]
    return with_effects(weighting, form, best.effects, best.values), with_effects(weighting, form, without, best.values)


def _comparison_with(comparison: ModelComparison, effects: Sequence[str], values: Mapping[str, float]) -> ModelComparison:
    """Refit the user's model with one effect more at a time, without the remainder."""
    chain = [
        with_effects(comparison.weighting, comparison.base, effects[: count + 1], values) for count in range(len(effects))
    ]
    alternatives = {effect: {effect: chain[-1]} for effect in effects}
    return replace(comparison, chain=tuple(chain), effects=tuple(effects), alternatives=alternatives)
