"""Conclusion: the rejection rules applied to what would be named, and what remains to be said then."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.causes import name_causes, with_intervals_of_all_forms
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.decision.rejection_rules import RULES, Claim, Rule, rejecting_rule
from mrd_diagnosis.decision.verdict import verdict_after_rejection
from mrd_diagnosis.diagnosis import AlternativeModel, Candidate, Cause, Finding, Interval, Rejected
from mrd_diagnosis.fitting.refit import refit_on
from mrd_diagnosis.recordings.imitating_limitations import clock_finding, imitating_limitations
from mrd_diagnosis.search.model_comparison import ModelComparison, RefitComparison, refit_without, unchanged, with_chain
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.parallel import in_threads
from mrd_runs import Run


@dataclass(frozen=True)
class Conclusion:
    """What may be said of an explanation after the rejection rules.

    Attributes
    ----------
    explanation : Explanation
        With the verdict that remains.
    complete : ModelComparison
        The comparison of the explanation on all samples.
    causes : tuple of Cause
        The causes that are named.
    rejected : tuple of Rejected
        The causes that would have been named without the rules.
    limitations : tuple of Finding
        Limitations of the recordings for which causes were rejected; with the verdict ``data_fault`` they are the answer.
    """

    explanation: Explanation
    complete: ModelComparison
    causes: tuple[Cause, ...]
    rejected: tuple[Rejected, ...] = ()
    limitations: tuple[Finding, ...] = ()


def conclude(
    explanation: Explanation,
    complete: ModelComparison,
    findings: Sequence[Finding],
    runs: Sequence[Run],
    rng: np.random.Generator,
    in_loop: RefitComparison = unchanged,
) -> Conclusion:
    """Hold the effects that an explanation would name against the rejection rules.

    Where none is left and the recordings are a reason for that, their limitation is the answer. Where they are seen but not
    determined, they stay in the model as what comes nearest, and the verdict is ambiguous if they close the gap. Where some
    causes remain, they explain a part of the gap.

    Parameters
    ----------
    explanation : Explanation
    complete : ModelComparison
        Of the explanation, on all samples.
    findings : sequence of Finding
        Of the preflight check.
    runs : sequence of Run
    rng : numpy Generator
    in_loop : callable
        See `mrd_diagnosis.explain_gap.explain_gap`.
    """
    causes = name_causes(replace(explanation, comparison=complete), rng)
    of_clocks = clock_finding(runs)
    named: list[Cause] = []
    rejected: list[Rejected] = []
    rules: list[Rule] = []
    reasons: list[Finding] = []
    for cause, claim in zip(causes, _claims(causes, complete, findings, of_clocks, rng), strict=True):
        rule = rejecting_rule(claim)
        if rule is None:
            named.append(cause)
            continue
        rules.append(rule)
        rejected.append(_rejected(claim, rule))
        reasons += claim.limitations if rule.id == "limitation" else [of_clocks] if rule.id == "clocks" and of_clocks else []
    effects = [cause.effect for cause in named]
    explanation = replace(explanation, verdict=verdict_after_rejection(explanation.verdict, effects, rules, reasons))
    if rejected and named:
        explanation = replace(
            explanation,
            comparison=_with_only(explanation.comparison, effects),
            probabilities={effect: explanation.probabilities[effect] for effect in effects},
        )
        complete = in_loop(_with_only(complete, effects))
        named = list(name_causes(replace(explanation, comparison=complete), rng))
    causes = tuple(with_intervals_of_all_forms(cause, explanation) for cause in named)
    return Conclusion(explanation, complete, causes, tuple(rejected), tuple(dict.fromkeys(reasons)))


def worse_by_runs(conclusion: Conclusion) -> Conclusion:
    """Reject all causes, since with them each run is predicted worse from the others than without.

    Segments of one run may say otherwise: an end stop that was moved between the runs is predicted well within each.
    """
    rule = next(rule for rule in RULES if rule.id == "worse")
    rejected = [
        _rejected(Claim(cause.effect, cause.parameters, cause.probability, cause.p_value, cause.closed_fraction), rule)
        for cause in conclusion.causes
    ]
    verdict = verdict_after_rejection(conclusion.explanation.verdict, [], [rule] * len(rejected), [])
    return replace(
        conclusion,
        explanation=replace(conclusion.explanation, verdict=verdict),
        causes=(),
        rejected=(*rejected, *conclusion.rejected),
    )


def _claims(
    causes: Sequence[Cause],
    complete: ModelComparison,
    findings: Sequence[Finding],
    of_clocks: Finding | None,
    rng: np.random.Generator,
) -> list[Claim]:
    """Return what is claimed of each cause, with what speaks against it."""
    together = closed_fraction_between(complete.base, complete.best, complete, rng)
    open_fraction = float(np.clip(1.0 - np.nan_to_num(together.value), 0.0, 1.0))
    beside = closed_beside_others(complete, rng)
    return [
        Claim(
            cause.effect,
            cause.parameters,
            cause.probability,
            cause.p_value,
            cause.closed_fraction,
            open_fraction,
            together,
            beside[cause.effect],
            limitations=_unrefuted(cause.effect, imitating_limitations(cause.effect, findings), complete),
            clocks_agree=of_clocks is None,
            level=cause.level,
        )
        for cause in causes
    ]


def closed_beside_others(comparison: ModelComparison, rng: np.random.Generator) -> dict[str, Interval]:
    """Return the share of the gap that each effect closes in the user's model beside the others, by effect.

    An effect that was found around another form may be superfluous in the user's model, where the others have taken its
    part. One that predicts worse is left out before the others are judged, so that of two that take each other's place one
    stays.
    """
    weighting, effects = comparison.weighting, list(comparison.effects)
    closed: dict[str, Interval] = {}
    # The simulator is in the loop of none of these refits.
    best = refit_on(weighting, comparison.best)
    while len(effects) > 1:
        without = dict(zip(effects, in_threads(partial(refit_without, weighting, best), effects), strict=True))
        found = {effect: closed_fraction_between(without[effect], best, comparison, rng) for effect in effects}
        least = min(effects, key=lambda effect: found[effect].upper)
        if not found[least].upper < 0.0:
            return closed | found
        closed[least], best = found[least], without[least]
        effects.remove(least)
    return closed | dict.fromkeys(effects, Interval(float("nan")))


def reject_others(
    conclusion: Conclusion,
    candidates: Sequence[Candidate],
    models: Sequence[AlternativeModel],
    findings: Sequence[Finding],
    runs: Sequence[Run],
) -> tuple[Rejected, ...]:
    """Return every effect that was tried and is not named, with the rule that rejected it; first those that were chosen."""
    known = {cause.effect for cause in conclusion.causes} | {entry.effect for entry in conclusion.rejected}
    presence = {entry.effect: entry.probability for entry in conclusion.explanation.weighed}
    others = []
    for candidate in candidates:
        if len(candidate.effects) > 1 or candidate.effects[0] in known:
            continue
        effect = candidate.effects[0]
        claim = Claim(
            effect,
            candidate.parameters,
            candidate.probability,
            candidate.p_value,
            candidate.closed_fraction,
            1.0 - float(np.clip(np.nan_to_num(candidate.closed_fraction.value), 0.0, 1.0)),
            chosen=False,
            has_gap=conclusion.explanation.verdict != "no_gap",
            limitations=imitating_limitations(effect, findings),
            clocks_agree=clock_finding(runs) is None,
            other_model=models[0].closed_fraction.value if models else float("nan"),
            presence=presence.get(effect, 1.0),
        )
        if rule := rejecting_rule(claim):
            others.append(_rejected(claim, rule))
    return (*conclusion.rejected, *others)


def _rejected(claim: Claim, rule: Rule) -> Rejected:
    return Rejected(
        claim.effect,
        rule.id,
        rule.sentence,
        claim.chosen,
        claim.probability,
        claim.p_value,
        claim.closed_fraction,
        claim.parameters,
    )


def _unrefuted(effect: str, limitations: tuple[Finding, ...], comparison: ModelComparison) -> tuple[Finding, ...]:
    """Return the limitations that may stand for an effect: all, or none where the runs without them show it as well.

    An effect that a limitation imitates does not close the gap of the runs that have none.
    """
    if not limitations:
        return ()
    limited = {finding.run for finding in limitations}
    recordings = comparison.weighting.recordings
    clean = [run for run, recording in enumerate(recordings) if recording.run.name not in limited]
    if "" in limited or not clean:
        return limitations
    position = comparison.effects.index(effect)
    without = _with_only(comparison, [other for other in comparison.effects if other != effect]).best
    folds = [place for place, (run, _) in enumerate(comparison.weighting.folds) if run in clean]
    noise = np.concatenate([of_run.sigma for of_run in comparison.weighting.noise]) ** 2
    left = without.held_out_squares[folds].sum() - sum(noise[comparison.weighting.folds[place][1]].sum() for place in folds)
    gained = (without.held_out_squares - comparison.best.held_out_squares)[folds].sum()
    needed = THRESHOLDS.least_share_next if position else THRESHOLDS.least_share_first
    return () if left > 0.0 and gained > needed * left else limitations


def _with_only(comparison: ModelComparison, effects: Sequence[str]) -> ModelComparison:
    """Refit the model with some of the chosen effects."""
    alternatives = {effect: others for effect, others in comparison.alternatives.items() if effect in effects}
    return with_chain(comparison, effects, comparison.best.values, alternatives)
