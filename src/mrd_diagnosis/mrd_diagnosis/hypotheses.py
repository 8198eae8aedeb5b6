"""Hypotheses: forms of the damper with effects, fitted together and judged in one table.

No damper model of the catalogue has the form of a measured damper. A form that is fitted without an effect takes up what it
can of this effect, so an effect is asked together with each of several forms, before anything flexible is. The probability
of an effect is that of all hypotheses that contain it, whatever their form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mrd_diagnosis.base_fit import BaseFit
from mrd_diagnosis.cause_class import class_of
from mrd_diagnosis.diagnosis import Member
from mrd_diagnosis.effect_search import BEST_SCORES, MOST_CAUSES, ROUGHLY_CONVERGED, EffectFit, refit_with_effects
from mrd_diagnosis.form_remainder import with_form_remainder
from mrd_diagnosis.held_cause import holds_in_halves, leads, with_effects
from mrd_diagnosis.limitations import contains
from mrd_diagnosis.model_comparison import MOST_ALTERNATIVES, NO_EFFECT, refit_in_its_place
from mrd_diagnosis.refit import Refit, refit_on
from mrd_diagnosis.statistics import effect_parameters, probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting
from mrd_sim.effects import EFFECTS

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Hypothesis:
    """A form of the damper with one effect more than before, or without one (`NO_EFFECT`), fitted together."""

    form: str
    effect: str
    refit: Refit


@dataclass(frozen=True)
class Selected:
    """An effect that is more likely than everything else in its place, by itself or with its class.

    Attributes
    ----------
    effect : str
    chances : dict
        Probability of each effect in its place, itself included, by name.
    members : tuple of Member
        Its class.
    without, fitted : Refit
        The first form with the other effects, and with this one as well.
    """

    effect: str
    chances: dict[str, float]
    members: tuple[Member, ...]
    without: Refit
    fitted: Refit


def select_effects(
    weighting: Weighting,
    forms: Sequence[Refit],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress = lambda _fraction: None,
) -> list[Selected]:
    """Select effects around the first form one after the other, and keep those that hold around most of the forms.

    Parameters
    ----------
    weighting : Weighting
    forms : sequence of Refit
        Damper models without effects.
    effects : sequence of str
        Ids of the candidates.
    rng : numpy Generator
    progress : callable
        Called with the fraction of the work that is done.
    """
    chosen, singles, weighting = _search(weighting, forms[0], effects, lambda fraction: progress(0.5 * fraction))
    ranked = [fit.effects[0] for fit in sorted(singles, key=lambda fit: fit.refit.held_out_cost)]
    present = list(chosen)
    values = chosen[present[-1]].values if present else {}
    selected = []
    for place, effect in enumerate(chosen):
        others = [other for other in present if other != effect]
        bases = [with_effects(weighting, form, others, form.values | values) for form in forms]
        free = [name for name in ranked if name not in others]
        alike = [name for name in free if name in EFFECTS[effect].confused_with]
        asked = list(dict.fromkeys([effect, *free[:MOST_ALTERNATIVES], *alike]))
        found = _judge(effect, fit_table(weighting, bases, asked), rng)
        progress(0.5 + 0.5 * (place + 1) / len(chosen))
        present = others
        if found is not None:
            selected.append(found)
            present, values = [*others, found.effect], values | found.fitted.values
    if not selected:
        return []
    complete = with_effects(weighting, forms[0], present, values)
    beside, plain = with_form_remainder(weighting, forms[0])
    freed = with_effects(beside, plain, present, values)
    return [found for found in selected if keeps_its_size(freed, complete, found.effect)]


def keeps_its_size(freed: Refit, complete: Refit, effect: str) -> bool:
    """Whether an effect has beside the form remainder about the size that it has without one.

    The remainder takes most of what many effects do, but what it leaves of a mechanism has the size of the whole. What
    stands in for a wrong form is not needed any more. Where the remainder leaves too little to tell, nothing is known.

    Parameters
    ----------
    freed, complete : Refit
        The form with the effects, beside the remainder and without it.
    effect : str
        Id of one of the effects.
    """
    first = EFFECTS[effect].parameters[0]
    name, neutral = f"{effect}.{first.name}", first.default
    size = complete.values[name] - neutral
    beside = effect_parameters(freed)[name].value
    largest = max((end - neutral) / size for end in (beside.lower, beside.upper)) if size else 0.0
    return largest >= THRESHOLDS.least_size_beside_remainder


def _search(
    weighting: Weighting, form: Refit, effects: Sequence[str], progress: Progress
) -> tuple[dict[str, Refit], list[EffectFit], Weighting]:
    """Add the effects to a form that lower the held-out error most; return the form with each of them and those before it,
    each effect by itself, and the weighting beside all.
    """
    weighting = weighting.updated(form.problem.model, form.theta)
    best = refit_on(weighting, form)
    gap = best.held_out_cost - weighting.noise_cost
    chosen: dict[str, Refit] = {}
    singles: list[EffectFit] = []
    while len(chosen) < MOST_CAUSES:
        remaining = [effect for effect in effects if effect not in chosen and not contains(form.problem.model, effect)]
        fits = refit_with_effects(
            weighting,
            BaseFit.linearise(weighting, best),
            remaining,
            BEST_SCORES if chosen else len(remaining),
            {fit.effects[0]: fit.refit for fit in singles} if chosen else None,
            present=best.effects,
            converged=ROUGHLY_CONVERGED,
        )
        fits.sort(key=lambda fit: fit.refit.held_out_cost)
        singles = singles or fits
        progress((1.0 + len(chosen)) / MOST_CAUSES)
        enough = THRESHOLDS.least_share_beside_form * gap
        lead = next((fit for fit in fits if holds_in_halves(best, fit.refit)), None)
        if lead is None or lead.held_out_gain < max(enough, 0.0):
            break
        chosen[lead.effects[-1]] = lead.refit
        weighting = weighting.updated(lead.refit.problem.model, lead.refit.theta)
        before, best = gap, refit_on(weighting, lead.refit)
        # The weighting tells more the less is missing; the share is that of the gap as it was.
        gap = (best.held_out_cost - weighting.noise_cost) * before / max(before - lead.held_out_gain, 1e-9)
    return chosen, singles, weighting


def fit_table(weighting: Weighting, bases: Sequence[Refit], effects: Sequence[str]) -> list[Hypothesis]:
    """Fit each form with each of the effects that it does not contain; each form without any of them comes first."""
    table = []
    for base in bases:
        asked = [effect for effect in effects if not contains(base.problem.model, effect)]
        refits = {NO_EFFECT: base} | refit_in_its_place(weighting, base, asked, ROUGHLY_CONVERGED)
        table += [Hypothesis(base.problem.model.id, effect, refitted) for effect, refitted in refits.items()]
    return table


def chances_of(table: Sequence[Hypothesis], rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each effect of a table, and of none (`NO_EFFECT`), best first."""
    best = min(table, key=lambda entry: entry.refit.held_out_cost)
    without = next(entry for entry in table if (entry.form, entry.effect) == (best.form, NO_EFFECT))
    ordered = [best, without, *(entry for entry in table if entry is not best and entry is not without)]
    chances: dict[str, float] = {}
    for entry, chance in zip(ordered, probabilities([entry.refit for entry in ordered], rng), strict=True):
        chances[entry.effect] = chances.get(entry.effect, 0.0) + float(chance)
    return dict(sorted(chances.items(), key=lambda item: -item[1]))


def _judge(effect: str, table: Sequence[Hypothesis], rng: np.random.Generator) -> Selected | None:
    """Return the effect that leads a table in the place of ``effect``, or None where none holds."""
    chances = chances_of(table, rng)
    form = table[0].form
    around_first = {entry.effect: entry.refit for entry in table if entry.form == form}
    lead = next((name for name in chances if name in around_first), NO_EFFECT)
    if lead == NO_EFFECT:
        return None
    members = class_of(lead, around_first, chances)
    of_effects = {name: chance for name, chance in chances.items() if name != NO_EFFECT}
    if sum(of_effects.values()) < THRESHOLDS.named_support:
        return None
    if not leads(lead, of_effects, members) or not _helps_most_forms(table, {member.effect for member in members}):
        return None
    return Selected(lead, of_effects, members, around_first[NO_EFFECT], around_first[lead])


def _helps_most_forms(table: Sequence[Hypothesis], alike: set[str]) -> bool:
    """Whether most forms predict better with one of the effects of a class."""
    helped = []
    for form in dict.fromkeys(entry.form for entry in table):
        costs = {entry.effect: entry.refit.held_out_cost for entry in table if entry.form == form}
        if fitted := [cost for effect, cost in costs.items() if effect in alike]:
            helped.append(min(fitted) < costs[NO_EFFECT])
    return 2 * sum(helped) > len(helped)
