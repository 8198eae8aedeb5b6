"""Judgement: the honesty rules applied to what would be named, and what remains to be said then."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.explanation import Explanation, name_causes, whatever_the_form
from mrd_diagnosis.decision.honesty import SEEN, Claim, Rule, clock_finding, imitating_limitations, rejecting_rule
from mrd_diagnosis.diagnosis import AlternativeModel, Candidate, Cause, Finding, Rejected
from mrd_diagnosis.search.model_comparison import Compared, ModelComparison, as_it_is, with_effects
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_runs import Run


@dataclass(frozen=True)
class Judgement:
    """What may be said after the honesty rules.

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
    faults : tuple of Finding
        Limitations of the recordings that are the answer instead of a cause; empty where there are none.
    """

    explanation: Explanation
    complete: ModelComparison
    causes: tuple[Cause, ...]
    rejected: tuple[Rejected, ...] = ()
    faults: tuple[Finding, ...] = ()


def judge(
    explanation: Explanation,
    complete: ModelComparison,
    findings: Sequence[Finding],
    runs: Sequence[Run],
    rng: np.random.Generator,
    asked: Compared = as_it_is,
) -> Judgement:
    """Apply the honesty rules to the effects that an explanation would name.

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
    asked : callable
        See `mrd_diagnosis.gap.explain_gap`.
    """
    causes = name_causes(replace(explanation, comparison=complete), rng)
    closed = closed_fraction_between(complete.base, complete.best, complete, rng).value
    open_fraction = float(np.clip(1.0 - np.nan_to_num(closed), 0.0, 1.0))
    of_clocks = clock_finding(runs)
    named, rejected = [], []
    faults: list[Finding] = []
    for cause in causes:
        limitations = _unrefuted(cause.effect, imitating_limitations(cause.effect, findings), complete)
        claim = Claim(
            cause.effect,
            cause.parameters,
            cause.probability,
            cause.p_value,
            cause.closed_fraction,
            open_fraction,
            limitations=limitations,
            clocks_agree=of_clocks is None,
            level=cause.level,
        )
        if rule := rejecting_rule(claim):
            rejected.append(_rejected(claim, rule))
            faults += limitations if rule.id == "limitation" else [of_clocks] if rule.id == "clocks" and of_clocks else []
        else:
            named.append(cause)
    if not rejected:
        return Judgement(explanation, complete, tuple(whatever_the_form(cause, explanation) for cause in causes))
    if named:
        effects = [cause.effect for cause in named]
        explanation = replace(
            explanation,
            verdict="partly_explained",
            comparison=_with_only(explanation.comparison, effects),
            probabilities={effect: explanation.probabilities[effect] for effect in effects},
        )
        complete = asked(_with_only(complete, effects))
        causes = name_causes(replace(explanation, comparison=complete), rng)
        causes = tuple(whatever_the_form(cause, explanation) for cause in causes)
        return Judgement(explanation, complete, causes, tuple(rejected))
    seen = explanation.verdict in ("explained", "ambiguous") and all(entry.rule in SEEN for entry in rejected)
    explanation = replace(explanation, verdict="ambiguous" if seen else "unknown_effect")
    return Judgement(explanation, complete, (), tuple(rejected), tuple(dict.fromkeys(faults)))


def reject_others(
    judgement: Judgement,
    candidates: Sequence[Candidate],
    models: Sequence[AlternativeModel],
    findings: Sequence[Finding],
    runs: Sequence[Run],
) -> tuple[Rejected, ...]:
    """Return every effect that was tried and is not named, with the rule that rejected it; first those that were chosen."""
    known = {cause.effect for cause in judgement.causes} | {entry.effect for entry in judgement.rejected}
    presence = {entry.effect: entry.probability for entry in judgement.explanation.weighed}
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
            has_gap=judgement.explanation.verdict != "no_gap",
            limitations=imitating_limitations(effect, findings),
            clocks_agree=clock_finding(runs) is None,
            other_model=models[0].closed_fraction.value if models else float("nan"),
            presence=presence.get(effect, 1.0),
        )
        if rule := rejecting_rule(claim):
            others.append(_rejected(claim, rule))
    return (*judgement.rejected, *others)


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
    values = comparison.best.values
    chain = [
        with_effects(comparison.weighting, comparison.base, effects[: count + 1], values) for count in range(len(effects))
    ]
    alternatives = {effect: others for effect, others in comparison.alternatives.items() if effect in effects}
    return replace(comparison, chain=tuple(chain), effects=tuple(effects), alternatives=alternatives)
