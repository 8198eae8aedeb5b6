"""Explanation: causes, candidates and alternatives, with their probabilities, from a model comparison."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.decision import Probabilities
from mrd_diagnosis.decision.presence import plausible_set
from mrd_diagnosis.diagnosis import (
    Advice,
    Alternative,
    AlternativeModel,
    Candidate,
    Cause,
    Interval,
    Member,
    ParameterEstimate,
    UntestableEffect,
    Verdict,
    WeighedEffect,
)
from mrd_diagnosis.evidence.cause_class import class_of, level_of
from mrd_diagnosis.evidence.detectability import clause_of_size, detectable_sizes
from mrd_diagnosis.experiment_design.advice import advise
from mrd_diagnosis.fitting.base_fit import BaseFit
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import effect_parameters, probabilities
from mrd_diagnosis.search.effect_search import EffectFit, detection_threshold, tolerated_excess
from mrd_diagnosis.search.model_comparison import NO_EFFECT, ModelComparison, refit_in_its_place, refit_without
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import parameters_of_effect
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS
from mrd_trajectory.settings import GeneratorSettings

Array = NDArray[np.float64]

MOST_EXPLANATIONS_TO_SEPARATE = 4
"""Explanations that the next experiment is designed to separate."""


@dataclass(frozen=True)
class Explanation:
    """What explains the gap.

    Attributes
    ----------
    verdict : Verdict
    comparison : ModelComparison
        Of the effects that explain the gap or come nearest.
    probabilities : mapping
        For each of these effects, the probability of every alternative to it, itself included, by name.
    p_values : mapping
        For each of them, the probability of its improvement in noise alone.
    closed_fractions : mapping
        Shares of the gap of effects that were judged around other forms of the damper.
    form_fraction : float
        Share of the gap that a freer form of the damper would close beside the effects; nan where that was not asked.
    classes : mapping
        Class of each effect that was judged around other forms; see `mrd_diagnosis.evidence.cause_class.class_of`.
    weighed : tuple of WeighedEffect
        All effects whose evidence was weighed beside other forms, named or not.
    sizes : mapping
        For effects that were judged beside other forms, their parameters with intervals around each of these.
    """

    verdict: Verdict
    comparison: ModelComparison
    probabilities: Probabilities
    p_values: Mapping[str, float]
    closed_fractions: Mapping[str, Interval] = field(default_factory=dict)
    form_fraction: float = float("nan")
    classes: Mapping[str, tuple[Member, ...]] = field(default_factory=dict)
    weighed: tuple[WeighedEffect, ...] = ()
    sizes: Mapping[str, Sequence[Mapping[str, ParameterEstimate]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Explained:
    """An explanation with all that was fitted for it.

    Attributes
    ----------
    explanation : Explanation
    complete : ModelComparison
        Its comparison on all samples.
    singles : sequence of EffectFit
        Each effect by itself.
    null_gains : NullGains
        What noise alone gives.
    other_models : mapping
        Other damper models without effects by name; empty where none was tried.
    """

    explanation: Explanation
    complete: ModelComparison
    singles: Sequence[EffectFit]
    null_gains: NullGains
    other_models: Mapping[str, Refit] = field(default_factory=dict)


def probabilities_of_alternatives(comparison: ModelComparison, rng: np.random.Generator) -> Probabilities:
    """Return the probability of every alternative to each cause.

    The excess of the best model beyond what an explained gap may leave belongs to something else, so that the probabilities
    sum to less than one there.
    """
    excess = comparison.best.chi_square - 1.0
    explained = min(1.0, tolerated_excess(comparison.base) / max(excess, 1e-9))
    return {
        effect: dict(zip(others, explained * probabilities(list(others.values()), rng), strict=True))
        for effect, others in comparison.alternatives.items()
    }


def name_causes(explanation: Explanation, rng: np.random.Generator) -> tuple[Cause, ...]:
    """Return the effects of an explanation as causes; first the one that is likely to close most.

    Each has its share of the gap from ``closed_fractions``, or else the one that it adds to those before it.
    """
    if explanation.verdict in ("no_gap", "unknown_effect"):
        return ()
    comparison, chances = explanation.comparison, explanation.probabilities
    steps = [comparison.base, *comparison.chain]
    parameters = effect_parameters(comparison.best)
    causes = []
    for index, effect in enumerate(comparison.effects):
        members = explanation.classes.get(effect) or class_of(effect, comparison.alternatives[effect], chances[effect])
        causes.append(
            Cause(
                effect,
                float(chances[effect][effect]),
                explanation.p_values[effect],
                explanation.closed_fractions.get(effect)
                or closed_fraction_between(steps[index], steps[index + 1], comparison, rng),
                {name: value for name, value in parameters.items() if name.startswith(f"{effect}.")},
                level_of(effect, members, chances[effect]),
                members,
                plausible_set({name: chance for name, chance in chances[effect].items() if name in EFFECTS}),
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.probability * float(np.nan_to_num(cause.closed_fraction.value))))


def whatever_the_form(cause: Cause, explanation: Explanation) -> Cause:
    """Return a cause with intervals of its parameters that hold those around other forms as well: nobody knows the right
    form of the damper.
    """
    fits = explanation.sizes.get(cause.effect, ())
    parameters = {
        name: replace(estimate, value=_around([estimate.value, *(fit[name].value for fit in fits if name in fit)]))
        for name, estimate in cause.parameters.items()
    }
    return replace(cause, parameters=parameters)


def _around(intervals: Sequence[Interval]) -> Interval:
    """Return the first of intervals, as wide as all together; as it is where one of them has no ends."""
    lower, upper = (float(end) for end in (min(i.lower for i in intervals), max(i.upper for i in intervals)))
    finite = all(np.isfinite([interval.lower, interval.upper]).all() for interval in intervals)
    return Interval(intervals[0].value, lower, upper) if finite else intervals[0]


def list_alternatives(comparison: ModelComparison, chances: Probabilities) -> tuple[Alternative, ...]:
    """Return the explanations that are likely enough to be listed beside a cause.

    One that was not refitted in its place has no parameters. What is a cause itself, beside this one, is no alternative.
    """
    return tuple(
        Alternative(
            other,
            effect,
            float(chance),
            "predicts held-out data nearly as well",
            parameters_of_effect(other, effect_parameters(refits[other])) if other in refits else {},
        )
        for effect, chances_of_others in chances.items()
        for refits in [comparison.alternatives[effect]]
        for other, chance in sorted(chances_of_others.items(), key=lambda item: -item[1])
        if other not in (NO_EFFECT, *comparison.effects) and chance >= THRESHOLDS.listed_probability
    )


def list_candidates(
    comparison: ModelComparison,
    singles: Sequence[EffectFit],
    null_gains: NullGains,
    chances: Probabilities,
    rng: np.random.Generator,
) -> tuple[tuple[Candidate, ...], tuple[UntestableEffect, ...]]:
    """Return every effect that was tried by itself and the chosen ones together, best first; and those that cannot be
    tested.
    """
    variance = _force_variance(comparison)
    ranked = sorted(singles, key=lambda fit: fit.refit.held_out_cost)
    needed = max(
        THRESHOLDS.least_gain * comparison.weighting.samples, float(np.quantile(null_gains.gains, 1.0 - THRESHOLDS.p_value))
    )
    lead_gain = ranked[0].held_out_gain if ranked else 0.0
    only = comparison.effects[0] if len(comparison.effects) == 1 else None
    chances_of_lead = chances[only] if only else {}
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
                float(chances[effect][effect] if effect in chances else chances_of_lead.get(effect, 0.0)),
                parameters,
                ranked[0].effects if indistinguishable else (),
                smallest_detectable=smallest,
            )
        )
    if len(comparison.effects) > 1:
        candidates.insert(0, _chosen_together(comparison, candidates, variance, chances, rng))
    return tuple(candidates), tuple(untestable)


def _detectable(comparison: ModelComparison, effects: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return each effect with its smallest detectable size as a clause, and why it cannot be tested; each empty where it
    does not apply.
    """
    weighting, best = comparison.weighting, comparison.best
    threshold = detection_threshold(weighting, comparison.base, best)
    described = {}
    for detectability in detectable_sizes(weighting, BaseFit.linearise(weighting, best), effects, threshold):
        effect, smallest = detectability.effect, ""
        if np.isfinite(detectability.smallest_size):
            smallest = clause_of_size(EFFECTS[effect], detectability.smallest_size)
        described[effect] = smallest, detectability.remark
    return described


def _chosen_together(
    comparison: ModelComparison,
    candidates: Sequence[Candidate],
    variance: float,
    chances: Probabilities,
    rng: np.random.Generator,
) -> Candidate:
    """Return the chosen effects together as one candidate."""
    effects = comparison.effects
    return Candidate(
        effects,
        _nrmse(comparison.best, variance),
        closed_fraction_between(comparison.base, comparison.best, comparison, rng),
        min(candidate.p_value for candidate in candidates if candidate.effects[0] in effects),
        float(np.prod([chances[effect][effect] for effect in effects])),
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


def advise_next(
    explanation: Explanation,
    rejected: Mapping[str, bool],
    singles: Sequence[EffectFit],
    rng: np.random.Generator,
    bench: GeneratorSettings | None = None,
) -> Advice | None:
    """Advise what to record to tell explanations apart that are open.

    These are the least certain effect and the alternatives to it, or, where no effect was chosen, the ``singles`` that
    predict best. No advised experiment exceeds the limits of ``bench`` (default: the shipped bench).

    Parameters
    ----------
    explanation : Explanation
        Before the honesty rules.
    rejected : mapping
        For each effect that the honesty rules rejected, whether it may be there all the same, seen but not determined.
    singles : sequence of EffectFit
        Each effect by itself.
    rng : numpy Generator
    bench : GeneratorSettings, optional

    Returns
    -------
    Advice or None
        None where all effects are certain.
    """
    comparison, chances = explanation.comparison, explanation.probabilities
    asked = [effect for effect in comparison.effects if rejected.get(effect, True)]
    uncertain = [e for e in asked if e in rejected or chances[e][e] < THRESHOLDS.named_probability]
    if uncertain:
        effect = min(uncertain, key=lambda name: chances[name][name])
        known, likely = comparison.alternatives[effect], dict(chances[effect])
        without = known.get(NO_EFFECT) or refit_without(comparison.weighting, comparison.best, effect)
        names = _open_explanations(likely)
        if effect in rejected:
            # Its size may be the one at which it is absent.
            names, likely[NO_EFFECT] = [*names, NO_EFFECT], max(likely.values())
    elif asked or not singles:
        return None
    else:
        ranked = sorted(singles, key=lambda fit: fit.refit.held_out_cost)[:MOST_EXPLANATIONS_TO_SEPARATE]
        without, known = comparison.base, {fit.effects[0]: fit.refit for fit in ranked}
        shares = probabilities([ranked[0].refit, without, *(fit.refit for fit in ranked[1:])], rng)
        likely = dict(zip([ranked[0].effects[0], NO_EFFECT, *(fit.effects[0] for fit in ranked[1:])], shares, strict=True))
        names = _open_explanations(likely)
    missing = [name for name in names if name in EFFECTS and name not in known]
    refits = {**known, NO_EFFECT: without}
    if missing:
        refits |= refit_in_its_place(comparison.weighting, without, missing)
    names = [name for name in dict.fromkeys(names) if name in refits]
    return advise(
        {name: refits[name] for name in names},
        comparison.weighting,
        chances={name: float(likely.get(name, 0.0)) for name in names},
        without=without,
        bench=bench,
    )


def _open_explanations(chances: Mapping[str, float]) -> list[str]:
    """Return the names of the explanations to separate, by their probabilities; at least one beside the likeliest.

    An experiment that rules out what is unlikely anyway leaves the question open.
    """
    ranked = sorted((name for name in chances if name), key=lambda name: -chances[name])[:MOST_EXPLANATIONS_TO_SEPARATE]
    names = [name for name in ranked if name in ranked[:2] or chances[name] >= THRESHOLDS.listed_probability]
    return names if len(names) > 1 else [*names, NO_EFFECT]


def _force_variance(comparison: ModelComparison) -> float:
    return float(np.var(np.concatenate([recording.force for recording in comparison.weighting.recordings])))


def _nrmse(refit: Refit, variance: float) -> float:
    return float(np.sqrt(refit.held_out_squares.sum() / len(refit.problem.force) / variance))
