"""Candidates: everything that was tried, with what it achieves, and what may stand in the place of a cause."""

from collections.abc import Mapping, Sequence

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.verdict import Probabilities
from mrd_diagnosis.diagnosis import Alternative, AlternativeModel, Candidate, UntestableEffect
from mrd_diagnosis.evidence.detectability import clause_of_size, detectable_sizes
from mrd_diagnosis.fitting.base_fit import LinearisedRefit
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_diagnosis.search.effect_search import EffectFit, detection_threshold
from mrd_diagnosis.search.model_comparison import NO_EFFECT, ModelComparison
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import parameters_of_effect
from mrd_identification.parallel import in_threads
from mrd_sim.effects import find_effects


def list_alternatives(comparison: ModelComparison, probabilities: Probabilities) -> tuple[Alternative, ...]:
    """Return the explanations that are likely enough to be listed beside a cause.

    One that was not refitted in its place has no parameters. What is a cause itself, beside this one, is no alternative.
    """
    return tuple(
        Alternative(
            other,
            effect,
            float(probability),
            "it may be the cause instead",
            parameters_of_effect(other, effect_parameters(refits[other])) if other in refits else {},
        )
        for effect, probabilities_of_others in probabilities.items()
        for refits in [comparison.alternatives[effect]]
        for other, probability in sorted(probabilities_of_others.items(), key=lambda item: -item[1])
        if other not in (NO_EFFECT, *comparison.effects) and probability >= THRESHOLDS.listed_probability
    )


def list_candidates(
    comparison: ModelComparison,
    singles: Sequence[EffectFit],
    null_gains: NullGains,
    probabilities: Probabilities,
    rng: np.random.Generator,
) -> tuple[tuple[Candidate, ...], tuple[UntestableEffect, ...]]:
    """Return every effect that was tried by itself and the chosen ones together, best first; and those that cannot be
    tested.
    """
    variance = _force_variance(comparison)
    ranked = sorted(singles, key=lambda fit: fit.refit.held_out_cost)
    # The effects by themselves have the weighting of the search.
    noise_cost = ranked[0].refit.problem.noise_cost if ranked else 0.0
    needed = max(THRESHOLDS.least_gain * noise_cost, float(np.quantile(null_gains.gains, 1.0 - THRESHOLDS.p_value)))
    lead_gain = ranked[0].held_out_gain if ranked else 0.0
    only = comparison.effects[0] if len(comparison.effects) == 1 else None
    probabilities_of_lead = probabilities[only] if only else {}
    in_place_of_lead = comparison.alternatives[only] if only else {}
    detectable = _detectable(comparison, [fit.effects[0] for fit in ranked if fit.effects[0] not in comparison.effects])
    refits = [in_place_of_lead.get(fit.effects[0], fit.refit) for fit in ranked]
    candidates, untestable = [], []
    for fit, refit, parameters in zip(ranked, refits, in_threads(effect_parameters, refits), strict=True):
        effect = fit.effects[0]
        smallest, remark = detectable.get(effect, ("", ""))
        closed = closed_fraction_between(comparison.base, refit, comparison, rng)
        if remark and fit.gain < needed:
            untestable.append(UntestableEffect(effect, remark))
            continue
        indistinguishable = (
            fit is not ranked[0] and lead_gain > needed and fit.held_out_gain >= THRESHOLDS.indistinguishable * lead_gain
        )
        candidates.append(
            Candidate(
                fit.effects,
                _nrmse(refit, variance),
                closed,
                null_gains.p_value(fit.gain, fit.refit.problem),
                float(probabilities[effect][effect] if effect in probabilities else probabilities_of_lead.get(effect, 0.0)),
                parameters,
                ranked[0].effects if indistinguishable else (),
                smallest_detectable=smallest,
            )
        )
    if len(comparison.effects) > 1:
        candidates.insert(0, _chosen_together(comparison, candidates, variance, probabilities, rng))
    return tuple(candidates), tuple(untestable)


def _detectable(comparison: ModelComparison, effects: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return each effect with its smallest detectable size as a clause, and why it cannot be tested; each empty where it
    does not apply.
    """
    weighting, best = comparison.weighting, comparison.best
    threshold = detection_threshold(weighting, comparison.base, best)
    described = {}
    for detectability in detectable_sizes(weighting, LinearisedRefit.around(weighting, best), effects, threshold):
        effect, smallest = detectability.effect, ""
        if np.isfinite(detectability.smallest_size):
            (scaled,) = find_effects([effect], best.problem.model.scales)
            smallest = clause_of_size(scaled, detectability.smallest_size)
        described[effect] = smallest, detectability.remark
    return described


def _chosen_together(
    comparison: ModelComparison,
    candidates: Sequence[Candidate],
    variance: float,
    probabilities: Probabilities,
    rng: np.random.Generator,
) -> Candidate:
    """Return the chosen effects together as one candidate."""
    effects = comparison.effects
    return Candidate(
        effects,
        _nrmse(comparison.best, variance),
        closed_fraction_between(comparison.base, comparison.best, comparison, rng),
        min(candidate.p_value for candidate in candidates if candidate.effects[0] in effects),
        float(np.prod([probabilities[effect][effect] for effect in effects])),
        effect_parameters(comparison.best),
    )


def list_alternative_models(
    comparison: ModelComparison, refits: Mapping[str, Refit], rng: np.random.Generator
) -> tuple[AlternativeModel, ...]:
    """Return other damper models in place of effects, best first."""
    variance, base = _force_variance(comparison), comparison.base.problem.model
    ranked = sorted(refits.items(), key=lambda item: item[1].held_out_cost)
    return tuple(
        AlternativeModel(
            name,
            _nrmse(refit, variance),
            closed_fraction_between(comparison.base, refit, comparison, rng),
            model.id,
            next((law for name, law in model.laws.items() if model.id == base.id and law != base.laws[name]), ""),
            tuple(p.name for index, p in enumerate(model.parameters) if index in refit.problem.free and not p.free),
        )
        for name, refit in ranked
        for model in [refit.problem.model]
    )


def _force_variance(comparison: ModelComparison) -> float:
    return float(np.var(np.concatenate([recording.force for recording in comparison.weighting.recordings])))


def _nrmse(refit: Refit, variance: float) -> float:
    return float(np.sqrt(refit.held_out_squares.sum() / len(refit.problem.force) / variance))
