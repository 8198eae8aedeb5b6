"""Model comparison: the chosen effects on the noise of the best model, and other effects in the place of each of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np

from mrd_diagnosis.fitting.base_fit import LinearisedRefit, with_effect, without_effect
from mrd_diagnosis.fitting.refit import CONVERGED, Refit, refit, refit_on
from mrd_diagnosis.fitting.run_scatter import estimate_run_scatter
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.recordings.limitations import contains
from mrd_diagnosis.search.effect_search import EffectFit, is_improvement, refit_with_effects
from mrd_identification.parallel import in_threads
from mrd_sim.effects import EFFECTS

MOST_ALTERNATIVES = 4
"""Effects that are fitted in the place of each cause, besides those that look like it."""

NO_EFFECT = ""
"""Name of the alternative in which nothing takes the place of an effect."""


@dataclass(frozen=True)
class ModelComparison:
    """The model without effects, with those that were chosen, and with others in their place.

    Attributes
    ----------
    weighting : Weighting
    base : Refit
        The model without effects.
    chain : tuple of Refit
        The model with one effect, two, ...
    effects : tuple of str
        The effects of the chain, in its order.
    alternatives : dict
        For each effect of the chain, refits by name in which it stays, in which another one takes its place, and in which
        none does (`NO_EFFECT`).
    alternative_model : str
        Name of the alternative in which another damper model takes the place of all effects; empty where none was fitted.
    """

    weighting: Weighting
    base: Refit
    chain: tuple[Refit, ...]
    effects: tuple[str, ...]
    alternatives: dict[str, dict[str, Refit]]
    alternative_model: str = ""

    @property
    def best(self) -> Refit:
        """The model with all chosen effects."""
        return self.chain[-1] if self.chain else self.base

    def without_effects(self) -> Self:
        """Return the comparison with no effect chosen."""
        return replace(self, chain=(), effects=(), alternatives={})

    def with_alternative_models(self, refits: Mapping[str, Refit]) -> Self:
        """Add the best of other damper models as an alternative to every effect that the base model does not lack itself.

        Another model takes the place of all effects at once. Where it predicts worse than the other effects without one of
        them, it is no alternative to that one.
        """
        if not refits:
            return self
        best = min(refits, key=lambda name: refits[name].held_out_cost)
        alternatives = {
            effect: others
            if EFFECTS[effect].structural or refits[best].held_out_cost > others[NO_EFFECT].held_out_cost
            else others | {best: refits[best]}
            for effect, others in self.alternatives.items()
        }
        return replace(self, alternatives=alternatives, alternative_model=best)


RefitComparison = Callable[[ModelComparison], ModelComparison]
"""What refits a comparison in another way, such as with a user's simulator in the loop."""


def unchanged(comparison: ModelComparison) -> ModelComparison:
    """Return a comparison as it is."""
    return comparison


def compare_models(
    weighting: Weighting, base: Refit, chosen: Sequence[EffectFit], fits: Sequence[EffectFit], rng: np.random.Generator
) -> ModelComparison:
    """Estimate noise and run scatter from the best model, and refit everything that may still be the explanation.

    Parameters
    ----------
    weighting : Weighting
        The one of the search.
    base, chosen, fits
        See `mrd_diagnosis.search.effect_search.search_effects`.
    rng : numpy Generator
    """
    best = chosen[-1].refit if chosen else base
    noise = estimate_noise(weighting.recordings, best.problem.model, best.theta, rng)
    weighting = replace(weighting, noise=noise, scatter=estimate_run_scatter(best)).updated(best.problem.model, best.theta)
    return compare_on(weighting, base, chosen, fits)


def compare_on_all_samples(comparison: ModelComparison, rng: np.random.Generator) -> ModelComparison:
    """Refit the base and the chosen effects on all samples of the recordings; alternatives stay as they were fitted."""
    weighting, best = comparison.weighting, comparison.best
    if all(recording.step == 1 for recording in weighting.recordings):
        return comparison
    recordings = [recording.whole for recording in weighting.recordings]
    noise = estimate_noise(recordings, best.problem.model, best.theta, rng)
    weighting = replace(weighting, recordings=recordings, noise=noise).updated(best.problem.model, best.theta)
    base, *chain = (refit_on(weighting, refitted) for refitted in (comparison.base, *comparison.chain))
    return replace(comparison, weighting=weighting, base=base, chain=tuple(chain))


def compare_on(weighting: Weighting, base: Refit, chosen: Sequence[EffectFit], fits: Sequence[EffectFit]) -> ModelComparison:
    """Refit everything that may still be the explanation with a weighting; arguments as of `compare_models`."""
    chain, without = _drop_superfluous(weighting, in_threads(lambda fit: refit_on(weighting, fit.refit), chosen))
    singles = sorted((fit for fit in fits if len(fit.effects) == 1), key=lambda fit: fit.refit.held_out_cost)
    ranked = [fit.effects[0] for fit in singles if fit.effects[0] not in without]

    def others(effect: str) -> list[str]:
        """Return the best effects by themselves, and those that look like this one, which another cause may hide."""
        alike = [name for name in ranked[MOST_ALTERNATIVES:] if name in EFFECTS[effect].confused_with]
        return [*ranked[:MOST_ALTERNATIVES], *alike]

    alternatives = {
        effect: {effect: chain[-1], NO_EFFECT: refitted} | refit_in_its_place(weighting, refitted, others(effect))
        for effect, refitted in without.items()
    }
    return ModelComparison(weighting, refit_on(weighting, base), tuple(chain), tuple(without), alternatives)


def _drop_superfluous(weighting: Weighting, chain: list[Refit]) -> tuple[list[Refit], dict[str, Refit]]:
    """Return the chain without effects that later ones made superfluous, and the refit without each effect that stays."""
    while chain:
        best = chain[-1]
        effects = tuple(dict.fromkeys(effect for step in chain for effect in step.effects))
        without = dict(zip(effects, in_threads(partial(refit_without, weighting, best), effects), strict=True))
        least = min(effects, key=lambda effect: without[effect].held_out_cost)
        if len(effects) == 1 or is_improvement(weighting, without[least], best):
            return chain, without
        kept = [effect for effect in effects if effect != least]
        chain = [without[least]]
        for effect in kept[:0:-1]:
            chain.insert(0, refit_without(weighting, chain[0], effect))
    return chain, {}


def refit_without(weighting: Weighting, refitted: Refit, effect: str) -> Refit:
    """Refit the model without one of its effects."""
    model, theta = without_effect(refitted.problem.model, refitted.theta, effect)
    return refit(weighting.problem(model, theta), theta, weighting.folds)


def refit_in_its_place(
    weighting: Weighting, without: Refit, others: Sequence[str], converged: float = CONVERGED
) -> dict[str, Refit]:
    """Return the refits of a model ``without`` an effect with each of the ``others`` in its place, by name."""
    base = LinearisedRefit.around(weighting, without)
    fits = refit_with_effects(weighting, base, others, len(others), converged=converged)
    return {fit.effects[-1]: fit.refit for fit in fits}


def with_effects(weighting: Weighting, refitted: Refit, effects: Sequence[str], values: Mapping[str, float]) -> Refit:
    """Refit a model with those effects that it does not contain; parameters of effects start from ``values`` where known."""
    model, theta = refitted.problem.model, refitted.theta
    for effect in effects:
        if not contains(refitted.problem.model, effect):
            model, theta = with_effect(model, theta, effect)
    theta = np.array([values.get(n, v) if "." in n else v for n, v in zip(model.names, theta, strict=True)])
    return refit(weighting.problem(model, theta), theta, weighting.folds)


def with_chain(
    comparison: ModelComparison,
    effects: Sequence[str],
    values: Mapping[str, float],
    alternatives: Mapping[str, dict[str, Refit]] | None = None,
) -> ModelComparison:
    """Refit the base model of a comparison with one effect more at a time; the alternatives are given, or only the effects
    themselves.
    """
    weighting, base = comparison.weighting, comparison.base
    chain = tuple(with_effects(weighting, base, effects[: count + 1], values) for count in range(len(effects)))
    known = dict(alternatives) if alternatives is not None else {effect: {effect: chain[-1]} for effect in effects}
    return replace(comparison, chain=chain, effects=tuple(effects), alternatives=known)
