"""The figures of all plants of one tier."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mrd_trials.records import Submission
from mrd_trials.scoring.around_models import found_around_all
from mrd_trials.scoring.certainty import calibration_of_names, calibration_of_presence, coverage_by_effect
from mrd_trials.scoring.classes import ClassRates, Stratum, strata_of
from mrd_trials.scoring.gap import MapAgreement, fresh_closures, places_found, relative_closures, resolved
from mrd_trials.scoring.plant_result import PlantResults
from mrd_trials.scoring.rates import Calibration, Distribution, Rate


@dataclass(frozen=True)
class TierScore:
    """The figures of all plants of one tier.

    Attributes
    ----------
    plants : int
    not_counted : int
        Plants with effects whose cause is also named on the same recordings without them.
    classes : ClassRates
    strata : tuple of Stratum
    calibration : Calibration
        Of what is named, each effect or class.
    presence : Calibration
        Of the classes that were weighed by their evidence, named or not.
    coverage_by_effect : mapping
        How often the 95 % intervals of rightly named causes hold the true sizes.
    relative_closure : Distribution
        Share of the gap closed over that of the oracle.
    fresh_closure : Distribution
        Share of the gap closed on fresh runs.
    maps : MapAgreement
    places : Rate
        Diagnoses that say where a large error lies.
    around_models : Rate
        Causes that are found around every one of several models, of those found around any.
    advised, random : Rate
        Plants that the recommended and a random experiment resolve.
    """

    plants: int
    not_counted: int
    classes: ClassRates
    strata: tuple[Stratum, ...]
    calibration: Calibration
    presence: Calibration
    coverage_by_effect: Mapping[str, Rate]
    relative_closure: Distribution
    fresh_closure: Distribution
    maps: MapAgreement
    places: Rate
    around_models: Rate
    advised: Rate
    random: Rate

    @classmethod
    def from_results(cls, results: PlantResults, around: Sequence[Mapping[str, Submission]] = ()) -> "TierScore":
        """Compute the figures; ``around`` has the submissions by plant around one model after the other."""
        advised, random = resolved(results)
        return cls(
            plants=len(results),
            not_counted=sum(result.truth.kind != "null" and not result.counts for result in results),
            classes=ClassRates.from_results(results),
            strata=strata_of(results),
            calibration=calibration_of_names(results),
            presence=calibration_of_presence(results),
            coverage_by_effect=coverage_by_effect(results),
            relative_closure=relative_closures(results),
            fresh_closure=fresh_closures(results),
            maps=MapAgreement.from_results(results),
            places=places_found(results),
            around_models=found_around_all([result.truth for result in results], around),
            advised=advised,
            random=random,
        )

    @property
    def coverage(self) -> Rate:
        """How often intervals hold the true sizes, all effects together."""
        rates = self.coverage_by_effect.values()
        return Rate(sum(rate.hits for rate in rates), sum(rate.total for rate in rates))
