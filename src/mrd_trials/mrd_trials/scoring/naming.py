"""Rates at which the right effects are named: single effects, pairs, candidate sets, and baseline methods in comparison."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from mrd_trials.records import GroundTruth
from mrd_trials.scoring.plant_result import PlantResult, PlantResults, has_first, select
from mrd_trials.scoring.rates import Distribution, Rate


@dataclass(frozen=True)
class NamingRates:
    """Rates at which the cause of a plant with one effect comes first.

    Attributes
    ----------
    factor, stratum : str
        Which of the plants: ``effect`` and ``backlash``, for instance.
    named, named_equivalent : Rate
        The cause, or one of its equivalents, is the first of the named effects.
    ranked, ranked_equivalent, ranked_three : Rate
        The cause or an equivalent is the first, or the cause is among the first three, of the named effects and candidates.
    """

    factor: str
    stratum: str
    named: Rate
    named_equivalent: Rate
    ranked: Rate
    ranked_equivalent: Rate
    ranked_three: Rate

    @classmethod
    def from_results(cls, factor: str, stratum: str, results: PlantResults) -> "NamingRates":
        """Count the plants of a stratum."""
        return cls(
            factor,
            stratum,
            named=Rate.from_outcomes([has_first(result.named, 1, result.true_causes) for result in results]),
            named_equivalent=Rate.from_outcomes([has_first(result.named, 1, result.right_answers) for result in results]),
            ranked=Rate.from_outcomes([has_first(result.ranking, 1, result.true_causes) for result in results]),
            ranked_equivalent=Rate.from_outcomes([has_first(result.ranking, 1, result.right_answers) for result in results]),
            ranked_three=Rate.from_outcomes([has_first(result.ranking, 3, result.true_causes) for result in results]),
        )


def naming_by_stratum(results: PlantResults) -> tuple[NamingRates, ...]:
    """Return the rates of plants with one effect by signal to floor, effect, rate and form; the last three if detectable."""
    singles = select(results, kind="single")
    detectable = [result for result in singles if result.detectable]
    factors: list[tuple[str, PlantResults, Callable[[GroundTruth], str], Callable[[GroundTruth], Any]]] = [
        ("signal to floor", singles, lambda truth: truth.stratum or "below 1", lambda truth: truth.signal_to_floor),
        ("effect", detectable, lambda truth: truth.causes[0], lambda truth: truth.causes),
        ("rate", detectable, lambda truth: f"{truth.rate:g} Hz", lambda truth: truth.rate),
        (
            "damper",
            detectable,
            lambda truth: "another form" if truth.perturbed else "fitted form",
            lambda truth: truth.perturbed,
        ),
    ]
    return tuple(
        NamingRates.from_results(factor, stratum, [result for result in among if label(result.truth) == stratum])
        for factor, among, label, order in factors
        for stratum in dict.fromkeys(label(truth) for truth in sorted((result.truth for result in among), key=order))
    )


@dataclass(frozen=True)
class PairRates:
    """Rates at which the causes of plants with two effects are named.

    Attributes
    ----------
    both, both_equivalent, both_detectable : Rate
        Both causes are named; or two equivalents of them; both, where the signal to floor is detectable.
    precision, recall : Rate
        Rightly named causes, of all named ones and of all that there are.
    """

    both: Rate
    both_equivalent: Rate
    both_detectable: Rate
    precision: Rate
    recall: Rate

    @classmethod
    def from_results(cls, results: PlantResults) -> "PairRates":
        """Count plants with two effects."""
        right = sum(len(result.true_causes.intersection(result.named)) for result in results)
        detectable = [result for result in results if result.detectable]
        return cls(
            both=Rate.from_outcomes([result.true_causes.issubset(result.named) for result in results]),
            both_equivalent=Rate.from_outcomes([_names_two_equivalents(result) for result in results]),
            both_detectable=Rate.from_outcomes([result.true_causes.issubset(result.named) for result in detectable]),
            precision=Rate(right, sum(len(result.named) for result in results)),
            recall=Rate(right, sum(len(result.true_causes) for result in results)),
        )

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; nan without pairs."""
        total = self.precision.total + self.recall.total
        return 2 * self.precision.hits / total if total else float("nan")


def _names_two_equivalents(result: PlantResult) -> bool:
    """Whether two different named effects stand for the two causes."""
    first, second = (result.equivalents_of(cause) for cause in result.truth.causes)
    return any(a in first and b in second for a in result.named for b in result.named if a != b)


@dataclass(frozen=True)
class CandidateSetRates:
    """Candidate sets of plants with one detectable effect.

    Attributes
    ----------
    covers : Rate
        The set holds the cause, or an unknown effect is claimed, which excludes nothing.
    holds_cause : Rate
        The set holds the cause.
    size : Distribution
    named_wrong : Rate
        The first named effect is no right answer: more is claimed than the runs can tell.
    """

    covers: Rate
    holds_cause: Rate
    size: Distribution
    named_wrong: Rate

    @classmethod
    def from_results(cls, results: PlantResults) -> "CandidateSetRates":
        """Count plants with one detectable effect."""
        holds = [result.true_causes.issubset(result.candidate_set) for result in results]
        unknown = [result.submission.verdict == "unknown_effect" for result in results]
        return cls(
            covers=Rate.from_outcomes([a or b for a, b in zip(holds, unknown, strict=True)]),
            holds_cause=Rate.from_outcomes(holds),
            size=Distribution(tuple(float(len(result.candidate_set)) for result in results if not result.failed)),
            named_wrong=Rate.from_outcomes(
                [bool(result.named) and not has_first(result.named, 1, result.right_answers) for result in results]
            ),
        )


@dataclass(frozen=True)
class MethodRates:
    """A method that ranks effects: first places on detectable single effects, false alarms on plants without effect.

    The total of ``false_alarms`` is 0 for a method that can give none.
    """

    method: str
    first: Rate
    equivalent_first: Rate
    first_three: Rate
    false_alarms: Rate


def compare_methods(results: PlantResults) -> tuple[MethodRates, ...]:
    """Compare the diagnosis, which comes first, with the baseline methods on the plants on which these were run."""
    compared = [result for result in results if result.evaluation.rankings or result.failed]
    singles = [result for result in select(compared, kind="single") if result.detectable]
    nulls = select(compared, kind="null")

    def rates(method: str, order: Callable[[PlantResult], Sequence[str]], false_alarms: Rate) -> MethodRates:
        return MethodRates(
            method,
            first=Rate.from_outcomes([has_first(order(result), 1, result.true_causes) for result in singles]),
            equivalent_first=Rate.from_outcomes([has_first(order(result), 1, result.right_answers) for result in singles]),
            first_three=Rate.from_outcomes([has_first(order(result), 3, result.true_causes) for result in singles]),
            false_alarms=false_alarms,
        )

    def baseline(method: str) -> MethodRates:
        def order(result: PlantResult) -> Sequence[str]:
            return result.evaluation.rankings.get(method, ())

        # "" comes first where the method prefers no effect.
        return rates(method, order, Rate.from_outcomes([result.failed or any(order(result)[:1]) for result in nulls]))

    methods = dict.fromkeys(method for result in results for method in result.evaluation.rankings)
    return (
        rates("diagnosis, named", lambda result: result.named, Rate.from_outcomes([result.false_alarm for result in nulls])),
        rates("diagnosis, ranked", lambda result: result.ranking, Rate(0, 0)),
        *(baseline(method) for method in methods),
    )
