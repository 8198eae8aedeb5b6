"""What a cause must hold against to be named although the damper model may be wrong."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.base_fit import with_effect
from mrd_diagnosis.diagnosis import Interval, Member
from mrd_diagnosis.limitations import contains
from mrd_diagnosis.model_comparison import NO_EFFECT
from mrd_diagnosis.refit import Refit, held_out_errors, refit, without_each
from mrd_diagnosis.statistics import probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldCause:
    """An effect that holds whatever the form of the damper.

    Attributes
    ----------
    probabilities : dict
        Probability of every alternative to it, itself included, by name.
    p_value : float
        Probability of its improvement in noise alone.
    closed_fraction : Interval
        Share of the gap that it closes beside the others and a freer form of the damper.
    members : tuple of Member
        The class of effects to which it belongs.
    """

    probabilities: dict[str, float]
    p_value: float
    closed_fraction: Interval
    members: tuple[Member, ...]


def holds(probability: float, without: Refit, with_effect: Refit) -> bool:
    """Whether an effect can be named beside a wrong form: it is more likely than not, and not one fold alone speaks for it.

    Without the second, an effect was named whose share in the gap was 100 %, between -4 and 100: without it, the model
    diverged in one of the folds.
    """
    gains = without.held_out_squares - with_effect.held_out_squares
    return bool(probability >= THRESHOLDS.named_support and gains.sum() > max(gains.max(), 0.0))


def probabilities_in_place(refits: Mapping[str, Refit], support: float, rng: np.random.Generator) -> dict[str, float]:
    """Return the probability of each effect among refits in one place; with that of no effect, they sum to ``support``."""
    shares = map(float, probabilities(list(refits.values()), rng))
    return {name: support * share for name, share in zip(refits, shares, strict=True) if name != NO_EFFECT}


def leads(effect: str, chances: Mapping[str, float], members: Sequence[Member]) -> bool:
    """Whether an effect is the most probable one in its place, and it or its class likelier than all others together."""
    of_class = sum(member.probability for member in members)
    likely = of_class >= THRESHOLDS.named_support * sum(chances.values())
    return max(chances, key=chances.__getitem__) == effect and likely


def holds_in_halves(without: Refit, with_effect: Refit) -> bool:
    """Whether an effect lowers the error of either half of the folds with parameters fitted to the other half."""
    return bool((_cost_of_halves(with_effect) < _cost_of_halves(without)).all())


def with_effects(weighting: Weighting, refitted: Refit, effects: Sequence[str], values: Mapping[str, float]) -> Refit:
    """Refit a model with those effects that it does not contain; parameters of effects start from ``values`` where known."""
    model, theta = refitted.problem.model, refitted.theta
    for effect in effects:
        if not contains(refitted.problem.model, effect):
            model, theta = with_effect(model, theta, effect)
    theta = np.array([values.get(n, v) if "." in n else v for n, v in zip(model.names, theta, strict=True)])
    return refit(weighting.problem(model, theta), theta, weighting.folds)


def _cost_of_halves(refitted: Refit) -> Array:
    """Return the sum of squared white residuals (2,) of every second fold, predicted from the others."""
    problem, folds = refitted.problem, refitted.folds
    halves = [np.arange(first, len(folds), 2) for first in (0, 1)]
    matrices = np.stack([refitted.normal_matrices[half].sum(axis=0) for half in halves])
    gradients = np.stack([refitted.gradients[half].sum(axis=0) for half in halves])
    thetas, coefficients = without_each(problem, problem.unit(refitted.theta), refitted.coefficients, matrices, gradients)
    costs = []
    for half, theta, of_remainder in zip(halves, thetas, coefficients, strict=True):
        pieces = [folds[index] for index in half]
        shape = (len(pieces), 1)
        white, _, _ = held_out_errors(problem, np.tile(theta, shape), np.tile(of_remainder, shape), pieces)
        costs.append(float(white.sum()))
    return np.array(costs)
