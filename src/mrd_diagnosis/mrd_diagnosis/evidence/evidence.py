"""Evidence: what the recordings say of an effect in its place beside others, as numbers that mean the same for all dampers.

None of them decides by itself. How they combine to a probability was learnt from dampers whose effects were known, see
`mrd_diagnosis.decision.presence`. A new piece of evidence is one entry of `EVIDENCE`; it has no weight until it is learnt.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Member
from mrd_diagnosis.fitting.refit import Refit, costs_of_halves
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_diagnosis.search.model_comparison import NO_EFFECT
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]

LARGEST_RATIO = 2.0
"""Ratios are counted up to this: beyond, a larger one says nothing more."""

LEAST_INFORMATION = 1e-12
"""Share of the information of the most informative run that stands for none, so that all quotients are finite."""

LEAST_COST = 1e-300
"""Cost that stands for none, so that all quotients are finite."""

LARGEST_COST = 1e300
"""Cost that stands for an infinite one."""


@dataclass(frozen=True)
class FitsOfEffect:
    """The fits from which the evidence of an effect is computed.

    Attributes
    ----------
    effect : str
    probabilities : mapping
        Probability of each effect in the same place, and of none, by name.
    members : tuple of Member
        Its class.
    by_form : tuple of mapping
        For each form of the damper, the best first, its refits in this place by name: with each effect, and with none
        (`NO_EFFECT`). All other effects are in them.
    alone, complete : Refit
        The best form without effects, and with all.
    remainder_without, remainder_complete : Refit
        The same form beside the form remainder, with all effects but this one, and with all.
    noise_cost, remainder_noise_cost : float
        Cost of noise alone, without and beside the form remainder.
    """

    effect: str
    probabilities: Mapping[str, float]
    members: tuple[Member, ...]
    by_form: tuple[Mapping[str, Refit], ...]
    alone: Refit
    complete: Refit
    remainder_without: Refit
    remainder_complete: Refit
    noise_cost: float
    remainder_noise_cost: float

    @property
    def without(self) -> Refit:
        """The best form with all effects but this one."""
        return self.by_form[0][NO_EFFECT]

    @property
    def fitted(self) -> Refit:
        """The best form with this effect as well."""
        return self.by_form[0][self.effect]

    @property
    def alike(self) -> set[str]:
        """Ids of the effects of its class."""
        return {member.effect for member in self.members}

    @property
    def rivals(self) -> list[Refit]:
        """The best form with each effect in this place that is not of its class."""
        return [fitted for name, fitted in self.by_form[0].items() if name not in self.alike and name != NO_EFFECT]


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


def median_share_closed(fits: FitsOfEffect) -> float:
    """Return the median, over the forms, of the share of the gap that the best effect of its class closes."""
    shares = [
        max(share_closed(refits[NO_EFFECT], refits[name], fits.noise_cost) for name in fits.alike & refits.keys())
        for refits in fits.by_form
        if fits.alike & refits.keys()
    ]
    return float(np.median(shares))


def lead_over(without: Refit, fitted: Refit, rivals: Sequence[Refit]) -> float:
    """Return by what share of its gain a refit is ahead of the best of others, between -1 and 1."""
    gain = _gain(without, fitted)
    best = max([0.0, *(_gain(without, rival) for rival in rivals)])
    return float(np.clip((gain - best) / max(gain, best, LEAST_COST), -1.0, 1.0))


def _gain(without: Refit, fitted: Refit) -> float:
    """Return by how much a refit lowers the held-out cost; what diverges gains nothing."""
    gain = without.held_out_cost - fitted.held_out_cost
    return float(np.nan_to_num(gain, nan=0.0, posinf=LARGEST_COST, neginf=0.0))


def balance_of_halves(without: Refit, fitted: Refit) -> float:
    """Return the smaller share of the error that a refit takes from either half of the folds, over the mean of both."""
    before, after = costs_of_halves(without), costs_of_halves(fitted)
    shares = (before - after) / np.maximum(before, LEAST_COST)
    mean = float(shares.mean())
    return float(np.clip(shares.min() / mean, -1.0, 1.0)) if mean > 0.0 and np.isfinite(mean) else -1.0


def balance_of_folds(without: Refit, fitted: Refit) -> float:
    """Return the gains less the losses of all folds, over both together."""
    gains = np.nan_to_num(without.held_out_costs - fitted.held_out_costs, posinf=0.0, neginf=0.0)
    return float(gains.sum() / max(np.abs(gains).sum(), LEAST_COST))


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


def share_left(alone: Refit, complete: Refit, noise_cost: float) -> float:
    """Return the share of the gap that all effects leave, between 0 and 1."""
    gap = max(alone.held_out_cost - noise_cost, LEAST_COST)
    return float(np.clip((complete.held_out_cost - noise_cost) / gap, 0.0, 1.0))


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
    steps = -gradients / np.maximum(information, LEAST_INFORMATION * information.max())
    weights = information / information.sum()
    deviation = np.sqrt(weights @ (steps - weights @ steps) ** 2)
    return float(min(deviation / abs(size), LARGEST_RATIO))


EVIDENCE = (
    Evidence(
        "closed",
        "share that the effect closes of the gap that the best form with the other effects leaves",
        lambda fits: share_closed(fits.without, fits.fitted, fits.noise_cost),
    ),
    Evidence("closed_of_forms", "median of the shares around all forms", median_share_closed),
    Evidence(
        "lead",
        "share of what it closes by which it is ahead of the best effect that is not of its class",
        lambda fits: lead_over(fits.without, fits.fitted, fits.rivals),
    ),
    Evidence(
        "support",
        "probability of its class in the table of its place",
        lambda fits: sum(fits.probabilities[member.effect] for member in fits.members),
    ),
    Evidence(
        "halves",
        "share of the error that it takes from either half of the recordings: the smaller over the mean",
        lambda fits: balance_of_halves(fits.without, fits.fitted),
    ),
    Evidence(
        "folds",
        "gains less losses of the folds, over both together",
        lambda fits: balance_of_folds(fits.without, fits.fitted),
    ),
    Evidence(
        "kept",
        "its size beside the form remainder over the one without, within its interval",
        lambda fits: kept_size(fits.complete, fits.remainder_complete, fits.effect),
    ),
    Evidence(
        "beside",
        "share of the gap beside the form remainder that it closes there",
        lambda fits: share_closed(fits.remainder_without, fits.remainder_complete, fits.remainder_noise_cost),
    ),
    Evidence(
        "drift",
        "standard deviation of its size from run to run, over its size",
        lambda fits: drift_over_runs(fits.fitted, fits.effect),
        against=True,
    ),
    Evidence(
        "left",
        "share of the gap of the best form that all effects leave",
        lambda fits: share_left(fits.alone, fits.complete, fits.noise_cost),
        against=True,
    ),
)
"""All evidence, in the order of reports."""
