"""Effects that belong to the form of the damper, such as a series compliance, which a freer form imitates."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.base_fit import BaseFit
from mrd_diagnosis.closure import closed_fraction_between
from mrd_diagnosis.effect_search import ROUGHLY_CONVERGED, refit_with_effects
from mrd_diagnosis.held_cause import HeldCause, holds, holds_in_halves, leads, probabilities_in_place, with_effects
from mrd_diagnosis.limitations import contains
from mrd_diagnosis.model_comparison import NO_EFFECT, ModelComparison, refit_in_its_place
from mrd_diagnosis.null_distribution import NullGains
from mrd_diagnosis.refit import CONVERGED, Refit
from mrd_diagnosis.statistics import probabilities
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.weighting import Weighting
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

MOST_FORM_EFFECTS = 2
"""Effects of the form that are added to the model one after the other, at most."""


def name_form_causes(
    comparison: ModelComparison,
    explained: Refit,
    reachable: float,
    effects: Sequence[str],
    candidates: Sequence[str],
    others: Sequence[Refit],
    null_gains: NullGains,
    rng: np.random.Generator,
) -> tuple[dict[str, HeldCause], Refit]:
    """Return the effects that hold as a part of the form, and the model with them.

    Together they close most of what lies between the cost of ``explained``, the model with all other causes, and the cost
    that is ``reachable`` by a freer or a better form. The best of the ``others``, damper models with the best first, that
    lacks one of them does not predict better, and of the ``candidates`` that look like it, none does in its place.
    """
    weighting, causes, without = comparison.weighting, {}, explained
    for effect, fitted in _form_chain(weighting, explained, reachable, effects):
        lacking = [form for form in others if not contains(form.problem.model, effect)]
        instead = [with_effects(weighting, form, explained.effects, explained.values) for form in lacking[:1]]
        support = float(probabilities([fitted, *instead], rng)[0])
        if (
            support < THRESHOLDS.named_probability
            or not holds(support, explained, fitted)
            or not holds_in_halves(explained, fitted)
        ):
            break
        alike = [name for name in EFFECTS[effect].confused_with if name in candidates and name not in explained.effects]
        refits = {effect: fitted, NO_EFFECT: explained} | refit_in_its_place(weighting, explained, alike)
        chances = probabilities_in_place(refits, support, rng)
        if not leads(effect, chances):
            break
        gain = float(explained.held_out_cost - fitted.held_out_cost)
        closed = closed_fraction_between(explained, fitted, comparison, rng)
        causes[effect] = HeldCause(chances, null_gains.p_value(gain, fitted.problem), closed)
        explained = fitted
    # The chain closes most of it, but what holds of the chain may not.
    if not _closes_most(without, explained, reachable):
        return {}, without
    return causes, explained


def _form_chain(weighting: Weighting, explained: Refit, reachable: float, effects: Sequence[str]) -> list[tuple[str, Refit]]:
    """Add effects of the form one after the other; return them where they close most of what can be reached."""
    available = explained.held_out_cost - reachable
    gap = explained.held_out_cost - weighting.noise_cost
    if available < THRESHOLDS.least_share_first * gap:
        return []
    chain: list[tuple[str, Refit]] = []
    best = explained
    while len(chain) < MOST_FORM_EFFECTS and not _closes_most(explained, best, reachable):
        remaining = [effect for effect in effects if effect not in best.effects]
        fits = refit_with_effects(
            weighting,
            BaseFit.linearise(weighting, best),
            remaining,
            len(remaining),
            present=best.effects,
            converged=ROUGHLY_CONVERGED if best.effects else CONVERGED,
        )
        if not fits:
            break
        fit = min(fits, key=lambda fit: fit.refit.held_out_cost)
        # What closes less of the gap than a formula may be wrong by is no cause.
        needed = max(THRESHOLDS.least_share_next * (best.held_out_cost - reachable), THRESHOLDS.formula_error * gap)
        if best.held_out_cost - fit.refit.held_out_cost < needed:
            break
        best = fit.refit
        chain.append((fit.effects[-1], best))
    return chain if _closes_most(explained, best, reachable) else []


def _closes_most(without: Refit, fitted: Refit, reachable: float) -> bool:
    """Whether effects of the form close most of what a freer or a better form can reach."""
    available = without.held_out_cost - reachable
    return bool(without.held_out_cost - fitted.held_out_cost >= THRESHOLDS.least_form_share * available)
