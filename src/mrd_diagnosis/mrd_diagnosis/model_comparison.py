"""The refits between which is judged, on the noise floor and the run scatter of the best of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np

from mrd_diagnosis.effect_search import Foundation, Trial, anew, around, worth
from mrd_diagnosis.noise_model import run_noise
from mrd_diagnosis.refit import Refit, Scatter, refit
from mrd_diagnosis.report.sentences import name_of_form
from mrd_diagnosis.weighting import Ground, without_effect
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS

MOST_RIVALS = 4
"""Effects that are compared in the place of each cause."""

FIRST_SCATTER = Scatter(0.01, 2.0)
"""Of runs of the same bench, before anything is learned from them: relative, and in N."""

MOST_SCATTER = Scatter(0.04, 20.0)
"""More than this is no scatter."""


@dataclass(frozen=True)
class Contest:
    """The model alone, with the effects that were found, and with others in their place.

    Attributes
    ----------
    ground : Ground
    alone : Refit
        The model without effects.
    chain : tuple of Refit
        With one effect, two, ...
    effects : tuple of str
        Those of the chain, in its order.
    rivals : dict
        For each effect of the chain, refits in which another one, or none (""), takes its place.
    form : str
        Name of the rival in which another form of the damper model takes the place of all effects, where these were tried.
    """

    ground: Ground
    alone: Refit
    chain: tuple[Refit, ...]
    effects: tuple[str, ...]
    rivals: dict[str, dict[str, Refit]]
    form: str = ""

    @property
    def best(self) -> Refit:
        """The model with all effects that were found."""
        return self.chain[-1] if self.chain else self.alone

    def against(self, forms: Mapping[str, Refit]) -> Self:
        """With the best of other forms of the damper model as a rival of every effect but those that it lacks itself.

        A form takes the place of all effects at once: one that predicts worse than the others of them alone rivals none.
        """
        if not forms:
            return self
        best = min(forms, key=lambda form: forms[form].total)
        name = name_of_form(best)
        rivals = {
            effect: others
            if EFFECTS[effect].structural or forms[best].total > others[""].total
            else others | {name: forms[best]}
            for effect, others in self.rivals.items()
        }
        return replace(self, rivals=rivals, form=name)


def contest(
    first: Ground, alone: Refit, chosen: Sequence[Trial], trials: Sequence[Trial], rng: np.random.Generator
) -> Contest:
    """Learn noise and scatter from the best model, and fit anew what may still be it.

    Parameters
    ----------
    first : Ground
        On which was searched.
    alone, chosen, trials
        See `mrd_diagnosis.effect_search.search`.
    rng : numpy Generator
    """
    best = chosen[-1].refit if chosen else alone
    noises = run_noise(first.recordings, best.problem.model, best.theta, rng)
    ground = replace(first, noises=noises, scatter=learned_scatter(best)).after(best.problem.model, best.theta)
    chain, without = _needed(ground, in_threads(lambda trial: anew(ground, trial.refit), chosen))
    singles = sorted((trial for trial in trials if len(trial.effects) == 1), key=lambda trial: trial.refit.total)
    others = [trial.effects[0] for trial in singles if trial.effects[0] not in without][:MOST_RIVALS]
    rivals = {
        effect: {effect: chain[-1], "": fitted} | _in_its_place(ground, fitted, others) for effect, fitted in without.items()
    }
    return Contest(ground, anew(ground, alone), tuple(chain), tuple(without), rivals)


def _needed(ground: Ground, chain: list[Refit]) -> tuple[list[Refit], dict[str, Refit]]:
    """The chain less the effects that others made superfluous, and by effect what it is without each."""
    while chain:
        best = chain[-1]
        effects = tuple(dict.fromkeys(effect.id for step in chain for effect in step.problem.model.effects))
        without = dict(zip(effects, in_threads(partial(_without, ground, best), effects), strict=True))
        least = min(effects, key=lambda effect: without[effect].total)
        if len(effects) == 1 or worth(ground, without[least], best):
            return chain, without
        kept = [effect for effect in effects if effect != least]
        chain = [without[least]]
        for effect in kept[:0:-1]:
            chain.insert(0, _without(ground, chain[0], effect))
    return chain, {}


def _without(ground: Ground, fitted: Refit, effect: str) -> Refit:
    """The same model refitted without one of its effects."""
    model, theta = without_effect(fitted.problem.model, fitted.theta, effect)
    return refit(ground.problem(model, theta), theta, ground.parts)


def _in_its_place(ground: Ground, without: Refit, others: Sequence[str]) -> dict[str, Refit]:
    """A model with each of some other effects."""
    trials = around(ground, Foundation.of(ground, without), others, len(others))
    return {trial.effects[-1]: trial.refit for trial in trials}


def learned_scatter(fitted: Refit) -> Scatter:
    """Scatter of gain and offset of runs, by expectation-maximisation from what a refit leaves of each run."""
    problem = fitted.problem
    known = []
    for index, block in enumerate(problem.blocks):
        whitening = problem.whitenings[index]
        columns = np.stack([whitening.reference, np.ones_like(whitening.reference)], axis=1) * whitening.weight[:, None]
        error = (problem.modelled(fitted.theta, index) - problem.force[block]) * whitening.weight
        # A gap is no noise: what it leaves makes offset and gain of a run less certain.
        known.append((columns.T @ columns, columns.T @ error, max(1.0, float(np.mean(error**2)))))
    variance = np.array([FIRST_SCATTER.gain**2, FIRST_SCATTER.offset**2])
    for _ in range(50):
        moments = []
        for gram, right, level in known:
            covariance = np.linalg.inv(gram / level + np.diag(1 / variance))
            moments.append((covariance @ right / level) ** 2 + np.diag(covariance))
        variance = np.clip(np.mean(moments, axis=0), [1e-6, 1e-2], [MOST_SCATTER.gain**2, MOST_SCATTER.offset**2])
    return Scatter(float(np.sqrt(variance[0])), float(np.sqrt(variance[1])))
