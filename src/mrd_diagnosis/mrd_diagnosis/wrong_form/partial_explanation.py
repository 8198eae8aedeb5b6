"""Partial explanation: the effects that can be named although the model's form is wrong, and what remains beside them.

No base model has the form of a measured damper. So effects are selected around the models of the catalogue that predict
best, whatever model the simulator has, each fitted together with every one of these (`hypotheses`). What the best model
contains and the simulator's model lacks is named as well where it closes most of the difference between the two
(`form_causes`). A flexible remainder (`form_remainder`) comes last: it tells how much of the rest lies in the form of the
damper.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.explanation import Explanation, RobustCause
from mrd_diagnosis.decision.verdict import verdict_beside_other_forms
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.recordings.limitations import contains
from mrd_diagnosis.search.model_comparison import ModelComparison, with_chain, with_effects
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wrong_form.form_causes import name_form_causes
from mrd_diagnosis.wrong_form.form_remainder import form_effects, with_form_remainder
from mrd_diagnosis.wrong_form.hypotheses import LeadingEffect, weigh_effects
from mrd_diagnosis.wrong_form.stacking import stacked_forms
from mrd_sim.effects import EFFECTS

Progress = Callable[[float], None]


def explain_in_part(
    explanation: Explanation,
    other_models: Sequence[Refit],
    effects: Sequence[str],
    null_gains: NullGains,
    rng: np.random.Generator,
    progress: Progress = ignore,
) -> Explanation:
    """Find the effects that can be named although the form of the model may be wrong.

    What the model lacks by construction, such as a hysteretic state, belongs to its form: it stays as it was chosen.

    Parameters
    ----------
    explanation : Explanation
        With the model alone. It is returned where it holds around other forms as well.
    other_models : sequence of Refit
        Other damper models, without effects.
    effects : sequence of str
        Ids of the candidates.
    null_gains : NullGains
        What noise alone gives.
    rng : numpy Generator
    progress : callable
        Called with the fraction of the work that is done.
    """
    comparison = explanation.comparison
    weighting = comparison.weighting
    lacking = lacking_effects(comparison)
    alone = comparison.chain[len(lacking) - 1] if lacking else comparison.base
    forms = stacked_forms(alone, other_models)
    form = forms[0]
    contained = [effect for effect in effects if contains(form.problem.model, effect)]
    tried = [effect for effect in effects if effect not in (*lacking, *contained)]
    weighed = weigh_effects(weighting, forms, tried, rng, lambda fraction: progress(0.8 * fraction))
    selected = [entry for entry in weighed if entry.presence >= THRESHOLDS.least_probability]
    causes = {found.effect: _robust_cause(found, comparison, null_gains, rng) for found in selected}
    values = alone.values | (selected[-1].fitted.values if selected else {})
    explained = with_effects(weighting, form, list(causes), values)
    values |= explained.values
    if form is not alone:
        # What the best form contains and the user's model does not tells the two apart. The best form may do so in part
        # only: its linear spring takes the place of most of a gas spring.
        best_cost = explained.held_out_cost
        explained = with_effects(weighting, alone, list(causes), values)
        lacked = [effect for effect in contained if effect not in lacking and not contains(alone.problem.model, effect)]
        lacked += _chosen_around_model_only(comparison, tried, weighed)
        of_form_causes, explained = name_form_causes(
            comparison,
            explained,
            best_cost,
            lacked,
            [*tried, *lacked],
            sorted(other_models, key=lambda other: other.held_out_cost),
            null_gains,
            rng,
        )
        causes, values = causes | of_form_causes, values | explained.values
    explanation = replace(explanation, weighed=tuple(entry.summary() for entry in weighed))
    progress(0.9)
    named = [*lacking, *causes]
    if explanation.verdict != "unknown_effect" and set(named) == set(comparison.effects):
        return explanation
    form_fraction = _form_fraction(comparison, alone, explained)
    explanation = replace(explanation, verdict=verdict_beside_other_forms(named), form_fraction=form_fraction)
    if not named:
        return explanation
    return replace(
        explanation,
        comparison=with_chain(comparison, named, values),
        probabilities={effect: explanation.probabilities[effect] for effect in lacking}
        | {effect: cause.probabilities for effect, cause in causes.items()},
        p_values={effect: explanation.p_values[effect] for effect in lacking}
        | {effect: cause.p_value for effect, cause in causes.items()},
        robust=causes,
    )


def lacking_effects(comparison: ModelComparison) -> tuple[str, ...]:
    """Return the chosen effects that the model lacks by construction; they are chosen first."""
    return tuple(itertools.takewhile(lambda effect: EFFECTS[effect].structural, comparison.effects))


def rests_on_form(comparison: ModelComparison) -> bool:
    """Whether an explanation needs effects of the form and leaves more than noise: the base model may be wrong instead."""
    if comparison.best.chi_square <= THRESHOLDS.noise_chi_square:
        return False
    return bool(form_effects(comparison.weighting, comparison.base, comparison.effects))


def _chosen_around_model_only(
    comparison: ModelComparison, tried: Sequence[str], weighed: Sequence[LeadingEffect]
) -> list[str]:
    """Return the effects that were chosen around the user's model, and neither lead around the best form nor look like one
    that does.
    """
    known = {member.effect for entry in weighed for member in entry.members}
    return [effect for effect in comparison.effects if effect in tried and effect not in known]


def _robust_cause(
    found: LeadingEffect, comparison: ModelComparison, null_gains: NullGains, rng: np.random.Generator
) -> RobustCause:
    gain = found.without.held_out_cost - found.fitted.held_out_cost
    closed = closed_fraction_between(found.without, found.fitted, comparison, rng)
    p_value = null_gains.p_value(gain, found.fitted.problem)
    return RobustCause(found.probabilities, p_value, closed, found.members, found.parameters_by_form)


def _form_fraction(comparison: ModelComparison, alone: Refit, explained: Refit) -> float:
    """Return the share of the gap that the form remainder of the user's model closes beside what explains the gap."""
    weighting = comparison.weighting
    remainder = with_form_remainder(weighting, alone)[0].remainder
    cost = refit_on(replace(weighting, remainder=remainder), explained).held_out_cost
    gap = comparison.base.held_out_cost - weighting.noise_cost
    return float(np.clip((explained.held_out_cost - cost) / gap, 0.0, 1.0))
