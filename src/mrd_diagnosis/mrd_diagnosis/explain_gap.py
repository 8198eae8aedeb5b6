"""Explanation of a gap: which effects explain the difference between a damper model and recordings."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base.progress import ignore
from mrd_diagnosis.decision.explanation import Explanation, FittedExplanation, probabilities_of_alternatives
from mrd_diagnosis.decision.verdict import verdict_on_gap
from mrd_diagnosis.fitting.null_distribution import draw_null_gains
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.weighting import Weighting
from mrd_diagnosis.search.alternative_models import fit_alternative_models
from mrd_diagnosis.search.effect_search import search_effects, tolerated_excess
from mrd_diagnosis.search.model_comparison import RefitComparison, compare_models, compare_on_all_samples, unchanged
from mrd_diagnosis.wrong_form.partial_explanation import explain_in_part, rests_on_form
from mrd_identification.preflight.excitation import repeats_one_stroke

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


def explain_gap(
    weighting: Weighting,
    base: Refit,
    null_errors: Sequence[Array],
    effects: Sequence[str],
    rng: np.random.Generator,
    progress: Progress = ignore,
    in_loop: RefitComparison = unchanged,
) -> FittedExplanation:
    """Explain the gap of a model: by effects beside it, by another model, or by effects beside another form.

    Parameters
    ----------
    weighting : Weighting
    base : Refit
        The model without effects.
    null_errors : sequence of ndarray
        White errors of the runs in noise alone, see `mrd_diagnosis.fitting.base_fit.fit_base`.
    effects : sequence of str
        Ids of the candidates.
    rng : numpy Generator
    progress : callable
        Called with the step and the fraction of the work that is done.
    in_loop : callable
        Refits what a comparison chose with a user's simulator in the loop, where there is one.
    """
    chosen, fits = search_effects(
        weighting, base, effects, null_errors, lambda fraction: progress("trying effects", 0.4 * fraction)
    )
    progress("comparing models", 0.4)
    singles = [fit for fit in fits if len(fit.effects) == 1]
    null_gains = draw_null_gains(base, [fit.refit for fit in singles], rng)
    comparison = compare_models(weighting, base, chosen, fits, rng)
    p_values = {fit.effects[-1]: null_gains.p_value(fit.gain, fit.refit.problem) for fit in chosen}
    comparison = in_loop(comparison)
    complete = in_loop(compare_on_all_samples(comparison, rng))
    other_models: dict[str, Refit] = {}
    probabilities = probabilities_of_alternatives(comparison, rng)
    verdict = verdict_on_gap(complete, base.chi_square, probabilities, p_values, rng)

    def models(fraction: float) -> None:
        progress("trying other damper models", 0.45 + 0.05 * fraction)

    if verdict in ("explained", "ambiguous"):
        # Before an effect is named: another damper model may explain as much without any.
        excess = comparison.best.chi_square - 1.0
        other_models = fit_alternative_models(comparison.weighting, comparison.base, excess, rng, models)
        is_complete = complete is comparison
        comparison = comparison.with_alternative_models(other_models)
        complete = comparison if is_complete else complete.with_alternative_models(other_models)
        probabilities = probabilities_of_alternatives(comparison, rng)
        verdict = verdict_on_gap(complete, base.chi_square, probabilities, p_values, rng)
    explanation = Explanation(verdict, comparison, probabilities, p_values)
    if verdict == "unknown_effect" or (verdict != "no_gap" and rests_on_form(comparison)):
        if not other_models:
            tolerated = tolerated_excess(comparison.base)
            other_models = fit_alternative_models(comparison.weighting, comparison.base, tolerated, rng, models)
        # Of one stroke, nothing tells an effect from the form.
        one_stroke = repeats_one_stroke([recording.run for recording in weighting.recordings])
        explanation = explain_in_part(
            explanation,
            list(other_models.values()),
            [] if one_stroke else effects,
            null_gains,
            rng,
            lambda fraction: progress("looking for causes beside a wrong form", 0.5 + 0.5 * fraction),
        )
        if explanation.comparison is not comparison:
            complete = in_loop(compare_on_all_samples(explanation.comparison, rng))
    return FittedExplanation(explanation, complete, singles, null_gains, other_models)
