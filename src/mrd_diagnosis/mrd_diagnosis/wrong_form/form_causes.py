"""Effects that belong to the form of the damper, such as a series compliance, which a freer form imitates."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.explanation import RobustCause
from mrd_diagnosis.evidence.cause_class import class_of
from mrd_diagnosis.fitting.base_fit import LinearisedRefit
from mrd_diagnosis.fitting.null_distribution import NullGains
from mrd_diagnosis.fitting.refit import CONVERGED, Refit
from mrd_diagnosis.fitting.statistics import model_probabilities
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.recordings.limitations import contains
from mrd_diagnosis.search.effect_search import ROUGHLY_CONVERGED, refit_with_effects
from mrd_diagnosis.search.model_comparison import NO_EFFECT, ModelComparison, refit_in_its_place, refit_without, with_effects
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wrong_form.robustness import is_robust, leads, predicts_both_halves, probabilities_in_place
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
) -> tuple[dict[str, RobustCause], Refit]:
    """Return the effects that hold as a part of the form, and the model with them.

    Together they close most of what lies between the cost of ``explained``, the model with all other causes, and the cost
    that is ``reachable`` by a freer or a better form. Each is judged beside the others: the best of the ``others``, damper
    models with the best first, that lacks it does not predict better, and of the ``candidates`` that look like it, none does
    in its place. Where two do not hold together, the first may do so alone.
    """
    weighting = comparison.weighting
    chain = [explained, *_form_chain(weighting, explained, reachable, effects)]
    while len(chain) > 1 and _closes_most(explained, chain[-1], reachable):
        *_, before, fitted = chain
        added = [effect for effect in fitted.effects if effect not in explained.effects]
        causes = {}
        for effect in added:
            without = refit_without(weighting, fitted, effect) if effect in before.effects else before
            if cause := _robust_cause(effect, without, fitted, comparison, candidates, others, null_gains, rng):
                causes[effect] = cause
        if len(causes) == len(added):
            return causes, fitted
        chain.pop()
    return {}, explained


def _robust_cause(
    effect: str,
    without: Refit,
    fitted: Refit,
    comparison: ModelComparison,
    candidates: Sequence[str],
    others: Sequence[Refit],
    null_gains: NullGains,
    rng: np.random.Generator,
) -> RobustCause | None:
    """Return an effect of the form with what it does, or None where it does not hold; arguments as of `name_form_causes`."""
    weighting = comparison.weighting
    lacking = [form for form in others if not contains(form.problem.model, effect)]
    instead = [with_effects(weighting, form, without.effects, without.values) for form in lacking[:1]]
    support = float(model_probabilities([fitted, *instead], rng)[0])
    if support < THRESHOLDS.named_probability or not (
        is_robust(support, without, fitted) and predicts_both_halves(without, fitted)
    ):
        return None
    alike = [name for name in EFFECTS[effect].confused_with if name in candidates and name not in fitted.effects]
    refits = {effect: fitted, NO_EFFECT: without} | refit_in_its_place(weighting, without, alike)
    probabilities = probabilities_in_place(refits, support, rng)
    members = class_of(effect, refits, probabilities)
    if not leads(effect, probabilities, members):
        return None
    gain = float(without.held_out_cost - fitted.held_out_cost)
    closed = closed_fraction_between(without, fitted, comparison, rng)
    return RobustCause(probabilities, null_gains.p_value(gain, fitted.problem), closed, members)


def _form_chain(weighting: Weighting, explained: Refit, reachable: float, effects: Sequence[str]) -> list[Refit]:
    """Add effects of the form one after the other, as long as each closes a share of what can still be reached."""
    gap = explained.held_out_cost - weighting.noise_cost
    if explained.held_out_cost - reachable < THRESHOLDS.least_share_first * gap:
        return []
    chain: list[Refit] = []
    best = explained
    while len(chain) < MOST_FORM_EFFECTS:
        remaining = [effect for effect in effects if effect not in best.effects]
        fits = refit_with_effects(
            weighting,
            LinearisedRefit.around(weighting, best),
            remaining,
            len(remaining),
            present=best.effects,
            converged=ROUGHLY_CONVERGED if best.effects else CONVERGED,
        )
        if not fits:
            break
        better = min((fit.refit for fit in fits), key=lambda refitted: refitted.held_out_cost)
        # What closes less of the gap than a formula may be wrong by is no cause.
        needed = max(THRESHOLDS.least_share_next * (best.held_out_cost - reachable), THRESHOLDS.formula_error * gap)
        if best.held_out_cost - better.held_out_cost < needed:
            break
        best = better
        chain.append(best)
    return chain


def _closes_most(without: Refit, fitted: Refit, reachable: float) -> bool:
    """Whether effects of the form close most of what a freer or a better form can reach."""
    available = without.held_out_cost - reachable
    return bool(without.held_out_cost - fitted.held_out_cost >= THRESHOLDS.least_form_share * available)
