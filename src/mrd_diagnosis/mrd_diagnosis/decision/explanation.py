"""Explanations of a gap: the effects that explain it, with what is known of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mrd_diagnosis.decision.verdict import Probabilities
from mrd_diagnosis.diagnosis import Interval, Member, ParameterEstimate, Verdict, WeighedEffect
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import model_probabilities
from mrd_diagnosis.search.effect_search import EffectFit, tolerated_excess
from mrd_diagnosis.search.model_comparison import ModelComparison

LEAST_EXCESS = 1e-9
"""Excess of the reduced chi-square that nothing tells from none, so that the quotient is finite."""


@dataclass(frozen=True)
class RobustCause:
    """An effect that explains a part of the gap whatever the form of the damper.

    Attributes
    ----------
    probabilities : mapping
        Probability of every alternative to it, itself included, by name.
    p_value : float
        Probability of its improvement in noise alone.
    closed_fraction : Interval
        Share of the gap that it closes beside the others.
    members : tuple of Member
        The class of effects to which it belongs.
    parameters_by_form : tuple of mapping
        Its parameters with intervals, around each of several damper models.
    """

    probabilities: Mapping[str, float]
    p_value: float
    closed_fraction: Interval
    members: tuple[Member, ...]
    parameters_by_form: tuple[Mapping[str, ParameterEstimate], ...] = ()


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
    form_fraction : float
        Share of the gap that a freer form of the damper would close beside the effects; nan where that was not fitted.
    robust : mapping
        What is known of each of them that was judged around other forms.
    weighed : tuple of WeighedEffect
        All effects whose evidence was weighed beside other forms, named or not.
    """

    verdict: Verdict
    comparison: ModelComparison
    probabilities: Probabilities
    p_values: Mapping[str, float]
    form_fraction: float = float("nan")
    robust: Mapping[str, RobustCause] = field(default_factory=dict)
    weighed: tuple[WeighedEffect, ...] = ()


@dataclass(frozen=True)
class FittedExplanation:
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
    explained = min(1.0, tolerated_excess(comparison.base) / max(excess, LEAST_EXCESS))
    return {
        effect: dict(zip(others, explained * model_probabilities(list(others.values()), rng, list(others)), strict=True))
        for effect, others in comparison.alternatives.items()
    }
