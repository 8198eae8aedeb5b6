"""The score of a trial: all figures, by tier."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mrd_base import InputError
from mrd_trials.excitation import BLACK_BOX, SEMIREAL
from mrd_trials.records import Evaluation, GroundTruth, Submission
from mrd_trials.scoring.methods import MethodRates, compare_methods
from mrd_trials.scoring.plant_result import PlantResult, select
from mrd_trials.scoring.rates import Distribution
from mrd_trials.scoring.tier_score import TierScore
from mrd_trials.scoring.verdict_counts import Counts, count_confusion, count_verdicts, excitations

SHOWN = 0.2
"""Share of the gap of the untouched recordings from which an effect that closes it by itself is shown by them, too."""


@dataclass(frozen=True)
class TrialScore:
    """Score of the diagnosis in a trial.

    Attributes
    ----------
    plants : int
    tiers : mapping
        The figures of each tier by its excitation; ``rich`` is always there.
    confusion : Counts
        Ground truth by what was named first, of the rich excitation.
    verdicts : Counts
        Kind of plant by verdict, of every excitation.
    methods : tuple of MethodRates
        The diagnosis first, then the baseline methods; of the rich excitation.
    seconds : Distribution
        Duration of the diagnosis of each plant.
    failures : mapping
        Error by plant.
    """

    plants: int
    tiers: Mapping[str, TierScore]
    confusion: Counts
    verdicts: Counts
    methods: tuple[MethodRates, ...]
    seconds: Distribution
    failures: Mapping[str, str]

    @property
    def has_rich(self) -> bool:
        """Whether there are simulated plants of rich excitation."""
        return self.tiers["rich"].plants > 0


def score_trial(
    answers: Mapping[str, GroundTruth],
    submissions: Mapping[str, Submission],
    evaluations: Mapping[str, Evaluation],
    around: Sequence[Mapping[str, Submission]] = (),
) -> TrialScore:
    """Score the submissions on plants.

    Parameters
    ----------
    answers, submissions, evaluations : mapping
        By plant. A plant without submission counts as failed; evaluations may be missing.
    around : sequence of mapping
        Further submissions by plant, around one damper model after the other.

    Raises
    ------
    InputError
        When there are no plants, a submission is on an unknown plant, or the causes of a plant do not fit its kind.
    """
    _check(answers, submissions, evaluations)
    results = [_result_of(truth, submissions, evaluations) for truth in answers.values()]
    by_tier = {name: select(results, excitation=name) for name in excitations(results)}
    rich = by_tier["rich"]
    return TrialScore(
        plants=len(results),
        tiers={name: TierScore.from_results(of_tier, around) for name, of_tier in by_tier.items()},
        confusion=count_confusion(rich),
        verdicts=count_verdicts(results),
        methods=compare_methods(rich),
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


def _result_of(
    truth: GroundTruth, submissions: Mapping[str, Submission], evaluations: Mapping[str, Evaluation]
) -> PlantResult:
    """Return a plant with its background, which only recordings have that are compared with nothing.

    Without a verdict on the untouched recordings, nobody knows what the names on the others are worth: they count as failed.
    The simulator of a black box has the damper's own form, so that nothing which the form contains is in the gap.
    """
    plant = truth.plant
    submission = submissions.get(plant, Submission(plant, "failed", "no submission"))
    result = PlantResult(truth, submission, evaluations.get(plant, Evaluation(plant)))
    if truth.excitation == BLACK_BOX:
        return replace(result, truth=replace(truth, implied=()))
    if truth.excitation != SEMIREAL or not truth.background:
        return result
    untouched = submissions.get(truth.background)
    if untouched is None or untouched.verdict == "failed":
        failure = submission.failure or f"no verdict on the same recordings without the effects, {truth.background}"
        return replace(result, submission=Submission(plant, "failed", failure))
    shown = [entry for entry in untouched.candidates if len(entry.effects) == 1 and entry.closed_fraction[0] >= SHOWN]
    return replace(
        result,
        background=frozenset(name for cause in untouched.causes for name in (*cause.effects, *cause.members)),
        shown=frozenset(entry.effects[0] for entry in shown),
    )
