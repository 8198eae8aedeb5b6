"""Effect search: every candidate effect is refitted with the model, the best is kept, and the search goes on around it."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base.progress import ignore
from mrd_diagnosis.fitting.base_fit import LinearisedRefit, with_effect
from mrd_diagnosis.fitting.refit import CONVERGED, Refit, refit, refit_on
from mrd_diagnosis.fitting.weighting import WeightedProblem, Weighting, sum_of_squares
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS, Effect, find_effects

Array = NDArray[np.float64]
Progress = Callable[[float], None]

MOST_CAUSES = 3
"""Effects that are added to the model one after the other, at most."""

FIRST_EFFECTS_TRIED = 2
"""First effects with which a second one is tried."""

BEST_SCORES = 8
"""Effects that are fitted beside another one because of their score."""

BEST_SINGLES = 3
"""Effects that are fitted beside another one because they were the best by themselves, whatever their score."""

ROUGHLY_CONVERGED = 1e-4
"""Relative decrease of the cost at which a fit beside another effect ends. The chosen one is refitted."""

LEAST_START_FACTOR = 0.03
"""Share of an effect's start value at which its fit starts at least: from zero, the derivatives to its other parameters
vanish.
"""

LARGEST_START_FACTOR = 3.0
"""Multiple of an effect's start value up to which its change of the force is extrapolated linearly."""

LOWER_START, MIDDLE_START, UPPER_START = 0.15, 0.5, 0.85
"""Positions in the range of a shape parameter from which fits start."""


@dataclass(frozen=True)
class EffectScore:
    """Estimate of what an effect can achieve, before it is fitted.

    Attributes
    ----------
    gain : float
        Decrease of the sum of squared white residuals for the best start values, to first order.
    start : ndarray (parameters,)
        Parameters from which the fit should start.
    """

    gain: float
    start: Array


@dataclass(frozen=True)
class EffectFit:
    """The model refitted with effects.

    Attributes
    ----------
    effects : tuple of str
        Ids in the order in which they were added.
    refit : Refit
    gain, held_out_gain : float
        Decrease of the sum of squared white residuals by the last of the effects: fitted, and on held-out folds.
    """

    effects: tuple[str, ...]
    refit: Refit
    gain: float
    held_out_gain: float


def search_effects(
    weighting: Weighting, base: Refit, effects: Sequence[str], null_errors: Sequence[Array] = (), progress: Progress = ignore
) -> tuple[list[EffectFit], list[EffectFit]]:
    """Find the effects that lower the error on held-out folds most when they are added to the model one after the other.

    Parameters
    ----------
    weighting : Weighting
    base : Refit
        Of the model without effects.
    effects : sequence of str
        Ids of the candidates.
    null_errors : sequence of ndarray (draws, n), optional
        See `mrd_diagnosis.fitting.refit.refit`.
    progress : callable
        Called with the fraction of the work that is done.

    Returns
    -------
    chosen : list of EffectFit
        Each with one effect more than the one before; empty where no effect helps.
    fits : list of EffectFit
        Everything that was fitted.
    """
    singles = refit_with_effects(
        weighting,
        LinearisedRefit.around(weighting, base),
        effects,
        len(effects),
        progress=lambda fraction: progress(0.6 * fraction),
        null_errors=null_errors,
    )
    fits = list(singles)
    by_itself = {fit.effects[0]: fit.refit for fit in sorted(singles, key=lambda fit: fit.refit.held_out_cost)}
    chosen: list[EffectFit] = []
    before, within_tolerance = base, False
    # What a model lacks by construction comes first; other effects may imitate it.
    frontier = sorted(singles, key=lambda fit: (not lacks_by_construction(fit, weighting, base), fit.refit.held_out_cost))
    while frontier:
        best = frontier[0]
        if not is_improvement(weighting, before, best.refit, within_tolerance):
            break
        chosen.append(best)
        if len(chosen) == MOST_CAUSES:
            break
        weighting = weighting.updated(best.refit.problem.model, best.refit.theta, best.refit.coefficients)
        before = refit_on(weighting, best.refit)
        # Both weightings count: before the effect was added, the gap itself had flattened the weights.
        excess = min(best.refit.chi_square, before.chi_square) - 1.0
        within_tolerance = excess <= tolerated_excess(base)
        if within_tolerance and (excess <= THRESHOLDS.least_gain_within_tolerance or len(chosen) > 1):
            break
        try_several = len(chosen) == 1 and not within_tolerance and not EFFECTS[best.effects[0]].structural
        leads = frontier[: FIRST_EFFECTS_TRIED if try_several else 1]
        extended = _with_one_more(weighting, before, leads, effects, by_itself)
        progress(0.6 + 0.4 * len(chosen) / MOST_CAUSES)
        fits += extended
        frontier = sorted(extended, key=lambda fit: fit.refit.held_out_cost)
        if (
            len(chosen) == 1
            and frontier
            and frontier[0].effects[:1] != best.effects
            and is_improvement(weighting, before, frontier[0].refit)
        ):
            # The best pair does not contain the best single effect: continue from its own first effect.
            chosen = [lead for lead in leads if lead.effects == frontier[0].effects[:1]]
    progress(1.0)
    return chosen, fits


def _with_one_more(
    weighting: Weighting, best: Refit, leads: Sequence[EffectFit], effects: Sequence[str], by_itself: Mapping[str, Refit]
) -> list[EffectFit]:
    """Refit each of ``leads``, of which ``best`` is the refit of the first, with one effect more."""
    refitted = [best, *(refit_on(weighting, lead.refit) for lead in leads[1:])]
    return [
        fit
        for lead, refit_of_lead in zip(leads, refitted, strict=True)
        for fit in refit_with_effects(
            weighting,
            LinearisedRefit.around(weighting, refit_of_lead),
            [effect for effect in effects if effect not in lead.effects],
            BEST_SCORES,
            by_itself,
            present=lead.effects,
            converged=ROUGHLY_CONVERGED,
        )
    ]


def refit_with_effects(
    weighting: Weighting,
    base: LinearisedRefit,
    effects: Sequence[str],
    most: int,
    by_itself: Mapping[str, Refit] | None = None,
    progress: Progress = ignore,
    present: tuple[str, ...] = (),
    null_errors: Sequence[Array] = (),
    converged: float = CONVERGED,
) -> list[EffectFit]:
    """Refit the base model with each of the ``most`` best-scored effects, and with those that were the best by themselves.

    Parameters
    ----------
    weighting : Weighting
    base : LinearisedRefit
        May contain the effects ``present`` already.
    effects : sequence of str
        Ids of the candidates.
    most : int
    by_itself : mapping, optional
        Refit of each effect without others, best first.
    progress : callable
    present : tuple of str
    null_errors : sequence of ndarray (draws, n), optional
        See `mrd_diagnosis.fitting.refit.refit`.
    converged : float
        Relative decrease of the cost at which a fit ends.
    """
    scores = dict(zip(effects, score_effects(weighting, base, effects), strict=True))
    promising = sorted(effects, key=lambda effect: -scores[effect].gain)[:most]
    best_singles = [e for e in list(by_itself or {})[:BEST_SINGLES] if e in scores and e not in promising]
    ranked = [*promising, *best_singles]
    completed = itertools.count(1)

    def fit(effect: str) -> EffectFit:
        model, neutral = with_effect(base.refit.problem.model, base.refit.theta, effect)
        start = scores[effect].start
        problem = weighting.problem(model, start)
        if by_itself and effect in by_itself:
            problem, start = _better_start(weighting, problem, start, neutral, effect, by_itself[effect])
        refitted = refit(problem, start, weighting.folds, null_errors, converged, _sensitivity(problem, start, base))
        progress(next(completed) / len(ranked))
        gain = float(base.refit.fold_costs.sum() - refitted.fold_costs.sum())
        return EffectFit((*present, effect), refitted, gain, base.refit.held_out_cost - refitted.held_out_cost)

    return in_threads(fit, ranked)


def _sensitivity(problem: WeightedProblem, start: Array, base: LinearisedRefit) -> Array:
    """Return derivatives (samples, free) with which a fit begins: exact for new parameters, otherwise those of the base."""
    names, known = problem.model.names, base.refit.problem
    of_base = {known.model.names[index]: place for place, index in enumerate(known.free)}
    new = [place for place, index in enumerate(problem.free) if names[index] not in of_base]
    sensitivity = np.empty((len(problem.force), len(problem.free)))
    sensitivity[:, new] = problem.jacobian(problem.unit(start), new)
    for place, index in enumerate(problem.free):
        if names[index] in of_base:
            sensitivity[:, place] = base.jacobian[:, of_base[names[index]]]
    return sensitivity


def _better_start(
    weighting: Weighting, problem: WeightedProblem, start: Array, neutral: Array, effect: str, by_itself: Refit
) -> tuple[WeightedProblem, Array]:
    """Choose between the start from the score and the values that the effect had by itself, by the error that they give."""
    known = dict(zip(by_itself.problem.model.names, by_itself.theta, strict=True))
    other = np.array(
        [
            known[name] if name.startswith(f"{effect}.") else value
            for name, value in zip(problem.model.names, neutral, strict=True)
        ]
    )
    cost_of_start, cost_of_other = (sum_of_squares(problem.residuals(theta)) for theta in (start, other))
    if cost_of_other < cost_of_start:
        return weighting.problem(problem.model, other), other
    return problem, start


def score_effects(weighting: Weighting, base: LinearisedRefit, effects: Sequence[str]) -> list[EffectScore]:
    """Score each effect around the base model; an effect that the model contains already scores zero."""

    def score(effect: str) -> EffectScore:
        if effect in base.effects:
            return EffectScore(0.0, base.refit.theta)
        model, neutral = with_effect(base.refit.problem.model, base.refit.theta, effect)
        return score_effect(weighting.problem(model, neutral), base, find_effects([effect], model.scales)[0])

    return in_threads(score, effects)


def score_effect(problem: WeightedProblem, base: LinearisedRefit, effect: Effect) -> EffectScore:
    """Estimate how much of the base fit's residual an effect can remove.

    Each start value of the effect (`start_values`) changes the force. What the model's own parameters can imitate of the
    change is removed, and the rest is scaled to fit the residual: a score test of finite size with nuisance rejection
    (Basseville & Nikiforov, 1993).
    """
    names = problem.model.names
    values = dict(zip(base.refit.problem.model.names, base.refit.theta, strict=True))
    neutral = np.array([values.get(p.name, p.default) for p in problem.model.parameters])
    places = [names.index(f"{effect.id}.{p.name}") for p in effect.parameters]
    best: EffectScore | None = None
    size = effect.parameters[0]
    for trial in start_values(effect, problem.force):
        if trial[size.name] == 0.0:
            continue
        theta = neutral.copy()
        theta[places] = [trial[p.name] for p in effect.parameters]
        change = problem.residuals(theta) - base.residual
        energy = sum_of_squares(change)
        if not np.isfinite(energy) or energy == 0.0:
            continue
        absorbed = -base.inverse @ (base.jacobian.T @ change)
        unabsorbed = change + base.jacobian @ absorbed
        strength = float(unabsorbed @ unabsorbed)
        lower, upper = sorted((size.lower / trial[size.name], size.upper / trial[size.name]))
        lower, upper = max(lower, -LARGEST_START_FACTOR), min(upper, LARGEST_START_FACTOR)
        factor = float(np.clip(-(unabsorbed @ base.residual) / strength, lower, upper))
        gain = max(0.0, -factor * (2 * float(unabsorbed @ base.residual) + factor * strength))
        if best is None or gain > best.gain:
            best = EffectScore(gain, _start_of_fit(problem, base, effect, places, neutral, trial, absorbed, factor))
    return best or EffectScore(0.0, neutral)


def _start_of_fit(
    problem: WeightedProblem,
    base: LinearisedRefit,
    effect: Effect,
    places: Sequence[int],
    neutral: Array,
    trial: Mapping[str, float],
    absorbed: Array,
    factor: float,
) -> Array:
    """Return the parameters from which to fit an effect: scaled by ``factor``, the model's own parameters adapted."""
    names, size = problem.model.names, effect.parameters[0]
    factor = factor if abs(factor) > LEAST_START_FACTOR else LEAST_START_FACTOR
    # Effects with start values of their own act beyond a threshold; a smaller value might not reach it.
    scale = 1.0 if effect.starts else factor
    theta = neutral.copy()
    theta[places] = [trial[p.name] for p in effect.parameters]
    for place, parameter in zip(places, effect.parameters, strict=True):
        if parameter is size or (parameter.default == 0.0 and parameter.lower < 0.0 < parameter.upper):
            theta[place] *= scale
    unit = problem.unit(theta)
    base_names = base.refit.problem.model.names
    of_base = [names.index(base_names[i]) for i in base.refit.problem.free]
    unit[[problem.free.index(i) for i in of_base]] += factor * absorbed
    start = problem.theta(np.clip(unit, 0.0, 1.0))
    for place, parameter in zip(places, effect.parameters, strict=True):
        if not parameter.free:
            start[place] = trial[parameter.name]
    return start


def start_values(effect: Effect, force: Array) -> list[dict[str, float]]:
    """Return values of an effect's parameters from which fits to a force (n,) may start.

    They are the typical values, the typical values with each shape parameter moved, and the variants of the effect.
    """
    typical = {p.name: effect.typical.get(p.name, p.default) for p in effect.parameters}
    size, *shapes = effect.parameters
    sizes = effect.starts(force) if effect.starts else [typical[size.name]]
    values = [typical | {size.name: value} for value in sizes]
    typical = values[0]
    for shape in shapes:
        if not shape.free:
            continue
        for position in (LOWER_START, MIDDLE_START, UPPER_START):
            ratio = shape.upper / shape.lower if shape.log else 0.0
            value = shape.lower * ratio**position if shape.log else shape.lower + position * (shape.upper - shape.lower)
            values.append(typical | {shape.name: value})
    return [*values, *({**typical, **variant} for variant in effect.variants)]


def lacks_by_construction(fit: EffectFit, weighting: Weighting, base: Refit) -> bool:
    """Whether a fit adds what damper models usually contain and the base model does not, and improves it."""
    return EFFECTS[fit.effects[-1]].structural and is_improvement(weighting, base, fit.refit)


def tolerated_excess(base: Refit) -> float:
    """Return the excess of the reduced chi-square over 1 that an explained gap may leave, given the model without
    effects.
    """
    return THRESHOLDS.tolerated_excess + THRESHOLDS.tolerated_gap_share * (base.chi_square - 1.0)


def is_improvement(weighting: Weighting, before: Refit, after: Refit, within_tolerance: bool = False) -> bool:
    """Whether an effect lowers the held-out error enough to be added.

    ``within_tolerance`` says that the error before is small enough to come from the formula of the effects that are in the
    model already.
    """
    share = THRESHOLDS.least_share_next if before.effects else THRESHOLDS.least_share_first
    least_gain = THRESHOLDS.least_gain
    if within_tolerance:
        share, least_gain = THRESHOLDS.least_share_within_tolerance, THRESHOLDS.least_gain_within_tolerance
    gain = before.held_out_cost - after.held_out_cost
    gap = before.held_out_cost - weighting.noise_cost
    return before.chi_square - after.chi_square > least_gain and gain > share * gap


def detection_threshold(weighting: Weighting, base: Refit, best: Refit) -> float:
    """Return the sum of squared white residuals from which one more effect would be added by `search_effects` and be named.

    Parameters
    ----------
    weighting : Weighting
    base, best : Refit
        The model without effects, and with all that were chosen.
    """
    excess = max(best.held_out_cost / weighting.noise_cost - 1.0, 0.0)

    def needed_for(share: float) -> float:
        """Return the gain that is this share of everything that remains then."""
        return share / (1.0 - share) * excess

    if best.effects:
        open_gap = max(THRESHOLDS.least_gain, tolerated_excess(base) - excess, needed_for(THRESHOLDS.least_share_next))
        least = min(
            open_gap, max(THRESHOLDS.least_gain_within_tolerance, needed_for(THRESHOLDS.least_share_within_tolerance))
        )
    else:
        least = max(THRESHOLDS.noise_chi_square - 1.0, needed_for(THRESHOLDS.least_share_first))
    return least * weighting.noise_cost
