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
from mrd_diagnosis.evidence.evidence import FitsOfEffect, measure_evidence
from mrd_diagnosis.fitting.base_fit import LinearisedRefit
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.fitting.statistics import LEAST_GAP, effect_parameters, model_probabilities
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
from mrd_diagnosis.wrong_form.robustness import predicts_both_halves
from mrd_sim.effects import EFFECTS

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Hypothesis:
    """A form of the damper with one effect more than before, or without one (`NO_EFFECT`), fitted together."""

    form: str
    effect: str
    refit: Refit


@dataclass(frozen=True)
class Table:
    """The hypotheses of one place, and the probability of each effect in it, and of none, by name, best first."""

    hypotheses: Sequence[Hypothesis]
    probabilities: Mapping[str, float]

    @property
    def by_form(self) -> tuple[dict[str, Refit], ...]:
        """The refits of each form by effect, in the order of the forms."""
        refits: dict[str, dict[str, Refit]] = {}
        for entry in self.hypotheses:
            refits.setdefault(entry.form, {})[entry.effect] = entry.refit
        return tuple(refits.values())

    @property
    def lead(self) -> str:
        """The most probable effect around the first form."""
        return next(name for name in self.probabilities if name in self.by_form[0] and name != NO_EFFECT)

    def members(self, effect: str) -> tuple[Member, ...]:
        """Return the class of an effect, around the first form."""
        of_effects = {name: value for name, value in self.probabilities.items() if name != NO_EFFECT}
        return class_of(effect, self.by_form[0], of_effects)


@dataclass(frozen=True)
class LeadingEffect:
    """An effect that leads in its place, with all that speaks for it and against it.

    Attributes
    ----------
    effect : str
    table : dict
        Probability of each effect in the table of its place, and of none, by name.
    probabilities : dict
        Probability of each effect in its place, itself included, by name, with the learnt one of its class.
    members : tuple of Member
        Its class.
    without, fitted : Refit
        The first form with the other effects, and with this one as well.
    evidence : mapping
        The numbers of `mrd_diagnosis.evidence.evidence.EVIDENCE` by name.
    parameters_by_form : tuple of mapping
        Its parameters with intervals around each form.
    """

    effect: str
    table: dict[str, float]
    probabilities: dict[str, float]
    members: tuple[Member, ...]
    without: Refit
    fitted: Refit
    evidence: Mapping[str, float]
    parameters_by_form: tuple[Mapping[str, ParameterEstimate], ...]

    @property
    def presence(self) -> float:
        """Probability that one effect of its class is there."""
        return sum(member.probability for member in self.members)

    def summary(self) -> WeighedEffect:
        """Return what a report says of it."""
        members = tuple(member.effect for member in self.members)
        return WeighedEffect(self.effect, members, self.presence, self.evidence, self.table)


def weigh_effects(
    weighting: Weighting,
    forms: Sequence[Refit],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress = ignore,
) -> list[LeadingEffect]:
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
    tables: dict[str, Table] = {}
    for done, effect in enumerate(chosen, 1):
        others = [other for other in present if other != effect]
        free = [name for name in ranked if name not in others]
        table = _table_of_place(weighting, forms, effect, others, free, values, rng)
        progress(0.5 + 0.5 * done / len(chosen))
        present = [*others, table.lead]
        values |= table.by_form[0][table.lead].values
        tables[table.lead] = table
    if not tables:
        return []
    complete = with_effects(weighting, forms[0], present, values)
    beside, plain = with_form_remainder(weighting, forms[0])
    beside_complete = with_effects(beside, plain, present, values)
    return [_weigh(lead, table, complete, beside, beside_complete) for lead, table in tables.items()]


def _table_of_place(
    weighting: Weighting,
    forms: Sequence[Refit],
    effect: str,
    others: Sequence[str],
    free: Sequence[str],
    values: dict[str, float],
    rng: np.random.Generator,
) -> Table:
    """Fit the hypotheses of the place of an effect beside others: with it, and with the best and the most similar of those
    that are ``free``.
    """
    # A form that contains the effect cannot lack it.
    lacking = [form for form in forms if not contains(form.problem.model, effect)]
    bases = [with_effects(weighting, form, others, form.values | values) for form in lacking]
    alike = [name for name in free if name in EFFECTS[effect].confused_with]
    hypotheses = fit_table(weighting, bases, list(dict.fromkeys([effect, *free[:MOST_ALTERNATIVES], *alike])))
    return Table(hypotheses, table_probabilities(hypotheses, rng))


def _weigh(effect: str, table: Table, complete: Refit, beside: Weighting, beside_complete: Refit) -> LeadingEffect:
    """Measure the evidence of an effect, and let the learnt probability of its class take the place of the table's.

    ``complete`` is the first form with all effects, ``beside_complete`` the same beside the form remainder.
    """
    members = table.members(effect)
    fits = FitsOfEffect(
        effect=effect,
        support=sum(table.probabilities[member.effect] for member in members),
        fitted=table.by_form[0][effect],
        complete=complete,
        remainder_without=refit_without(beside, beside_complete, effect),
        remainder_complete=beside_complete,
        remainder_noise_cost=beside.noise_cost,
    )
    evidence = measure_evidence(fits)
    probabilities = with_presence(table.probabilities, [member.effect for member in members], presence_of(evidence))
    return LeadingEffect(
        effect=effect,
        table=dict(table.probabilities),
        probabilities=probabilities,
        members=tuple(replace(member, probability=probabilities[member.effect]) for member in members),
        without=table.by_form[0][NO_EFFECT],
        fitted=fits.fitted,
        evidence=evidence,
        parameters_by_form=tuple(effect_parameters(refits[effect]) for refits in table.by_form if effect in refits),
    )


def _search(
    weighting: Weighting, form: Refit, effects: Sequence[str], progress: Progress
) -> tuple[dict[str, Refit], list[EffectFit], Weighting]:
    """Add the effects to a form that lower the held-out error most; return the form with each of them and those before it,
    each effect by itself, and the weighting beside all.
    """
    weighting = weighting.updated(form.problem.model, form.theta)
    best = refit_on(weighting, form)
    gap = left = best.held_out_cost - weighting.noise_cost
    chosen: dict[str, Refit] = {}
    singles: list[EffectFit] = []
    while len(chosen) < MOST_CAUSES:
        remaining = [effect for effect in effects if effect not in chosen and not contains(form.problem.model, effect)]
        fits = refit_with_effects(
            weighting,
            LinearisedRefit.around(weighting, best),
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
        lead = next((fit for fit in fits if predicts_both_halves(best, fit.refit)), None)
        if lead is None or lead.held_out_gain < enough:
            break
        chosen[lead.effects[-1]] = lead.refit
        weighting = weighting.updated(lead.refit.problem.model, lead.refit.theta)
        left_before, best = left - lead.held_out_gain, refit_on(weighting, lead.refit)
        left = best.held_out_cost - weighting.noise_cost
        gap = reweighted_gap(gap, left_before, left)
    return chosen, singles, weighting


def reweighted_gap(gap: float, left_before: float, left: float) -> float:
    """Return a gap (white squares) with another weighting, in which ``left_before`` of it has become ``left``: a weighting
    tells more the less is missing.
    """
    return gap * left / max(left_before, LEAST_GAP)


def fit_table(weighting: Weighting, bases: Sequence[Refit], effects: Sequence[str]) -> list[Hypothesis]:
    """Fit each form with each of the effects that it does not contain; each form without any of them comes first."""
    table = []
    for base in bases:
        lacking = [effect for effect in effects if not contains(base.problem.model, effect)]
        refits = {NO_EFFECT: base} | refit_in_its_place(weighting, base, lacking, ROUGHLY_CONVERGED)
        table += [Hypothesis(base.problem.model.id, effect, refitted) for effect, refitted in refits.items()]
    return table


def table_probabilities(table: Sequence[Hypothesis], rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each effect of a table, and of none (`NO_EFFECT`), best first."""
    best = min(table, key=lambda entry: entry.refit.held_out_cost)
    without = next(entry for entry in table if (entry.form, entry.effect) == (best.form, NO_EFFECT))
    ordered = list({id(entry): entry for entry in (best, without, *table)}.values())
    probabilities: dict[str, float] = {}
    found = model_probabilities([entry.refit for entry in ordered], rng, [entry.effect for entry in ordered])
    for entry, probability in zip(ordered, found, strict=True):
        probabilities[entry.effect] = probabilities.get(entry.effect, 0.0) + float(probability)
    return dict(sorted(probabilities.items(), key=lambda item: -item[1]))
