"""Closure of the gap, its localisation, and its resolution by the recommended experiment."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from mrd_trials.records import GapBin
from mrd_trials.scoring.plant_result import PlantResults
from mrd_trials.scoring.rates import Distribution, Rate


def relative_closures(results: PlantResults) -> Distribution:
    """Return the share of the gap closed over that of the oracle, on plants with detectable causes of the catalogue."""
    closures = [
        np.nan_to_num(result.submission.closed_fraction[0]) / result.evaluation.oracle_closure
        for result in results
        if result.detectable and result.truth.kind in ("single", "pair") and result.evaluation.oracle_closure > 0
    ]
    return Distribution.of_finite(closures)


def fresh_differences(results: PlantResults) -> Distribution:
    """Return the distance between the submitted share of the gap closed and that on fresh runs."""
    return Distribution.of_finite(
        abs(result.submission.closed_fraction[0] - result.evaluation.fresh_closure) for result in results
    )


@dataclass(frozen=True)
class MapAgreement:
    """Agreement of the map of the gap with the true one.

    Attributes
    ----------
    overlap : Distribution
        Overlap of each plant, the mean over its axes (`overlaps`).
    uniform : Distribution
        Overlap of a map that says nothing.
    same_largest_bin : Rate
        Axes on which both maps have their largest share in the same bin.
    """

    overlap: Distribution
    uniform: Distribution
    same_largest_bin: Rate

    @classmethod
    def from_results(cls, results: PlantResults) -> "MapAgreement":
        """Compare the maps of all plants that have both."""
        maps = [
            axes for result in results if (axes := overlaps(result.submission.where, result.evaluation.true_map).values())
        ]
        return cls(
            overlap=Distribution(tuple(float(np.mean([axis.overlap for axis in axes])) for axes in maps)),
            uniform=Distribution(tuple(float(np.mean([axis.uniform for axis in axes])) for axes in maps)),
            same_largest_bin=Rate.from_outcomes([axis.same_largest_bin for axes in maps for axis in axes]),
        )


LARGE_GAP = 5.0
"""Squared error beyond noise, over that of noise, from which a diagnosis should say where it lies."""


def places_found(results: PlantResults) -> Rate:
    """Return the share of diagnoses that say where the error lies, of those whose map is that of a large one (`LARGE_GAP`).

    The map of a gap that is explained in part is that of what remains.
    """
    found = []
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
    same_largest_bin : bool
    """

    overlap: float
    uniform: float
    same_largest_bin: bool


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
            same_largest_bin = bool(a.any() and np.argmax(a) == np.argmax(b))
            overlap, uniform = float(np.minimum(a, b).sum()), float(np.minimum(1 / len(common), b).sum())
            axes[axis] = AxisOverlap(overlap, uniform, same_largest_bin)
    return axes


@dataclass(frozen=True)
class ExperimentComparison:
    """Plants that the recommended and a random experiment resolve, of those for which one was recommended."""

    advised: Rate
    random: Rate
    only_advised: int
    only_random: int

    @classmethod
    def from_results(cls, results: PlantResults) -> "ExperimentComparison":
        """Count the plants for which an experiment was recommended."""
        tried = [(result.evaluation.advised_resolves, result.evaluation.random_resolves) for result in results]
        outcomes = [(advised, random) for advised, random in tried if advised is not None and random is not None]
        return cls(
            advised=Rate.from_outcomes([advised for advised, _ in outcomes]),
            random=Rate.from_outcomes([random for _, random in outcomes]),
            only_advised=outcomes.count((True, False)),
            only_random=outcomes.count((False, True)),
        )

    @property
    def ratio(self) -> float:
        """Plants resolved by the recommended over those resolved by the random experiment; nan where both resolve none."""
        return self.advised.hits / self.random.hits if self.random.hits else (np.inf if self.advised.hits else np.nan)
