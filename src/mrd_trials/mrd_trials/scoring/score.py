"""The score of a trial: all figures, by excitation, with the goals."""

from collections.abc import Mapping
from dataclasses import dataclass

from mrd_base import InputError
from mrd_trials.excitation import BEFORE_AFTER, SEMIREAL
from mrd_trials.records import Evaluation, GroundTruth, Submission
from mrd_trials.scoring.altered import AlteredScore
from mrd_trials.scoring.certainty import calibration_of, claims_of_causes, claims_of_first_candidates, coverage_by_effect
from mrd_trials.scoring.classes import ClassRates
from mrd_trials.scoring.gap import ExperimentComparison, MapAgreement, fresh_differences, places_found, relative_closures
from mrd_trials.scoring.goals import Goal
from mrd_trials.scoring.naming import (
    CandidateSetRates,
    MethodRates,
    NamingRates,
    PairRates,
    compare_methods,
    naming_by_stratum,
)
from mrd_trials.scoring.plant_result import PlantResult, PlantResults, select
from mrd_trials.scoring.rates import Calibration, Distribution, Rate
from mrd_trials.scoring.verdict_counts import Counts, MistakeRates, count_confusion, count_verdicts, excitations
from mrd_trials.trial_design import ALTERED_TIERS


@dataclass(frozen=True)
class ExcitationScore:
    """The figures of all plants of one excitation.

    Attributes
    ----------
    plants : int
    single, detectable, explained : NamingRates
        Plants with one effect: all; the detectable ones; those of them with verdict ``explained``.
    pairs : PairRates
    mistakes : MistakeRates
    calibration, calibration_with_candidates : Calibration
        Of every named cause; of these and, where none is named, of the first candidate.
    coverage : Rate
        How often the 95 % intervals of rightly named causes hold the true sizes.
    coverage_by_effect : mapping
    relative_closure : Distribution
        Share of the gap closed over that of the oracle.
    fresh_difference : Distribution
        Distance between the submitted share of the gap closed and that on fresh runs.
    maps : MapAgreement
    places : Rate
        Diagnoses that say where a large error lies.
    experiments : ExperimentComparison
    candidate_sets : CandidateSetRates
    classes : ClassRates
    """

    plants: int
    single: NamingRates
    detectable: NamingRates
    explained: NamingRates
    pairs: PairRates
    mistakes: MistakeRates
    calibration: Calibration
    calibration_with_candidates: Calibration
    coverage: Rate
    coverage_by_effect: Mapping[str, Rate]
    relative_closure: Distribution
    fresh_difference: Distribution
    maps: MapAgreement
    places: Rate
    experiments: ExperimentComparison
    candidate_sets: CandidateSetRates
    classes: ClassRates

    @classmethod
    def from_results(cls, results: PlantResults) -> "ExcitationScore":
        """Compute the figures of the plants of one excitation."""
        singles = select(results, kind="single")
        detectable = [result for result in singles if result.detectable]
        explained = [result for result in detectable if result.submission.verdict == "explained"]
        causes = claims_of_causes(results)
        coverage = coverage_by_effect(causes)
        return cls(
            plants=len(results),
            single=NamingRates.from_results("plants", "single effects", singles),
            detectable=NamingRates.from_results("plants", "detectable", detectable),
            explained=NamingRates.from_results("plants", "explained", explained),
            pairs=PairRates.from_results(select(results, kind="pair")),
            mistakes=MistakeRates.from_results(results),
            calibration=calibration_of(causes),
            calibration_with_candidates=calibration_of([*causes, *claims_of_first_candidates(results)]),
            coverage=Rate(sum(rate.hits for rate in coverage.values()), sum(rate.total for rate in coverage.values())),
            coverage_by_effect=coverage,
            relative_closure=relative_closures(results),
            fresh_difference=fresh_differences(results),
            maps=MapAgreement.from_results(results),
            places=places_found(results),
            experiments=ExperimentComparison.from_results(results),
            candidate_sets=CandidateSetRates.from_results(detectable),
            classes=ClassRates.from_results(results),
        )


@dataclass(frozen=True)
class TrialScore:
    """Score of the diagnosis in a trial.

    Attributes
    ----------
    plants : int
    goals : tuple of Goal
    by_excitation : mapping
        ``rich`` is always there.
    by_stratum : tuple of NamingRates
        By signal to floor, effect, rate and damper form, of the rich excitation.
    confusion : Counts
        Ground truth by what was named first, of the rich excitation.
    verdicts : Counts
        Kind of plant by verdict, of every excitation.
    methods : tuple of MethodRates
        The diagnosis first, then the baseline methods; of the rich excitation.
    altered : mapping
        Figures of measured recordings into which effects were put, by tier; they count in nothing above but ``plants`` and
        ``verdicts``.
    seconds : Distribution
        Duration of the diagnosis of each plant.
    failures : mapping
        Error by plant.
    """

    plants: int
    goals: tuple[Goal, ...]
    by_excitation: Mapping[str, ExcitationScore]
    by_stratum: tuple[NamingRates, ...]
    confusion: Counts
    verdicts: Counts
    methods: tuple[MethodRates, ...]
    altered: Mapping[str, AlteredScore]
    seconds: Distribution
    failures: Mapping[str, str]

    @property
    def has_rich(self) -> bool:
        """Whether there are simulated plants of rich excitation, of which most figures are."""
        return self.by_excitation["rich"].plants > 0


def score_trial(
    answers: Mapping[str, GroundTruth], submissions: Mapping[str, Submission], evaluations: Mapping[str, Evaluation]
) -> TrialScore:
    """Score the submissions on plants.

    Parameters
    ----------
    answers, submissions, evaluations : mapping
        By plant. A plant without submission counts as failed; evaluations may be missing.

    Raises
    ------
    InputError
        When there are no plants, a submission is on an unknown plant, or the causes of a plant do not fit its kind.
    """
    _check(answers, submissions, evaluations)
    results = [
        PlantResult(
            truth,
            submissions.get(plant, Submission(plant, "failed", "no submission")),
            evaluations.get(plant, Evaluation(plant)),
        )
        for plant, truth in answers.items()
    ]
    simulated = [result for result in results if result.truth.excitation not in ALTERED_TIERS]
    rich = select(simulated, excitation="rich")
    by_excitation = {
        name: ExcitationScore.from_results(select(simulated, excitation=name)) for name in excitations(simulated)
    }
    altered = {
        tier: AlteredScore.from_results(of_tier) for tier in ALTERED_TIERS if (of_tier := select(results, excitation=tier))
    }
    return TrialScore(
        plants=len(results),
        goals=_goals(simulated, by_excitation, altered),
        by_excitation=by_excitation,
        by_stratum=naming_by_stratum(rich),
        confusion=count_confusion(rich),
        verdicts=count_verdicts(results),
        methods=compare_methods(rich),
        altered=altered,
        seconds=Distribution.of_finite(result.submission.elapsed for result in results),
        failures={result.truth.plant: result.submission.failure for result in results if result.failed},
    )


def _check(
    answers: Mapping[str, GroundTruth], submissions: Mapping[str, Submission], evaluations: Mapping[str, Evaluation]
) -> None:
    if not answers:
        raise InputError("no plants to score: expected at least one answer")
    unknown = sorted((submissions.keys() | evaluations.keys()) - answers.keys())
    if unknown:
        raise InputError(f"plant {unknown[0]} has no answer: expected submissions on the plants with sealed answers")
    for plant, truth in answers.items():
        if len(truth.causes) != {"single": 1, "pair": 2, "null": 0}.get(truth.kind, len(truth.causes)):
            raise InputError(f"plant {plant}: {len(truth.causes)} causes do not fit its kind, {truth.kind}")


def _goals(
    results: PlantResults, by_excitation: Mapping[str, ExcitationScore], altered: Mapping[str, AlteredScore]
) -> tuple[Goal, ...]:
    """Return the goals of what the trial has."""
    goals = _goals_of_simulated(results, by_excitation) if by_excitation["rich"].plants else ()
    if SEMIREAL in altered:
        of_tier = altered[SEMIREAL]
        goals += (
            Goal("measured recordings: detectable single effects, cause named", of_tier.detectable, least=0.85),
            Goal("measured recordings: wrong names beyond the background", of_tier.wrong, most=0.1),
            Goal("measured recordings: median share of the added error closed", of_tier.closed, least=0.9),
            Goal("measured recordings: expected calibration error", of_tier.calibration, most=0.08),
        )
    if BEFORE_AFTER in altered:
        of_tier = altered[BEFORE_AFTER]
        goals += (
            Goal("before and after: detectable single effects, cause named", of_tier.detectable, least=0.95),
            Goal("before and after: something named where nothing changed", of_tier.untouched, most=0.05),
        )
    return goals


def _goals_of_simulated(results: PlantResults, by_excitation: Mapping[str, ExcitationScore]) -> tuple[Goal, ...]:
    rich = by_excitation["rich"]
    covers = by_excitation["sine"].candidate_sets.covers if "sine" in by_excitation else Rate(0, 0)
    # Rich runs leave hardly anything ambiguous, so experiments are compared over every excitation.
    experiments = ExperimentComparison.from_results(results)
    return (
        Goal("plants, rich excitation", float(rich.plants), least=200),
        Goal("false alarms on null plants", rich.mistakes.null, most=0.05),
        Goal("detectable single effects: cause named first", rich.detectable.named, least=0.9),
        Goal("the same when the verdict is `explained`", rich.explained.named_equivalent, least=0.97),
        Goal("both causes of a pair named", rich.pairs.both, least=0.8),
        Goal("wrong names on absent effects", rich.mistakes.absent, most=0.1),
        Goal("expected calibration error", rich.calibration, most=0.08),
        Goal("coverage of 95 % intervals", rich.coverage, least=0.9, most=0.99),
        Goal("median closure relative to the oracle", rich.relative_closure, least=0.9),
        Goal("median overlap with the true map", rich.maps.overlap, least=0.6),
        Goal("plants resolved by the recommended over a random experiment, any excitation", experiments, least=2.0),
        Goal("single sine: candidate sets that hold the cause", covers, least=0.9),
    )
