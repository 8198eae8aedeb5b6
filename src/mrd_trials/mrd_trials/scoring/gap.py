"""Closure of the gap, its localisation, and its resolution by the recommended experiment."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mrd_trials.excitation import BEFORE_AFTER, BLACK_BOX
from mrd_trials.records import Evaluation, GapBin
from mrd_trials.scoring.plant_result import PlantResult, PlantResults
from mrd_trials.scoring.rates import Distribution, Rate
from mrd_trials.trial_design import ALTERED_TIERS


def relative_closures(results: PlantResults) -> Distribution:
    """Return the share of the gap closed over that of the oracle, on plants with detectable causes of the catalogue.

    Of effects put into recordings, it is the share of the added error that is closed on fresh runs; the oracle closes 1.
    """
    return _closures(
        [result for result in results if result.truth.excitation not in (BLACK_BOX, BEFORE_AFTER)],
        lambda evaluation: evaluation.closure / evaluation.oracle_closure if evaluation.oracle_closure > 0 else np.nan,
    )


def fresh_closures(results: PlantResults) -> Distribution:
    """Return the share of the gap closed on fresh runs, on simulated plants with detectable causes of the catalogue."""
    return _closures(_rendered(results), lambda evaluation: evaluation.fresh_closure)


def _closures(results: PlantResults, closure: Callable[[Evaluation], float]) -> Distribution:
    """Return a closure of plants with detectable causes that count; a failed diagnosis closes nothing."""
    return Distribution.of_finite(
        0.0 if result.failed else closure(result.evaluation)
        for result in results
        if result.counts and result.detectable and result.truth.kind in ("single", "pair")
    )


def _rendered(results: PlantResults) -> list[PlantResult]:
    """Return the simulated plants that are rendered once more for their evaluation."""
    return [result for result in results if result.truth.excitation not in (BLACK_BOX, *ALTERED_TIERS)]


@dataclass(frozen=True)
class MapAgreement:
    """Agreement of the map of the gap with the true one.

    Attributes
    ----------
    overlap : Distribution
        Overlap of each plant, the mean over its axes (`overlaps`); 0 where there should be a map and is none.
    uniform : Distribution
        Overlap of a map that says nothing.
    """

    overlap: Distribution
    uniform: Distribution

    @classmethod
    def from_results(cls, results: PlantResults) -> "MapAgreement":
        """Compare the maps of simulated plants with detectable effects.

        The map of a gap that is explained in part is that of what remains, and the true map is of all effects: left out.
        """
        overlap, uniform = [], []
        for result in _rendered(results):
            if not result.detectable or result.submission.verdict == "partly_explained":
                continue
            axes = list(overlaps(result.submission.where, result.evaluation.true_map).values())
            if not result.submission.where:
                overlap.append(0.0)
            elif axes:
                overlap.append(float(np.mean([axis.overlap for axis in axes])))
                uniform.append(float(np.mean([axis.uniform for axis in axes])))
        return cls(Distribution(tuple(overlap)), Distribution(tuple(uniform)))


LARGE_GAP = 5.0
"""Squared error beyond noise, over that of noise, from which a diagnosis should say where it lies."""


def places_found(results: PlantResults) -> Rate:
    """Return the share of diagnoses that say where the error lies, of those whose map is that of a large one (`LARGE_GAP`).

    The map of a gap that is explained in part is that of what remains. A diagnosis that failed on detectable effects counts
    as one that does not say it.
    """
    found = [False for result in results if result.failed and result.detectable]
    for submission in (result.submission for result in results if result.submission.has_place is not None):
        error = submission.after if submission.verdict == "partly_explained" else submission.before
        if error**2 - submission.noise_floor**2 >= LARGE_GAP * submission.noise_floor**2:
            found.append(bool(submission.has_place))
    return Rate.from_outcomes(found)


@dataclass(frozen=True)
class AxisOverlap:
    """Agreement of two maps on one axis.

    Attributes
    ----------
    overlap : float
        Sum of the smaller one of the two shares over the common bins, shares clipped at zero and normalised.
    uniform : float
        The same of a map of equal shares.
    """

    overlap: float
    uniform: float


def overlaps(submitted: Iterable[GapBin], true: Iterable[GapBin]) -> dict[str, AxisOverlap]:
    """Compare two maps on every axis of which both have two bins or more."""
    submitted_shares, true_shares = (
        {(entry.axis, entry.lower, entry.upper): entry.share for entry in bins} for bins in (submitted, true)
    )
    axes = {}
    for axis in dict.fromkeys(key[0] for key in true_shares):
        common = [key for key in true_shares if key[0] == axis and key in submitted_shares]
        a, b = (
            np.clip(np.nan_to_num([shares[key] for key in common]), 0.0, None) for shares in (submitted_shares, true_shares)
        )
        if len(common) > 1 and b.sum() > 0:
            a, b = a / (a.sum() or 1.0), b / b.sum()
            axes[axis] = AxisOverlap(float(np.minimum(a, b).sum()), float(np.minimum(1 / len(common), b).sum()))
    return axes


def resolved(results: PlantResults) -> tuple[Rate, Rate]:
    """Return how often the recommended and a random experiment resolve a plant, of those for which one was recommended."""
    tried = [(result.evaluation.advised_resolves, result.evaluation.random_resolves) for result in results]
    outcomes = [(advised, random) for advised, random in tried if advised is not None and random is not None]
    return Rate.from_outcomes([advised for advised, _ in outcomes]), Rate.from_outcomes([random for _, random in outcomes])
