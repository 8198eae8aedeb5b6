"""The verdict: everything that decides it, in the order in which a diagnosis asks.

1. `verdict_on_gap`, or `verdict_on_change` where there are reference runs: what the model comparison says.
2. `verdict_beside_other_forms`: where no explanation around the given model holds, what holds around other damper models.
3. `verdict_after_rejection`: what the rejection rules leave of that; asked once more where whole runs are predicted worse
   (`mrd_diagnosis.decision.conclusion.worse_by_runs`).

Only the preflight check comes before: a fault of the recordings is a `data_fault`, and nothing is fitted.
"""

from collections.abc import Collection, Mapping

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.rejection_rules import Rule
from mrd_diagnosis.diagnosis import Finding, Interval, Verdict
from mrd_diagnosis.fitting.statistics import bootstrap_counts
from mrd_diagnosis.search.effect_search import tolerated_excess
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_diagnosis.thresholds import THRESHOLDS

Probabilities = Mapping[str, Mapping[str, float]]
"""For each cause, the probability of every alternative to it, itself included, by name."""

LOWER_QUANTILE = 0.1
"""Quantile of the bootstrapped excess that counts as its lower bound."""


def verdict_on_gap(
    comparison: ModelComparison,
    chi_square_of_search: float,
    probabilities: Probabilities,
    p_values: Mapping[str, float],
    rng: np.random.Generator,
) -> Verdict:
    """Return what a model comparison says of a gap.

    Parameters
    ----------
    comparison : ModelComparison
    chi_square_of_search : float
        Reduced chi-square of the model without effects, with the noise that was known before the search.
    probabilities : mapping
    p_values : mapping
        For each effect of the comparison, the probability of its improvement in noise alone.
    rng : numpy Generator
    """
    best, base = comparison.best, comparison.base
    closed = Interval(0.0, 0.0, 0.0)
    if comparison.effects:
        closed = closed_fraction_between(base, best, comparison, rng, widened=False)
    # Where the gap is so small that the noise estimate may be wrong instead, only an effect that surely closes most of it
    # counts.
    sure = closed.lower >= THRESHOLDS.least_closed and p_values[comparison.effects[0]] <= THRESHOLDS.p_value
    if chi_square_of_search <= THRESHOLDS.no_gap_chi_square or (base.chi_square <= THRESHOLDS.noise_chi_square and not sure):
        return "no_gap"
    if not _explains(comparison, closed.value, rng):
        return "unknown_effect"
    other_model = comparison.alternative_model
    if other_model and any(others.get(other_model, 0.0) > others[effect] for effect, others in probabilities.items()):
        return "unknown_effect"
    return _explained_or_ambiguous(comparison, probabilities)


def verdict_on_change(comparison: ModelComparison, probabilities: Probabilities, rng: np.random.Generator) -> Verdict:
    """Return what a model comparison says of a change; see `mrd_diagnosis.explain_change`. What no change explains counts as
    noise there.
    """
    base, best = comparison.base, comparison.best
    if not comparison.effects:
        return "no_gap" if base.chi_square <= THRESHOLDS.noise_chi_square else "unknown_effect"
    closed = closed_fraction_between(base, best, comparison, rng)
    if np.isnan(closed.value):  # without the effects, the error is no larger than what no change explains
        return "no_gap"
    if not _explains(comparison, closed.value, rng):
        return "partly_explained"
    return _explained_or_ambiguous(comparison, probabilities)


def verdict_beside_other_forms(named: Collection[str]) -> Verdict:
    """Return what effects that hold around other damper models say: they are a part of the explanation, if there are any."""
    return "partly_explained" if named else "unknown_effect"


def verdict_after_rejection(
    verdict: Verdict, named: Collection[str], rejected_by: Collection[Rule], limitations: Collection[Finding]
) -> Verdict:
    """Return what remains of a verdict when some effects that would have been named are rejected.

    Parameters
    ----------
    verdict : Verdict
        Before the rejection.
    named : collection of str
        Effects that no rule rejects.
    rejected_by : collection of Rule
        For each of the others, the rule that rejects it.
    limitations : collection of Finding
        Limitations of the recordings for which effects were rejected.
    """
    if not rejected_by:
        return verdict
    if named:
        return "partly_explained"
    if limitations:
        return "data_fault"
    may_be_there = verdict in ("explained", "ambiguous") and all(rule.leaves_open for rule in rejected_by)
    return "ambiguous" if may_be_there else "unknown_effect"


def _explained_or_ambiguous(comparison: ModelComparison, probabilities: Probabilities) -> Verdict:
    certain = all(probabilities[effect][effect] >= THRESHOLDS.named_probability for effect in comparison.effects)
    return "explained" if certain else "ambiguous"


def _explains(comparison: ModelComparison, closed: float, rng: np.random.Generator) -> bool:
    """Whether the chosen effects close enough of the gap, and what remains is not surely more than an explained gap may
    leave.
    """
    best = comparison.best
    draws = bootstrap_counts(len(best.held_out_chi_squares), rng)
    samples = np.array([fold.stop - fold.start for _, fold in comparison.weighting.folds], dtype=float)
    excess = best.chi_square - 1.0
    surely_in_excess = float(np.quantile((draws @ best.held_out_chi_squares) / (draws @ samples), LOWER_QUANTILE)) - 1.0
    tolerated = tolerated_excess(comparison.base)
    near_noise = excess <= THRESHOLDS.near_noise_excess
    needed = THRESHOLDS.least_closed_near_noise if near_noise else THRESHOLDS.least_closed
    in_excess = excess > tolerated and surely_in_excess > THRESHOLDS.sure_excess_share * tolerated
    return closed >= needed and not in_excess
