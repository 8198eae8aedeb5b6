"""Open explanations: which of them the next experiment has to tell apart."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mrd_base.progress import ignore
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.experiment_design.advice import advise
from mrd_diagnosis.fitting.statistics import model_probabilities
from mrd_diagnosis.search.effect_search import EffectFit
from mrd_diagnosis.search.model_comparison import NO_EFFECT, refit_in_its_place, refit_without
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_sim.effects import EFFECTS
from mrd_trajectory.settings import GeneratorSettings

MOST_EXPLANATIONS_TO_SEPARATE = 4
"""Explanations that the next experiment is designed to separate."""


def advise_next(
    explanation: Explanation,
    rejected: Mapping[str, bool],
    singles: Sequence[EffectFit],
    rng: np.random.Generator,
    bench: GeneratorSettings | None = None,
    progress: Callable[[float], None] = ignore,
) -> Advice | None:
    """Advise what to record to tell explanations apart that are open.

    These are the least certain effect and the alternatives to it, or, where no effect was chosen, the ``singles`` that
    predict best. No advised experiment exceeds the limits of ``bench`` (default: the shipped bench).

    Parameters
    ----------
    explanation : Explanation
        Before the rejection rules.
    rejected : mapping
        For each effect that the rejection rules rejected, whether it may be there all the same, seen but not determined.
    singles : sequence of EffectFit
        Each effect by itself.
    rng : numpy Generator
    bench : GeneratorSettings, optional
    progress : callable
        Called with the fraction of the work that is done.

    Returns
    -------
    Advice or None
        None where all effects are certain.
    """
    comparison, probabilities = explanation.comparison, explanation.probabilities
    asked = [effect for effect in comparison.effects if rejected.get(effect, True)]
    uncertain = [e for e in asked if e in rejected or probabilities[e][e] < THRESHOLDS.named_probability]
    if uncertain:
        effect = min(uncertain, key=lambda name: probabilities[name][name])
        known, likely = comparison.alternatives[effect], dict(probabilities[effect])
        without = known.get(NO_EFFECT) or refit_without(comparison.weighting, comparison.best, effect)
        names = _open_explanations(likely)
        if effect in rejected:
            # Its size may be the one at which it is absent.
            names, likely[NO_EFFECT] = [*names, NO_EFFECT], max(likely.values())
    elif asked or not singles:
        return None
    else:
        ranked = sorted(singles, key=lambda fit: fit.refit.held_out_cost)[:MOST_EXPLANATIONS_TO_SEPARATE]
        without, known = comparison.base, {fit.effects[0]: fit.refit for fit in ranked}
        effects = [ranked[0].effects[0], NO_EFFECT, *(fit.effects[0] for fit in ranked[1:])]
        refits_of = [ranked[0].refit, without, *(fit.refit for fit in ranked[1:])]
        likely = dict(zip(effects, model_probabilities(refits_of, rng, effects), strict=True))
        names = _open_explanations(likely)
    missing = [name for name in names if name in EFFECTS and name not in known]
    refits = {**known, NO_EFFECT: without}
    if missing:
        refits |= refit_in_its_place(comparison.weighting, without, missing)
    names = [name for name in dict.fromkeys(names) if name in refits]
    return advise(
        {name: refits[name] for name in names},
        comparison.weighting,
        probabilities={name: float(likely.get(name, 0.0)) for name in names},
        without=without,
        bench=bench,
        progress=progress,
    )


def _open_explanations(probabilities: Mapping[str, float]) -> list[str]:
    """Return the names of the explanations to separate, by their probabilities; at least one beside the likeliest.

    An experiment that rules out what is unlikely anyway leaves the question open.
    """
    likeliest = sorted(filter(None, probabilities), key=lambda name: -probabilities[name])
    ranked = likeliest[:MOST_EXPLANATIONS_TO_SEPARATE]
    names = [name for name in ranked if name in ranked[:2] or probabilities[name] >= THRESHOLDS.listed_probability]
    return names if len(names) > 1 else [*names, NO_EFFECT]
