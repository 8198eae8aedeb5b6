"""A plant with its ground truth, the submission on it, and the evaluation of that submission."""

from collections.abc import Sequence
from dataclasses import dataclass

from mrd_trials.records import Evaluation, GroundTruth, Submission
from mrd_trials.trial_design import is_detectable

LIKELY = 0.05
"""Probability above which a candidate belongs to the candidate set: a set of 95 % leaves out what is less likely."""


@dataclass(frozen=True)
class PlantResult:
    """A plant with all that is stored of it."""

    truth: GroundTruth
    submission: Submission
    evaluation: Evaluation

    @property
    def failed(self) -> bool:
        """Whether the diagnosis came to no verdict."""
        return self.submission.verdict == "failed"

    @property
    def named(self) -> tuple[str, ...]:
        """All effects that are given as causes, whatever the verdict, the one that is likely to close most first."""
        return tuple(effect for cause in self.submission.causes for effect in cause.effects)

    @property
    def ranking(self) -> tuple[str, ...]:
        """The named effects, then all candidates, best first."""
        candidates = [effect for candidate in self.submission.candidates for effect in candidate.effects]
        return tuple(dict.fromkeys([*self.named, *candidates]))

    @property
    def detectable(self) -> bool:
        """Whether the effects are strong enough to be found."""
        return is_detectable(self.truth)

    @property
    def true_causes(self) -> frozenset[str]:
        """Effects that should be named."""
        return frozenset(self.truth.causes)

    @property
    def false_alarm(self) -> bool:
        """Whether something wrong is named, or the diagnosis failed."""
        return self.failed or not self.not_wrong.issuperset(self.named)

    @property
    def not_wrong(self) -> frozenset[str]:
        """The true causes, and the effects that the damper's form contains."""
        return self.true_causes.union(self.truth.implied)

    @property
    def abstains(self) -> bool:
        """Whether an unknown effect is claimed and nothing is named, or the diagnosis failed."""
        return self.failed or (self.submission.verdict == "unknown_effect" and not self.named)

    def equivalents_of(self, cause: str) -> frozenset[str]:
        """Effects that are as good an answer as ``cause`` on these runs: as evaluated, or else as submitted."""
        if cause in self.evaluation.equivalents:
            return frozenset({cause, *self.evaluation.equivalents[cause]})
        explanations = self.submission.causes + self.submission.candidates
        claimed = [effect for entry in explanations if cause in entry.indistinguishable for effect in entry.effects]
        return frozenset({cause, *claimed})

    @property
    def right_answers(self) -> frozenset[str]:
        """The true causes and their equivalents."""
        return frozenset[str]().union(*(self.equivalents_of(cause) for cause in self.truth.causes))

    @property
    def candidate_set(self) -> frozenset[str]:
        """Effects left open: causes, likely candidates, what is indistinguishable from these, and untestable effects."""
        likely = [
            candidate
            for candidate in self.submission.candidates
            if candidate.probability > LIKELY or not set(self.named).isdisjoint(candidate.indistinguishable)
        ]
        explanations = (*self.submission.causes, *likely)
        effects = [effect for entry in explanations for effect in (*entry.effects, *entry.indistinguishable)]
        return frozenset([*self.submission.untestable, *effects])


PlantResults = Sequence[PlantResult]


def select(results: PlantResults, **fields: object) -> list[PlantResult]:
    """Return the results whose ground truth has these values of its fields."""
    return [result for result in results if all(getattr(result.truth, name) == value for name, value in fields.items())]


def has_first(order: Sequence[str], count: int, right: frozenset[str]) -> bool:
    """Whether one of the right effects is among the first ``count`` of an order."""
    return not right.isdisjoint(order[:count])
