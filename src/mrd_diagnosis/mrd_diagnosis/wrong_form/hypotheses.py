"""Hypotheses: forms of the damper with effects, fitted together and judged in one table.

No damper model of the catalogue has the form of a measured damper. A form that is fitted without an effect takes up what it
can of this effect, so an effect is asked together with each of several forms, before anything flexible is. The probability
of an effect is that of all hypotheses that contain it, whatever their form.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis.decision.presence import presence_of, with_presence
from mrd_diagnosis.diagnosis import Member, ParameterEstimate, WeighedEffect
from mrd_diagnosis.evidence.cause_class import class_of
from mrd_diagnosis.evidence.evidence import (
    Evidence,
    balance_of_folds,
    balance_of_halves,
    drift_over_runs,
    kept_size,
    lead_over,
    share_closed,
)
from mrd_diagnosis.fitting.base_fit import BaseFit
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.statistics import effect_parameters, probabilities
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.recordings.limitations import contains
from mrd_diagnosis.search.effect_search import BEST_SCORES, MOST_CAUSES, ROUGHLY_CONVERGED, EffectFit, refit_with_effects
from mrd_diagnosis.search.model_comparison import (
    MOST_ALTERNATIVES,
    NO_EFFECT,
    refit_in_its_place,
    refit_without,
    with_effects,
)
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wrong_form.form_remainder import with_form_remainder
from mrd_diagnosis.wrong_form.held_cause import holds_in_halves
from mrd_sim.effects import EFFECTS

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Hypothesis:
    """A form of the damper with one effect more than before, or without one (`NO_EFFECT`), fitted together."""

    form: str
    effect: str
    refit: Refit


@dataclass(frozen=True)
class Weighed:
    """An effect that leads in its place, with all that speaks for it and against it.

    Attributes
    ----------
    effect : str
    table : dict
        Probability of each effect in the table of its place, and of none, by name.
    chances : dict
        Probability of each effect in its place, itself included, by name, with the learnt one of its class.
    members : tuple of Member
        Its class.
    without, fitted : Refit
        The first form with the other effects, and with this one as well.
    evidence : Evidence
    sizes : tuple of mapping
        Its parameters with intervals around each form.
    """

    effect: str
    table: dict[str, float]
    chances: dict[str, float]
    members: tuple[Member, ...]
    without: Refit
    fitted: Refit
    evidence: Evidence
    sizes: tuple[Mapping[str, ParameterEstimate], ...]

    @property
    def presence(self) -> float:
        """Probability that one effect of its class is there."""
        return sum(member.probability for member in self.members)

    def summary(self) -> WeighedEffect:
        """Return what a report says of it."""
        members = tuple(member.effect for member in self.members)
        return WeighedEffect(self.effect, members, self.presence, self.evidence.as_dict(), self.table)


def weigh_effects(
    weighting: Weighting,
    forms: Sequence[Refit],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress = ignore,
) -> list[Weighed]:
    """Select effects around the first form one after the other, and weigh each beside the others around all forms.

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
    ranked = [fit.effects[-1] for fit in singles]
    present = list(chosen)
    values = chosen[present[-1]].values if present else {}
    places = []
    for place, effect in enumerate(chosen):
        others = [other for other in present if other != effect]
        # A form that contains the effect cannot lack it.
        lacking = [form for form in forms if not contains(form.problem.model, effect)]
        bases = [with_effects(weighting, form, others, form.values | values) for form in lacking]
        free = [name for name in ranked if name not in others]
        alike = [name for name in free if name in EFFECTS[effect].confused_with]
        table = fit_table(weighting, bases, list(dict.fromkeys([effect, *free[:MOST_ALTERNATIVES], *alike])))
        chances = chances_of(table, rng)
        progress(0.5 + 0.5 * (place + 1) / len(chosen))
        around_first = {entry.effect: entry.refit for entry in table if entry.form == table[0].form}
        lead = next(name for name in chances if name in around_first and name != NO_EFFECT)
        present = [*others, lead]
        values |= around_first[lead].values
        places.append((lead, chances, table))
    if not places:
        return []
    complete = with_effects(weighting, forms[0], present, values)
    beside, plain = with_form_remainder(weighting, forms[0])
    freed = with_effects(beside, plain, present, values)
    gap = refit_on(weighting, forms[0]).held_out_cost - weighting.noise_cost
    left = float(np.clip((complete.held_out_cost - weighting.noise_cost) / max(gap, 1e-300), 0.0, 1.0))
    weighed = []
    for lead, chances, table in places:
        closed_beside = share_closed(refit_without(beside, freed, lead), freed, beside.noise_cost)
        weighed.append(_weigh(lead, chances, table, complete, freed, closed_beside, weighting.noise_cost, left))
    return weighed


def _weigh(
    effect: str,
    chances: Mapping[str, float],
    table: Sequence[Hypothesis],
    complete: Refit,
    freed: Refit,
    closed_beside: float,
    noise_cost: float,
    left: float,
) -> Weighed:
    """Gather the evidence of an effect from the table of its place and from the fits with all effects."""
    around = {form: {entry.effect: entry.refit for entry in table if entry.form == form} for form in _forms_of(table)}
    first = around[table[0].form]
    without, fitted = first[NO_EFFECT], first[effect]
    members = class_of(effect, first, {name: chance for name, chance in chances.items() if name != NO_EFFECT})
    alike = {member.effect for member in members}
    shares = [
        max(share_closed(refits[NO_EFFECT], refits[name], noise_cost) for name in alike & refits.keys())
        for refits in around.values()
        if alike & refits.keys()
    ]
    rivals = [refitted for name, refitted in first.items() if name not in alike and name != NO_EFFECT]
    evidence = Evidence(
        closed=share_closed(without, fitted, noise_cost),
        closed_of_forms=float(np.median(shares)),
        lead=lead_over(without, fitted, rivals),
        support=sum(chances[name] for name in alike),
        halves=balance_of_halves(without, fitted),
        folds=balance_of_folds(without, fitted),
        kept=kept_size(complete, freed, effect),
        beside=closed_beside,
        drift=drift_over_runs(fitted, effect),
        left=left,
    )
    sizes = tuple(effect_parameters(refits[effect]) for refits in around.values() if effect in refits)
    return _with_presence(Weighed(effect, dict(chances), dict(chances), members, without, fitted, evidence, sizes))


def _with_presence(weighed: Weighed) -> Weighed:
    """Replace the probabilities in a place by those that follow from the learnt one of the class."""
    alike = [member.effect for member in weighed.members]
    chances = with_presence(weighed.chances, alike, presence_of(weighed.evidence))
    members = tuple(replace(member, probability=chances[member.effect]) for member in weighed.members)
    return replace(weighed, chances=chances, members=members)


def _forms_of(table: Sequence[Hypothesis]) -> list[str]:
    return list(dict.fromkeys(entry.form for entry in table))


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
        if gap <= 0.0:
            break
        enough = THRESHOLDS.least_share_beside_form * gap
        lead = next((fit for fit in fits if holds_in_halves(best, fit.refit)), None)
        if lead is None or lead.held_out_gain < enough:
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
    ordered = list({id(entry): entry for entry in (best, without, *table)}.values())
    chances: dict[str, float] = {}
    for entry, chance in zip(ordered, probabilities([entry.refit for entry in ordered], rng), strict=True):
        chances[entry.effect] = chances.get(entry.effect, 0.0) + float(chance)
    return dict(sorted(chances.items(), key=lambda item: -item[1]))
