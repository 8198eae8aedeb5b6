"""Conclusion: the rejection rules applied to what would be named, and what remains to be said then."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.causes import name_causes, with_intervals_of_all_forms
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.decision.rejection_rules import RULES, Claim, Rule, rejecting_rule
from mrd_diagnosis.decision.verdict import verdict_after_rejection
from mrd_diagnosis.diagnosis import AlternativeModel, Candidate, Cause, Finding, Interval, Rejected
from mrd_diagnosis.fitting.refit import Refit, refit_on
from mrd_diagnosis.recordings.imitating_limitations import imitating_limitations
from mrd_diagnosis.search.model_comparison import ModelComparison, RefitComparison, refit_without, unchanged, with_chain
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS

_WORSE = next(rule for rule in RULES if rule.id == "worse")


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
    of_clocks: Finding | None,
    rng: np.random.Generator,
    in_loop: RefitComparison = unchanged,
) -> Conclusion:
    """Hold the effects that an explanation would name against the rejection rules.

    Those that harm the prediction beside the others are left out first, and the rest is fitted anew. Where the rules leave
    none and the recordings are a reason for that, their limitation is the answer. Where they are seen but not determined,
    they stay in the model as what comes nearest, and the verdict is ambiguous if they close the gap. Where some causes
    remain, they explain a part of the gap.

    Parameters
    ----------
    explanation : Explanation
    complete : ModelComparison
        Of the explanation, on all samples.
    findings : sequence of Finding
        Of the preflight check.
    of_clocks : Finding or None
        That the clocks of the channels are not known to agree.
    rng : numpy Generator
    in_loop : callable
        See `mrd_diagnosis.explain_gap.explain_gap`.
    """
    explanation, complete = _led_by_likeliest(explanation, complete, in_loop)
    causes = name_causes(replace(explanation, comparison=complete), rng)
    harmful, beside = harmful_effects(complete, rng) if len(causes) > 1 else ((), {})
    rejected = [_rejected_as_worse(cause) for cause in causes if cause.effect in harmful]
    if harmful:
        kept = [effect for effect in complete.effects if effect not in harmful]
        explanation, complete, causes = _named_alone(explanation, complete, kept, rng, in_loop)
        beside = {}
    rules: list[Rule] = []
    reasons: list[Finding] = []
    whole = explanation, complete
    while causes:
        claims = _claims(causes, complete, beside, findings, of_clocks, rng)
        against = [rejecting_rule(claim) for claim in claims]
        for claim, rule in zip(claims, against, strict=True):
            if rule is None:
                continue
            rules.append(rule)
            rejected.append(_rejected(claim, rule))
            reasons += claim.limitations if rule.id == "limitation" else []
            reasons += [of_clocks] if rule.id == "clocks" and of_clocks else []
        kept = [claim.effect for claim, rule in zip(claims, against, strict=True) if rule is None]
        if len(kept) == len(causes):
            break
        # Without the others, what remains may have another size, or close less. Without any, all stay as what comes nearest.
        explanation, complete, causes = _named_alone(explanation, complete, kept, rng, in_loop) if kept else (*whole, ())
        beside = {}
    effects = [cause.effect for cause in causes]
    explanation = replace(explanation, verdict=verdict_after_rejection(explanation.verdict, effects, rules, reasons))
    causes = tuple(with_intervals_of_all_forms(cause, explanation) for cause in causes)
    return Conclusion(explanation, complete, causes, tuple(rejected), tuple(dict.fromkeys(reasons)))


def _led_by_likeliest(
    explanation: Explanation, complete: ModelComparison, in_loop: RefitComparison
) -> tuple[Explanation, ModelComparison]:
    """Return an explanation in which each effect is the likeliest one in its place. The search chose it with an earlier
    estimate of the noise.
    """
    if explanation.verdict in ("no_gap", "unknown_effect"):
        return explanation, complete
    comparison, probabilities = explanation.comparison, explanation.probabilities
    likeliest = {}
    for effect in comparison.effects:
        others = [name for name in comparison.alternatives[effect] if name in EFFECTS and name not in comparison.effects]
        if effect not in explanation.robust:
            likeliest[effect] = max([effect, *others], key=lambda name: probabilities[effect].get(name, 0.0))
    changed = {effect: name for effect, name in likeliest.items() if name != effect}
    if not changed:
        return explanation, complete
    values = comparison.best.values
    for effect, name in changed.items():
        values |= {
            key: value for key, value in comparison.alternatives[effect][name].values.items() if key.startswith(f"{name}.")
        }

    def led(compared: ModelComparison) -> ModelComparison:
        alternatives = {changed.get(effect, effect): others for effect, others in compared.alternatives.items()}
        effects = [changed.get(effect, effect) for effect in compared.effects]
        return replace(with_chain(compared, effects, values, alternatives), alternative_model=compared.alternative_model)

    is_complete = complete is comparison
    comparison = led(comparison)
    explanation = replace(
        explanation,
        comparison=comparison,
        probabilities={changed.get(effect, effect): others for effect, others in probabilities.items()},
        p_values={changed.get(effect, effect): p_value for effect, p_value in explanation.p_values.items()},
    )
    return explanation, comparison if is_complete else in_loop(led(complete))


def worse_by_runs(conclusion: Conclusion) -> Conclusion:
    """Reject all causes, since with them each run is predicted worse from the others than without.

    Segments of one run may say otherwise: an end stop that was moved between the runs is predicted well within each.
    """
    rejected = [_rejected_as_worse(cause) for cause in conclusion.causes]
    verdict = verdict_after_rejection(conclusion.explanation.verdict, [], [_WORSE] * len(rejected), conclusion.limitations)
    return replace(
        conclusion,
        explanation=replace(
            conclusion.explanation,
            verdict=verdict,
            comparison=conclusion.explanation.comparison.without_effects(),
            probabilities={},
        ),
        complete=conclusion.complete.without_effects(),
        causes=(),
        rejected=(*rejected, *conclusion.rejected),
    )


def harmful_effects(comparison: ModelComparison, rng: np.random.Generator) -> tuple[tuple[str, ...], dict[str, Interval]]:
    """Return the effects without which the user's model surely predicts held-out data better, beside the others; and the
    share of the gap that each effect closes beside the others, where none is harmful.

    An effect that was found around another form may be superfluous in the user's model, where the others have taken its
    part. The most harmful one is left out before the rest is judged again, so that of two that take each other's place one
    stays.
    """
    effects = list(comparison.effects)
    harmful: list[str] = []
    # The simulator is in the loop of none of these refits.
    best = refit_on(comparison.weighting, comparison.best)
    beside: dict[str, Interval] = {}
    while len(effects) > 1:
        without, closed = _beside_others(comparison, best, effects, rng)
        least = min(effects, key=lambda effect: closed[effect].upper)
        if not closed[least].upper < 0.0:
            beside = {} if harmful else closed
            break
        harmful.append(least)
        effects.remove(least)
        best = without[least]
    return tuple(harmful), beside


def _beside_others(
    comparison: ModelComparison, best: Refit, effects: Sequence[str], rng: np.random.Generator
) -> tuple[dict[str, Refit], dict[str, Interval]]:
    """Return a model without each of its effects, and the share of the gap that each closes beside the others."""
    refits = in_threads(partial(refit_without, comparison.weighting, best), effects)
    without = dict(zip(effects, refits, strict=True))
    return without, {
        effect: closed_fraction_between(without[effect], best, comparison, rng, widened=False) for effect in effects
    }


def _named_alone(
    explanation: Explanation,
    complete: ModelComparison,
    effects: Sequence[str],
    rng: np.random.Generator,
    in_loop: RefitComparison,
) -> tuple[Explanation, ModelComparison, tuple[Cause, ...]]:
    """Fit some of the effects of an explanation anew, without the others, and name them."""
    comparison = _with_only(explanation.comparison, effects)
    complete = in_loop(comparison if complete is explanation.comparison else _with_only(complete, effects))
    explanation = replace(
        explanation, comparison=comparison, probabilities={effect: explanation.probabilities[effect] for effect in effects}
    )
    return explanation, complete, name_causes(replace(explanation, comparison=complete), rng)


def _claims(
    causes: Sequence[Cause],
    complete: ModelComparison,
    beside: Mapping[str, Interval],
    findings: Sequence[Finding],
    of_clocks: Finding | None,
    rng: np.random.Generator,
) -> list[Claim]:
    """Return what is claimed of each cause, with what speaks against it; the shares that they close ``beside`` each other
    are computed where they are not known.
    """
    together = closed_fraction_between(complete.base, complete.best, complete, rng, widened=False)
    open_fraction = float(np.clip(1.0 - np.nan_to_num(together.value), 0.0, 1.0))
    if len(causes) == 1:
        beside = dict.fromkeys(complete.effects, together)
    elif not beside:
        best = refit_on(complete.weighting, complete.best)
        beside = _beside_others(complete, best, complete.effects, rng)[1]
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


def reject_others(
    conclusion: Conclusion,
    candidates: Sequence[Candidate],
    models: Sequence[AlternativeModel],
    findings: Sequence[Finding],
    of_clocks: Finding | None,
) -> tuple[Rejected, ...]:
    """Return every effect that was tried and is not named, by itself or in a class, with the rule that rejected it; first
    those that were chosen.
    """
    named = {member.effect for cause in conclusion.causes if cause.level != "effect" for member in cause.members}
    known = named | {cause.effect for cause in conclusion.causes} | {entry.effect for entry in conclusion.rejected}
    # Of the effects that came nearest without explaining enough, none is named, and nothing explains more.
    nearest = conclusion.explanation.comparison.effects if conclusion.explanation.verdict == "unknown_effect" else ()
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
            closed_beside=candidate.closed_fraction,
            chosen=False,
            comes_nearest=effect in nearest,
            has_gap=conclusion.explanation.verdict != "no_gap",
            limitations=imitating_limitations(effect, findings),
            clocks_agree=of_clocks is None,
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


def _rejected_as_worse(cause: Cause) -> Rejected:
    return _rejected(Claim(cause.effect, cause.parameters, cause.probability, cause.p_value, cause.closed_fraction), _WORSE)


def _unrefuted(effect: str, limitations: tuple[Finding, ...], comparison: ModelComparison) -> tuple[Finding, ...]:
    """Return the limitations that may stand for an effect: all, or none where the runs without them show it as well.

    An effect that a limitation imitates does not close the gap of the runs that have none.
    """
    if not limitations:
        return ()
    limited = {finding.run for finding in limitations}
    recordings = comparison.weighting.recordings
    # In the runs before a change, it does not act.
    acting = [(run, recording.run.name) for run, recording in enumerate(recordings) if not recording.without_effects]
    clean = [run for run, name in acting if name not in limited]
    if "" in limited or not clean:
        return limitations
    position = comparison.effects.index(effect)
    without = refit_without(comparison.weighting, comparison.best, effect)
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
