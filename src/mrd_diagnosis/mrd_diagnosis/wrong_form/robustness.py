"""Robustness: the tests that an effect must pass to be named although the form of the damper model may be wrong."""

from collections.abc import Mapping, Sequence

import numpy as np

from mrd_diagnosis.diagnosis import Member
from mrd_diagnosis.fitting.refit import Refit, costs_of_halves
from mrd_diagnosis.fitting.statistics import model_probabilities
from mrd_diagnosis.search.model_comparison import NO_EFFECT
from mrd_diagnosis.thresholds import THRESHOLDS


def is_robust(probability: float, without: Refit, with_effect: Refit) -> bool:
    """Whether an effect can be named beside a wrong form: it is more likely than not, and not one fold alone speaks for it.

    Without the second, an effect was named whose share in the gap was 100 %, between -4 and 100: without it, the model
    diverged in one of the folds.
    """
    gains = without.held_out_squares - with_effect.held_out_squares
    return bool(probability >= THRESHOLDS.least_probability and gains.sum() > max(gains.max(), 0.0))


def probabilities_in_place(refits: Mapping[str, Refit], support: float, rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each effect among refits in one place; with that of no effect, they sum to ``support``."""
    shares = map(float, model_probabilities(list(refits.values()), rng, list(refits)))
    return {name: support * share for name, share in zip(refits, shares, strict=True) if name != NO_EFFECT}


def leads(effect: str, probabilities: Mapping[str, float], members: Sequence[Member]) -> bool:
    """Whether an effect is the most probable one in its place, and it or its class likelier than all others together."""
    of_class = sum(member.probability for member in members)
    likely = of_class >= THRESHOLDS.least_probability * sum(probabilities.values())
    return max(probabilities, key=probabilities.__getitem__) == effect and likely


def predicts_both_halves(without: Refit, with_effect: Refit) -> bool:
    """Whether an effect lowers the error of either half of the folds with parameters fitted to the other half."""
    return bool((costs_of_halves(with_effect) < costs_of_halves(without)).all())
