"""Statistics of refits: probabilities of explanations, intervals of parameters and errors."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import expit, softmax, stdtrit

from mrd_diagnosis.diagnosis import ON_BOUND, UNDETERMINED, Interval, ParameterEstimate
from mrd_diagnosis.fitting.refit import Refit, scaled_inverse
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification import resampling
from mrd_identification.least_squares import BOUND_TOLERANCE
from mrd_identification.residual_correlation import correlation_length
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

BOOTSTRAP_SAMPLES = 400
"""Samples of every bootstrap."""

MOST_HELD_OUT = 10.0
"""Ratio of the costs of a fold, held out and fitted, above which the fit without the fold diverged."""

LEAST_DEGREES = 5
"""Folds, beyond the parameters, from which their scatter tells how uncertain these are."""

MOST_WITHOUT_GAP = 0.1
"""Share of the bootstrap samples that may have no gap before the share of it has no interval."""

LEAST_GAP = 1e-12
"""White squares that nothing tells from none. Explanations that close nothing, or make the error larger, count as this, so
that all quotients are finite."""


def certainty(lead: float, gap: float) -> float:
    """Return the probability of an explanation that leads another one by ``lead``, when both explain ``gap`` (white
    squares).

    Its formula may be wrong by `Thresholds.formula_error` of the gap.
    """
    return float(expit(lead / (THRESHOLDS.formula_error * max(gap, LEAST_GAP))))


def tempering_of(dispersion: float, gap: float) -> float:
    """Return the factor by which a white squared distance counts less than noise says, when the explanations explain ``gap``
    (white squares) by formulas that may be wrong.

    ``dispersion`` is that of the errors (`error_dispersion`), which the distance contains already.
    """
    return min(1.0, dispersion / (0.5 * THRESHOLDS.formula_error * max(gap, LEAST_GAP)))


def finite_costs(costs: ArrayLike) -> Array:
    """Return costs in which those of a fit that diverged where a fold is held out are large and finite."""
    return np.nan_to_num(costs, nan=1e30, posinf=1e30)


def model_probabilities(
    alternatives: Sequence[Refit], rng: np.random.Generator, effects: Sequence[str] | None = None
) -> Array:
    """Return the probability (alternatives,) of each refit to be the one that predicts held-out folds best.

    The likelihood of the held-out white error, tempered by its correlation in time and by the reduced chi-square that even
    the best refit leaves, is averaged over a Bayesian bootstrap of the folds (Rubin, 1981), so that nothing is certain that
    rests on few folds. Formulas are inexact, so that a refit that is a little behind may hold the cause, too: it is tempered
    as well by `Thresholds.formula_error` of what the best closes, and by `Thresholds.remaining_error` of what it leaves
    beyond noise, which shows that something is wrong with the formulas.

    Whether any effect is there hardly depends on its formula, but which one of several that look alike does. So the effects
    share their probability by a second temperature, by what the formulas of look-alikes may be wrong: a share of what the
    best leaves (`Thresholds.alike_remaining_error`), at most one of what it closes (`Thresholds.alike_formula_error`). Of a
    change, what no effect explains counts as noise elsewhere; here it is left as well.

    Parameters
    ----------
    alternatives : sequence of Refit
        The second, if there is one, lacks what the first explains.
    rng : numpy Generator
    effects : sequence of str, optional
        The effect of each, empty for none; without them, all have the one temperature.
    """
    costs = finite_costs([alternative.held_out_costs for alternative in alternatives])
    totals = costs.sum(axis=1)
    best = alternatives[int(np.argmin(totals))]
    # What a fit leaves that diverged in a fold is no gap that others close.
    bounded = np.minimum(costs, MOST_HELD_OUT * np.array([alternative.fold_costs for alternative in alternatives])).sum(
        axis=1
    )
    closed = float(bounded[:2].max() - bounded.min())
    left = float(totals.min()) * (1.0 - 1.0 / max(best.chi_square, 1.0))
    dispersion = error_dispersion(best.problem.residuals(best.theta))
    wrong = max(THRESHOLDS.formula_error * closed, THRESHOLDS.remaining_error * left)
    weights = rng.dirichlet(np.ones(costs.shape[1]), BOOTSTRAP_SAMPLES) * costs.shape[1]
    log_likelihoods = -0.5 * weights @ costs.T
    shares = softmax(log_likelihoods / max(dispersion, 0.5 * wrong), axis=1)
    acting = np.array([bool(effect) for effect in effects or ()])
    if acting.sum() > 1:
        left += float(totals.min()) * best.problem.unexplained
        wrong = max(wrong, min(THRESHOLDS.alike_formula_error * closed, THRESHOLDS.alike_remaining_error * left))
        of_effects = shares[:, acting].sum(axis=1, keepdims=True)
        shares[:, acting] = of_effects * softmax(log_likelihoods[:, acting] / max(dispersion, 0.5 * wrong), axis=1)
    return np.asarray(shares.mean(axis=0))


def error_dispersion(white: Array) -> float:
    """Return the factor by which white errors (n,) count less than as many independent ones of variance one."""
    return max(1.0, float(np.mean(white**2))) * correlation_length(white)


def effect_parameters(refitted: Refit) -> dict[str, ParameterEstimate]:
    """Return the parameters of a refit's effects with intervals and remarks, by EFFECT.PARAMETER.

    A parameter that is never searched is included where it differs from its default.

    The covariance is the larger of two: what the scatter of the folds says (sandwich; Liang & Zeger, 1986) and what the
    correlated noise does. A recording does not say whether a sample of the force is an instantaneous value or a mean over
    the sampling period, and a play is crossed within one period; intervals of effects that follow the force contain both.
    """
    problem, unit = refitted.problem, refitted.problem.unit(refitted.theta)
    inverse = scaled_inverse(refitted.information, 1e-12)
    degrees = len(refitted.gradients) - len(inverse)
    deviation = 1.96 * np.sqrt(error_dispersion(problem.residuals(refitted.theta)) * np.diag(inverse))
    if degrees >= LEAST_DEGREES:
        root = inverse @ refitted.gradients.T * np.sqrt(len(refitted.gradients) / degrees)
        deviation = np.maximum(deviation, stdtrit(degrees, 0.975) * np.linalg.norm(root, axis=1))
    following = {effect.id for effect in problem.model.effects if effect.follows_force}
    shift_if_averaged = -inverse @ refitted.averaging_gradient
    estimates = {}
    for place, index in enumerate(problem.free):
        parameter = problem.model.parameters[index]
        effect, _, name = parameter.name.partition(".")
        if not name:
            continue
        shift = shift_if_averaged[place] if effect in following else 0.0
        reach = np.array([min(shift, 0.0) - deviation[place], max(shift, 0.0) + deviation[place]])
        ends = np.clip(unit[place] + reach, 0.0, 1.0)
        units = np.tile(unit, (2, 1))
        units[:, place] = ends
        lower, upper = problem.theta(units)[:, index]
        remark = ""
        is_open = ends[0] == 0.0 and ends[1] == 1.0
        is_on_bound = unit[place] < BOUND_TOLERANCE or unit[place] > 1 - BOUND_TOLERANCE
        # A size on its bound may be a larger one. Any other number, such as the place of a stop that no stroke reaches, may
        # stand there by chance.
        if is_open and not (is_on_bound and name == EFFECTS[effect].parameters[0].name):
            remark = UNDETERMINED
        elif is_on_bound and refitted.theta[index] != parameter.default:
            remark = ON_BOUND
        interval = Interval(float(refitted.theta[index]), float(lower), float(upper))
        estimates[parameter.name] = ParameterEstimate(interval, parameter.unit, remark)
    for parameter, value in zip(problem.model.parameters, refitted.theta, strict=True):
        if "." in parameter.name and not parameter.free and value != parameter.default:
            estimates[parameter.name] = ParameterEstimate(Interval(float(value)), parameter.unit)
    return estimates


def bootstrap_counts(units: int, rng: np.random.Generator) -> Array:
    """Draw how often (BOOTSTRAP_SAMPLES, units) each unit appears in a bootstrap sample."""
    return rng.multinomial(units, np.full(units, 1 / units), BOOTSTRAP_SAMPLES).astype(float)


def bootstrap_interval(
    value: float, drawn: Array, units: int, bounds: tuple[float, float], *, widened: bool = True
) -> Interval:
    """Return a value with its 95 % interval within ``bounds``, from values ``drawn`` from so many units; nan is none.

    The quantiles of a bootstrap of few units are too near to the value, and are ``widened`` about it
    (`mrd_identification.resampling.widened`). What decides by an end was tried with the quantiles themselves.
    """
    if np.isnan(drawn).all() or (widened and units < 2):
        return Interval(value)
    quantiles = np.nanquantile(drawn, (0.025, 0.975))
    ends = resampling.widened(value, quantiles, units) if widened else quantiles
    return Interval(value, *map(float, np.clip(ends, *bounds)))


def nrmse_interval(squares: Array, samples: Array, variance: float, draws: Array) -> Interval:
    """Return the rms error over the force's standard deviation, from squared errors in N² (units,) of so many samples."""
    value = np.sqrt(squares.sum() / samples.sum() / variance)
    drawn = np.sqrt((draws @ squares) / (draws @ samples) / variance)
    return bootstrap_interval(float(value), drawn, len(squares), (0.0, np.inf))


def closed_fraction(before: Array, after: Array, noise: Array, draws: Array, *, widened: bool = True) -> Interval:
    """Return the share of the gap that is closed, from squared errors in N² (units,) and those of the noise;
    ``widened`` as of `bootstrap_interval`.
    """

    def share(b: Array, a: Array, n: Array) -> Array:
        gap = b - n
        return np.asarray(np.where(gap > 0, np.clip((b - a) / np.where(gap > 0, gap, 1.0), -1.0, 1.0), np.nan))

    value = float(share(before.sum(keepdims=True), after.sum(keepdims=True), noise.sum(keepdims=True))[0])
    drawn = share(draws @ before, draws @ after, draws @ noise)
    if np.isnan(drawn).mean() > MOST_WITHOUT_GAP:
        return Interval(value)
    return bootstrap_interval(value, drawn, len(before), (-1.0, 1.0), widened=widened)
