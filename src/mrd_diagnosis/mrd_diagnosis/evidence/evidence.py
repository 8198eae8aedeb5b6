"""Evidence: what the recordings say of an effect in its place beside others, as numbers that mean the same for all dampers.

None of them decides by itself. How they combine to a probability was learnt from dampers whose effects were known, see
`mrd_diagnosis.decision.presence`. A new piece of evidence is one entry of `EVIDENCE`; it has no weight until it is learnt.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

LEAST_DRIFT, LARGEST_DRIFT = 0.05, 2.0
"""Relative scatter of a size up to which it is one size, and from which on a larger scatter says nothing more."""

LEAST_INFORMATION = 1e-12
"""Share of the information of the most informative run that stands for none, so that all quotients are finite."""


@dataclass(frozen=True)
class FitsOfEffect:
    """The fits from which the evidence of an effect is computed.

    Attributes
    ----------
    effect : str
    support : float
        Probability of its class in the table of its place.
    fitted : Refit
        The best form that lacks the effect, with it and all other effects.
    complete : Refit
        The best form with all effects.
    remainder_without, remainder_complete : Refit
        The same form beside the form remainder, with all effects but this one, and with all.
    remainder_noise_cost : float
        Cost of noise alone beside the form remainder.
    """

    effect: str
    support: float
    fitted: Refit
    complete: Refit
    remainder_without: Refit
    remainder_complete: Refit
    remainder_noise_cost: float


@dataclass(frozen=True)
class Evidence:
    """A piece of evidence.

    Attributes
    ----------
    name : str
    meaning : str
        What the number says. Errors are those of held-out folds, gaps are errors beyond noise.
    measure : callable
        Computes the number from the fits of an effect.
    against : bool
        Whether it can only speak against an effect; all other evidence can only speak for it.
    """

    name: str
    meaning: str
    measure: Callable[[FitsOfEffect], float]
    against: bool = False


def measure_evidence(fits: FitsOfEffect) -> dict[str, float]:
    """Return the number of each piece of evidence of an effect by name."""
    return {entry.name: entry.measure(fits) for entry in EVIDENCE}


def share_closed(without: Refit, fitted: Refit, noise_cost: float) -> float:
    """Return the share of the gap that a refit closes, between -1 and 1."""
    gap = without.held_out_cost - noise_cost
    if not np.isfinite(fitted.held_out_cost):
        return -1.0
    if not gap > 0.0:
        return 0.0
    if not np.isfinite(gap):
        return 1.0
    return float(np.clip((without.held_out_cost - fitted.held_out_cost) / gap, -1.0, 1.0))


def kept_size(complete: Refit, freed: Refit, effect: str) -> float:
    """Return the size of an effect beside the form remainder, over the one without: what is nearest to 1 in its interval.

    The remainder takes most of what many effects do. Where it leaves too little to tell the size, nothing speaks against it.
    """
    first = EFFECTS[effect].parameters[0]
    name = f"{effect}.{first.name}"
    size = complete.values[name] - first.default
    if size == 0.0:
        return 0.0
    beside = effect_parameters(freed)[name].value
    ratios = [(end - first.default) / size for end in (beside.lower, beside.upper)]
    nearest = float(np.clip(1.0, min(ratios), max(ratios)))
    return max(min(nearest, 1.0 / nearest), 0.0) if nearest else 0.0


def drift_over_runs(fitted: Refit, effect: str) -> float:
    """Return by how many decades the standard deviation of an effect's size from run to run exceeds `LEAST_DRIFT` of it.

    A mechanism has one size; what stands in for the form of the damper has another one in each run. The size of a run is
    that to which one Gauss-Newton step leads from the common one, all other parameters kept. Runs count by what they tell.
    A single run is divided into its folds.
    """
    problem = fitted.problem
    name = f"{effect}.{EFFECTS[effect].parameters[0].name}"
    places = [place for place, index in enumerate(problem.free) if problem.model.parameters[index].name == name]
    if not places:
        return _decades(LARGEST_DRIFT)
    place = places[0]
    size = problem.unit(fitted.theta)[place] - problem.unit(problem.model.defaults)[place]
    runs = np.array([run for run, _ in fitted.folds])
    if len(np.unique(runs)) == 1:
        runs = np.arange(len(runs))
    numbers = np.unique(runs)
    information = np.array([fitted.normal_matrices[runs == run, place, place].sum() for run in numbers])
    gradients = np.array([fitted.gradients[runs == run, place].sum() for run in numbers])
    if size == 0.0 or information.sum() <= 0.0:
        return _decades(LARGEST_DRIFT)
    steps = -gradients / np.maximum(information, LEAST_INFORMATION * information.max())
    weights = information / information.sum()
    deviation = np.sqrt(weights @ (steps - weights @ steps) ** 2)
    return _decades(deviation / abs(size))


def _decades(drift: float) -> float:
    return float(np.log10(np.clip(drift, LEAST_DRIFT, LARGEST_DRIFT) / LEAST_DRIFT))


EVIDENCE = (
    Evidence("support", "probability of its class in the table of its place", lambda fits: fits.support),
    Evidence(
        "beside",
        "share of the gap beside the form remainder that it closes there",
        lambda fits: share_closed(fits.remainder_without, fits.remainder_complete, fits.remainder_noise_cost),
    ),
    Evidence(
        "kept",
        "its size beside the form remainder over the one without, within its interval",
        lambda fits: kept_size(fits.complete, fits.remainder_complete, fits.effect),
    ),
    Evidence(
        "drift",
        f"decades by which its size scatters from run to run beyond {100 * LEAST_DRIFT:g} %",
        lambda fits: drift_over_runs(fits.fitted, fits.effect),
        against=True,
    ),
)
"""All evidence, in the order of reports."""
