"""Evidence: what the recordings say of an effect in its place beside others, as numbers that mean the same for all dampers.

None of them decides by itself. How they combine to a probability was learnt from dampers whose effects were known, see
`mrd_diagnosis.decision.presence`. A new piece of evidence is a field of `Evidence` and a function here.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.refit import Refit, costs_of_halves
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

LARGEST_RATIO = 2.0
"""Ratios are counted up to this: beyond, a larger one says nothing more."""

AGAINST = ("drift", "left")
"""Evidence that can only speak against an effect; all other can only speak for it."""


def number(meaning: str) -> Any:
    """Declare a number of the evidence with its meaning."""
    return field(metadata={"meaning": meaning})


@dataclass(frozen=True)
class Evidence:
    """What speaks for an effect, or against it. Errors are those of held-out folds, gaps are errors beyond noise."""

    closed: float = number("share of the gap of the best form that the effect closes")
    closed_of_forms: float = number("median of the shares around all forms")
    lead: float = number("share of what it closes by which it is ahead of the best effect that is not of its class")
    support: float = number("probability of its class in the table of its place")
    halves: float = number("share of the error that it takes from either half of the recordings: the smaller over the mean")
    folds: float = number("gains less losses of the folds, over both together")
    kept: float = number("its size beside the form remainder over the one without, within its interval")
    beside: float = number("share of the gap beside the form remainder that it closes there")
    drift: float = number("standard deviation of its size from run to run, over its size")
    left: float = number("share of the gap of the best form that all effects leave")

    def as_dict(self) -> dict[str, float]:
        """Return the numbers by name."""
        return asdict(self)


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


def lead_over(without: Refit, fitted: Refit, rivals: Sequence[Refit]) -> float:
    """Return by what share of its gain a refit is ahead of the best of others, between -1 and 1."""
    gain = _gain(without, fitted)
    best = max([0.0, *(_gain(without, rival) for rival in rivals)])
    return float(np.clip((gain - best) / max(gain, best, 1e-300), -1.0, 1.0))


def _gain(without: Refit, fitted: Refit) -> float:
    """Return by how much a refit lowers the held-out cost; what diverges gains nothing."""
    gain = without.held_out_cost - fitted.held_out_cost
    return float(np.nan_to_num(gain, nan=0.0, posinf=1e300, neginf=0.0))


def balance_of_halves(without: Refit, fitted: Refit) -> float:
    """Return the smaller share of the error that a refit takes from either half of the folds, over the mean of both."""
    before, after = costs_of_halves(without), costs_of_halves(fitted)
    shares = (before - after) / np.maximum(before, 1e-300)
    mean = float(shares.mean())
    return float(np.clip(shares.min() / mean, -1.0, 1.0)) if mean > 0.0 and np.isfinite(mean) else -1.0


def balance_of_folds(without: Refit, fitted: Refit) -> float:
    """Return the gains less the losses of all folds, over both together."""
    gains = np.nan_to_num(without.held_out_costs - fitted.held_out_costs, posinf=0.0, neginf=0.0)
    return float(gains.sum() / max(np.abs(gains).sum(), 1e-300))


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
    """Return the standard deviation of an effect's size from run to run, over its size.

    The size of a run is that to which one Gauss-Newton step leads from the common one, all other parameters kept. Runs count
    by what they tell. A single run is divided into its folds.
    """
    problem = fitted.problem
    name = f"{effect}.{EFFECTS[effect].parameters[0].name}"
    places = [place for place, index in enumerate(problem.free) if problem.model.parameters[index].name == name]
    if not places:
        return LARGEST_RATIO
    place = places[0]
    size = problem.unit(fitted.theta)[place] - problem.unit(problem.model.defaults)[place]
    runs = np.array([run for run, _ in fitted.folds])
    if len(np.unique(runs)) == 1:
        runs = np.arange(len(runs))
    numbers = np.unique(runs)
    information = np.array([fitted.normal_matrices[runs == run, place, place].sum() for run in numbers])
    gradients = np.array([fitted.gradients[runs == run, place].sum() for run in numbers])
    if size == 0.0 or information.sum() <= 0.0:
        return LARGEST_RATIO
    steps = -gradients / np.maximum(information, 1e-12 * information.max())
    weights = information / information.sum()
    deviation = np.sqrt(weights @ (steps - weights @ steps) ** 2)
    return float(min(deviation / abs(size), LARGEST_RATIO))
