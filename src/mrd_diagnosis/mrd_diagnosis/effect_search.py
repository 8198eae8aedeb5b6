"""Which effect: every candidate refitted around the model, the best one kept, and again around that."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.refit import SETTLED, GapProblem, Refit, refit, scaled_inverse
from mrd_diagnosis.weighting import Ground, with_effect
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS, Effect, find_effects

Array = NDArray[np.float64]

NO_GAP = 1.5
"""Mean squared error over the variance of noise up to which noise may be all there is: its estimate errs by so much."""

LEAST_GAIN = 0.1
"""Share of the noise's energy by which an effect must lower the unseen error to matter."""

LEAST_SHARE = 0.2
"""Share of the gap by which it must."""

LEAST_SHARE_BESIDE = 0.3
"""Share of what is left of the gap by which it must beside another effect, whose own form may be a little off."""

SURE_SHARE_BESIDE, SURE_GAIN = 0.7, 1.0
"""Share of what is left, and of the noise's energy, by which a second effect must lower the unseen error where no more is
left than the form of the first one may leave."""

UNEXPLAINED = 0.3
"""Mean squared error beyond noise, over the variance of noise, that may be left of an explained gap."""

IMPRECISE = 0.06
"""Share of a gap that may be left of it too: an effect's form and the step of its integration are never quite right."""

MOST_CAUSES = 3
"""Effects that are added to the model, one after the other."""

BEAM = 2
"""First effects that are tried with a second one."""

SHORTLIST = 8
"""Effects that are tried beside another one: those that the score puts first."""

ROUGHLY = 1e-4
"""Relative decrease of the cost at which a fit beside another effect is done: what is chosen is refitted anyway."""

BEST_ALONE = 3
"""Effects that are tried beside another one too, whatever their score: those that are the best alone."""

LEFT_OVER = 0.03
"""Share of an effect's change of the force that the model's own parameters must leave, or else it cannot be tested."""


@dataclass(frozen=True)
class Foundation:
    """A refitted model to which effects are added, with what scoring them needs.

    Attributes
    ----------
    refit : Refit
    residual : ndarray (samples,)
        White.
    jacobian : ndarray (samples, free)
    inverse : ndarray (free, free)
        Of its normal matrix.
    """

    refit: Refit
    residual: Array
    jacobian: Array
    inverse: Array

    @classmethod
    def of(cls, ground: Ground, fitted: Refit) -> "Foundation":
        """From a refit; what a run's own gain multiplies is the force of the refit itself."""
        problem = ground.problem(fitted.problem.model, fitted.theta)
        jacobian = problem.jacobian(problem.unit(fitted.theta))
        inverse = scaled_inverse(jacobian.T @ jacobian, 1e-10)
        return cls(fitted, problem.residuals(fitted.theta), jacobian, inverse)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects in the model."""
        return tuple(effect.id for effect in self.refit.problem.model.effects)


@dataclass(frozen=True)
class Score:
    """What an effect promises, before it is fitted.

    Attributes
    ----------
    gain : float
        Squared white residual that the best of its forms takes away, to first order.
    start : ndarray (parameters,)
        Where its fit should begin.
    left_over : float
        Share of its change of the force that the model's own parameters cannot imitate.
    """

    gain: float
    start: Array
    left_over: float


@dataclass(frozen=True)
class Trial:
    """Effects around the model, refitted.

    Attributes
    ----------
    effects : tuple of str
        In the order in which they were added.
    refit : Refit
    gain, unseen_gain : float
        By how much the squared white error is less than without the last of the effects.
    """

    effects: tuple[str, ...]
    refit: Refit
    gain: float
    unseen_gain: float


def variants(effect: Effect, force: Array) -> list[dict[str, float]]:
    """Values of an effect's parameters from which fits to a force (n,) may begin: typical, each shape moved, its forms."""
    typical = {p.name: effect.typical.get(p.name, p.default) for p in effect.parameters}
    size, *shapes = effect.parameters
    sizes = effect.starts(force) if effect.starts else [typical[size.name]]
    found = [typical | {size.name: value} for value in sizes]
    typical = found[0]
    for shape in shapes:
        if not shape.free:
            continue
        for place in (0.15, 0.5, 0.85):
            ratio = shape.upper / shape.lower if shape.log else 0.0
            value = shape.lower * ratio**place if shape.log else shape.lower + place * (shape.upper - shape.lower)
            found.append(typical | {shape.name: value})
    return [*found, *({**typical, **form} for form in effect.forms)]


def score(problem: GapProblem, foundation: Foundation, effect: Effect) -> Score:
    """How much of the foundation's residual an effect could take away.

    Each form of the effect (`variants`) changes the force; what the model's own parameters can imitate of the change is
    taken out, and the rest is scaled to suit the residual (a score test of finite size, with nuisance rejection: Basseville
    & Nikiforov, 1993).
    """
    names = problem.model.names
    old = foundation.refit.problem.model
    values = dict(zip(old.names, foundation.refit.theta, strict=True))
    plain = np.array([values.get(p.name, p.default) for p in problem.model.parameters])
    own = [names.index(f"{effect.id}.{p.name}") for p in effect.parameters]
    best: Score | None = None
    size = effect.parameters[0]
    for variant in variants(effect, problem.force):
        if variant[size.name] == 0.0:
            continue
        theta = plain.copy()
        theta[own] = [variant[p.name] for p in effect.parameters]
        change = problem.residuals(theta) - foundation.residual
        energy = float(change @ change)
        if not np.isfinite(energy) or energy == 0.0:
            continue
        absorbed = -foundation.inverse @ (foundation.jacobian.T @ change)
        left = change + foundation.jacobian @ absorbed
        strength = float(left @ left)
        ends = sorted((size.lower / variant[size.name], size.upper / variant[size.name]))
        factor = float(np.clip(-(left @ foundation.residual) / strength, max(ends[0], -3.0), min(ends[1], 3.0)))
        gain = max(0.0, -factor * (2 * float(left @ foundation.residual) + factor * strength))
        if best is None or gain > best.gain:
            # A fit that begins at nothing learns nothing of the shape, nor one short of a threshold of what lies beyond.
            factor = factor if abs(factor) > 0.03 else 0.03
            scale = 1.0 if effect.starts else factor
            start = plain.copy()
            start[own] = [variant[p.name] for p in effect.parameters]
            for place, parameter in zip(own, effect.parameters, strict=True):
                if parameter is size or (parameter.default == 0.0 and parameter.lower < 0.0 < parameter.upper):
                    start[place] *= scale
            moved = problem.unit(start)
            old_free = [names.index(old.names[i]) for i in foundation.refit.problem.free]
            moved[[problem.free.index(i) for i in old_free]] += factor * absorbed
            begun = problem.theta(np.clip(moved, 0.0, 1.0))
            for place, parameter in zip(own, effect.parameters, strict=True):
                if not parameter.free:
                    begun[place] = variant[parameter.name]
            best = Score(gain, begun, float(np.sqrt(strength / energy)))
    return best or Score(0.0, plain, 0.0)


def search(
    ground: Ground,
    base: Refit,
    effects: Sequence[str],
    noise: Sequence[Array] = (),
    progress: Callable[[float], None] = lambda _share: None,
) -> tuple[list[Trial], list[Trial]]:
    """Find the effects that, added to the model one after the other, lower its error on unseen parts most.

    Parameters
    ----------
    ground : Ground
    base : Refit
        Of the model alone.
    effects : sequence of str
        Ids of the candidates.
    noise : sequence of ndarray (draws, n), optional
        See `refit`.
    progress : callable
        Called with the share of the work that is done.

    Returns
    -------
    chosen : list of Trial
        Each with one effect more than the one before; empty where no effect helps.
    trials : list of Trial
        Everything that was fitted.
    """
    first = around(
        ground, Foundation.of(ground, base), effects, len(effects), progress=lambda share: progress(0.6 * share), noise=noise
    )
    trials = list(first)
    alone = {trial.effects[0]: trial.refit for trial in sorted(first, key=lambda trial: trial.refit.total)}
    chosen: list[Trial] = []
    before, within = base, False
    # What a model lacks by construction comes first: others may imitate it, alone.
    frontier = sorted(first, key=lambda trial: (not lacking(trial, ground, base), trial.refit.total))
    while frontier:
        best = frontier[0]
        if not worth(ground, before, best.refit, within):
            break
        chosen.append(best)
        if len(chosen) == MOST_CAUSES:
            break
        ground = ground.after(best.refit.problem.model, best.refit.theta)
        before = anew(ground, best.refit)
        # Judged where samples weigh as they do once the effect is in: before, the gap itself has flattened their weights.
        left = min(best.refit.level, before.level) - 1.0
        within = left <= may_be_left(base)
        if within and (left <= SURE_GAIN or len(chosen) > 1):
            break
        rivals = len(chosen) == 1 and not within and not EFFECTS[best.effects[0]].structural
        leads = frontier[: BEAM if rivals else 1]
        again = [before, *(anew(ground, lead.refit) for lead in leads[1:])]
        found = [
            trial
            for lead, fitted in zip(leads, again, strict=True)
            for trial in around(
                ground,
                Foundation.of(ground, fitted),
                [e for e in effects if e not in lead.effects],
                SHORTLIST,
                alone,
                present=lead.effects,
            )
        ]
        progress(0.6 + 0.4 * len(chosen) / MOST_CAUSES)
        trials += found
        frontier = sorted(found, key=lambda trial: trial.refit.total)
        if (
            len(chosen) == 1
            and frontier
            and frontier[0].effects[:1] != best.effects
            and worth(ground, before, frontier[0].refit)
        ):
            # The pair does not hold what was the best alone: its own first effect leads to it.
            chosen = [lead for lead in leads if lead.effects == frontier[0].effects[:1]]
    progress(1.0)
    return chosen, trials


def anew(ground: Ground, old: Refit) -> Refit:
    """The same model refitted on another ground."""
    return refit(ground.problem(old.problem.model, old.theta), old.theta, ground.parts)


def beside(ground: Ground, foundation: Foundation, effects: Sequence[str]) -> list[Score]:
    """What each effect promises around the foundation's model; nothing if it is there already."""

    def of(effect: str) -> Score:
        if effect in foundation.effects:
            return Score(0.0, foundation.refit.theta, 1.0)
        model, neutral = with_effect(foundation.refit.problem.model, foundation.refit.theta, effect)
        return score(ground.problem(model, neutral), foundation, find_effects([effect])[0])

    return in_threads(of, effects)


def lacking(trial: Trial, ground: Ground, base: Refit) -> bool:
    """Whether a trial brings in what is part of damper models and the base does not have."""
    return EFFECTS[trial.effects[-1]].structural and worth(ground, base, trial.refit)


def may_be_left(alone: Refit) -> float:
    """Mean squared error beyond noise, over the variance of noise, that an explained gap may leave."""
    return UNEXPLAINED + IMPRECISE * (alone.level - 1.0)


def showing(ground: Ground, alone: Refit, best: Refit) -> float:
    """Squared white residual from which one more effect beside the best would be added to it by `search`, and be told.

    Parameters
    ----------
    ground : Ground
    alone, best : Refit
        The model without effects, and with all that were found.
    """
    left = max(best.total / ground.noise_share - 1.0, 0.0)

    def taking(share: float) -> float:
        """So much that it is this share of all that is left then."""
        return share / (1.0 - share) * left

    if best.problem.model.effects:
        open_gap = max(LEAST_GAIN, may_be_left(alone) - left, taking(LEAST_SHARE_BESIDE))
        least = min(open_gap, max(SURE_GAIN, taking(SURE_SHARE_BESIDE)))
    else:
        least = max(NO_GAP - 1.0, taking(LEAST_SHARE))
    return least * ground.noise_share


def worth(ground: Ground, before: Refit, after: Refit, surely: bool = False) -> bool:
    """Whether an effect lowers the unseen error enough to matter, or, as a second one, surely."""
    least_share = LEAST_SHARE_BESIDE if before.problem.model.effects else LEAST_SHARE
    share, least = (SURE_SHARE_BESIDE, SURE_GAIN) if surely else (least_share, LEAST_GAIN)
    gain = before.total - after.total
    return before.level - after.level > least and gain > share * (before.total - ground.noise_share)


def around(
    ground: Ground,
    foundation: Foundation,
    effects: Sequence[str],
    most: int,
    alone: Mapping[str, Refit] | None = None,
    progress: Callable[[float], None] = lambda _share: None,
    present: tuple[str, ...] = (),
    noise: Sequence[Array] = (),
) -> list[Trial]:
    """Refit the foundation's model with each of the most promising effects, and with those that were the best alone."""
    scores = dict(zip(effects, beside(ground, foundation, effects), strict=True))
    promising = sorted(effects, key=lambda effect: -scores[effect].gain)[:most]
    best_alone = [effect for effect in list(alone or {})[:BEST_ALONE] if effect in scores and effect not in promising]
    ranked = [*promising, *best_alone]
    done = itertools.count(1)

    def fit(effect: str) -> Trial:
        model, neutral = with_effect(foundation.refit.problem.model, foundation.refit.theta, effect)
        start = scores[effect].start
        problem = ground.problem(model, start)
        if alone and effect in alone:
            # Beside others, an effect begins as it was found alone, where that leaves less.
            known = dict(zip(alone[effect].problem.model.names, alone[effect].theta, strict=True))
            other = np.array(
                [
                    known[name] if name.startswith(f"{effect}.") else value
                    for name, value in zip(model.names, neutral, strict=True)
                ]
            )
            promised, found = (float(np.sum(problem.residuals(theta) ** 2)) for theta in (start, other))
            if found < promised:
                start, problem = other, ground.problem(model, other)
        fitted = refit(problem, start, ground.parts, noise, ROUGHLY if present else SETTLED)
        progress(next(done) / len(ranked))
        before = foundation.refit
        gain = float(before.cost.sum() - fitted.cost.sum())
        return Trial((*present, effect), fitted, gain, before.total - fitted.total)

    return in_threads(fit, ranked)
