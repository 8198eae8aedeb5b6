"""What refits allow to be said: probabilities, intervals, how far the gap closes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, softmax, stdtrit

from mrd_diagnosis.diagnosis import Interval, Value
from mrd_diagnosis.refit import Refit, scaled_inverse
from mrd_identification.least_squares import BOUND_TOLERANCE
from mrd_identification.residual_correlation import correlation_length

Array = NDArray[np.float64]

RESAMPLES = 400

FORM = 0.02
"""Share of a gap that the right effect may leave, more than another one, because its form is a little off."""


CERTAIN = 0.8
"""Probability from which an effect is named without an alternative."""


def certainty(ahead: float, gap: float) -> float:
    """Probability of what leaves less squared white error than another explanation, by `FORM` of the gap alone.

    Parameters
    ----------
    ahead : float
        By how much less.
    gap : float
        What both explain.
    """
    return float(expit(ahead / (FORM * max(gap, np.finfo(float).tiny))))


def probabilities(rivals: Sequence[Refit], rng: np.random.Generator) -> Array:
    """Probability (rivals,) that each of some refits is the one that predicts unseen parts best.

    The likelihood of the unseen white error, tempered by its correlation in time and by the level that even the best rival
    leaves, averaged over a Bayesian bootstrap of the parts (Rubin, 1981): what rests on few parts is not certain. And by
    `FORM`: a rival that is behind by less may be the cause in a form that is not quite the catalogue's.
    """
    unseen = np.stack([rival.unseen for rival in rivals])
    totals = unseen.sum(axis=1)
    best = rivals[int(np.argmin(totals))]
    temperature = max(dispersion(best.problem.residuals(best.theta)), 0.5 * FORM * float(totals.max() - totals.min()))
    weights = rng.dirichlet(np.ones(unseen.shape[1]), RESAMPLES) * unseen.shape[1]
    return np.asarray(softmax(-0.5 * weights @ unseen.T / temperature, axis=1).mean(axis=0))


def dispersion(white: Array) -> float:
    """By how much white errors (n,) count less than as many independent ones of variance one."""
    return max(1.0, float(np.mean(white**2))) * correlation_length(white)


def values(refit: Refit) -> dict[str, Value]:
    """Parameters of a refit's effects with intervals and remarks, by EFFECT.PARAMETER.

    What is never searched is among them where it is not as usual.

    The covariance is the larger of what the scatter of the parts says (sandwich; Liang & Zeger, 1986) and of what the
    correlated noise does. A recording does not say whether a sample of the force is its mean over the sampling period or of
    an instant, and a play is crossed in less: intervals of what follows the force hold both.
    """
    problem, unit = refit.problem, refit.problem.unit(refit.theta)
    inverse = scaled_inverse(refit.grams.sum(axis=0), 1e-12)
    spare = len(refit.slopes) - len(unit)
    deviation = 1.96 * np.sqrt(dispersion(problem.residuals(refit.theta)) * np.diag(inverse))
    if spare > 4:
        root = inverse @ refit.slopes.T * np.sqrt(len(refit.slopes) / spare)
        deviation = np.maximum(deviation, stdtrit(spare, 0.975) * np.linalg.norm(root, axis=1))
    following = {effect.id for effect in problem.model.effects if effect.follows_force}
    if_means = -inverse @ refit.means
    found = {}
    for place, index in enumerate(problem.free):
        parameter = problem.model.parameters[index]
        effect, _, own = parameter.name.partition(".")
        if not own:
            continue
        shift = if_means[place] if effect in following else 0.0
        reach = np.array([min(shift, 0.0) - deviation[place], max(shift, 0.0) + deviation[place]])
        ends = np.clip(unit[place] + reach, 0.0, 1.0)
        moved = np.tile(unit, (2, 1))
        moved[:, place] = ends
        lower, upper = problem.theta(moved)[:, index]
        remark = ""
        if unit[place] < BOUND_TOLERANCE or unit[place] > 1 - BOUND_TOLERANCE:
            if refit.theta[index] != parameter.default:
                remark = "at the end of what is plausible"
        elif ends[0] == 0.0 and ends[1] == 1.0:
            remark = "not determined by these runs"
        interval = Interval(float(refit.theta[index]), float(lower), float(upper))
        found[parameter.name] = Value(interval, parameter.unit, remark)
    for parameter, value in zip(problem.model.parameters, refit.theta, strict=True):
        if "." in parameter.name and not parameter.free and value != parameter.default:
            found[parameter.name] = Value(Interval(float(value)), parameter.unit)
    return found


def resampled(units: int, rng: np.random.Generator) -> Array:
    """How often (RESAMPLES, units) each unit is drawn in a bootstrap."""
    return rng.multinomial(units, np.full(units, 1 / units), RESAMPLES).astype(float)


def nrmse(squares: Array, samples: Array, variance: float, draws: Array) -> Interval:
    """Root mean square over the force's standard deviation, from squared errors in N² (units,) of so many samples."""
    value = np.sqrt(squares.sum() / samples.sum() / variance)
    found = np.sqrt((draws @ squares) / (draws @ samples) / variance)
    return Interval(float(value), *map(float, np.quantile(found, (0.025, 0.975))))


def closed(before: Array, after: Array, floor: Array, draws: Array) -> Interval:
    """Share of the explainable gap that is closed, from squared errors in N² (units,) before, after and of the floor."""

    def share(b: Array, a: Array, f: Array) -> Array:
        gap = b - f
        return np.asarray(np.where(gap > 0, np.clip((b - a) / np.where(gap > 0, gap, 1.0), -1.0, 1.0), np.nan))

    value = float(share(before.sum(keepdims=True), after.sum(keepdims=True), floor.sum(keepdims=True))[0])
    found = share(draws @ before, draws @ after, draws @ floor)
    if np.isnan(found).mean() > 0.1:
        return Interval(value)
    return Interval(value, *map(float, np.nanquantile(found, (0.025, 0.975))))
