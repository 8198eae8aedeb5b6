"""A plant with its ground truth, the submission on it, and the evaluation of that submission."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import permutations

from mrd_trials.excitation import SEMIREAL
from mrd_trials.records import Evaluation, Explanation, GroundTruth, Submission
from mrd_trials.trial_design import is_detectable


@dataclass(frozen=True)
class PlantResult:
    """A plant with all that is stored of it.

    Attributes
    ----------
    truth : GroundTruth
    submission : Submission
    evaluation : Evaluation
    background : frozenset of str
        What is named on the same recordings without the effects, by itself or in a class: nobody knows whether it is there.
    shown : frozenset of str
        Effects that close much of the gap of those recordings, named or not.
    """

    truth: GroundTruth
    submission: Submission
    evaluation: Evaluation
    background: frozenset[str] = frozenset()
    shown: frozenset[str] = frozenset()

    @property
    def failed(self) -> bool:
        """Whether the diagnosis came to no verdict."""
        return self.submission.verdict == "failed"

    @property
    def detectable(self) -> bool:
        """Whether the effects are strong enough to be found."""
        return is_detectable(self.truth)

    @property
    def counts(self) -> bool:
        """Whether anybody knows what is right: not on untouched recordings, nor where their background has a cause."""
        is_untouched = self.truth.excitation == SEMIREAL and self.truth.kind == "null"
        return not is_untouched and self.background.isdisjoint(self.truth.causes)

    def judge(self, effects: Iterable[str]) -> bool | None:
        """Return whether one of some effects is a cause; None where it is neither right nor wrong to name them.

        It is neither where they hold no cause, but something of the background, or of what the damper's form contains.
        """
        if not set(self.truth.causes).isdisjoint(effects):
            return True
        return False if self.background.union(self.truth.implied).isdisjoint(effects) else None

    @property
    def claims(self) -> list[tuple[Explanation, bool]]:
        """What is named, each effect or class with whether it is right; without what is neither right nor wrong."""
        judged = [(claim, self.judge(members_of(claim))) for claim in self.submission.causes]
        return [(claim, right) for claim, right in judged if right is not None]

    @property
    def names_causes(self) -> bool:
        """Whether every cause is in what is named, each in an effect or a class of its own."""
        named = [members_of(claim) for claim in self.submission.causes]
        causes = self.truth.causes
        return any(
            all(cause in members for cause, members in zip(causes, chosen, strict=True))
            for chosen in permutations(named, len(causes))
        )

    @property
    def names_wrong(self) -> bool:
        """Whether something wrong is named, or the diagnosis failed."""
        return self.failed or not all(right for _, right in self.claims)

    def judged(self, order: Iterable[str]) -> list[str]:
        """Return the effects of an order that are right or wrong."""
        return [effect for effect in order if self.judge([effect]) is not None]

    @property
    def named(self) -> list[str]:
        """Effects that are named by themselves or first of their class, whatever the verdict, best first."""
        return self.judged(effect for cause in self.submission.causes for effect in cause.effects)

    @property
    def ranking(self) -> list[str]:
        """The named effects, then all candidates, best first."""
        candidates = self.judged(effect for entry in self.submission.candidates for effect in entry.effects)
        return list(dict.fromkeys([*self.named, *candidates]))


PlantResults = Sequence[PlantResult]


def members_of(claim: Explanation) -> Sequence[str]:
    """Return the effects of which one is said to be the cause."""
    return claim.members or claim.effects


def select(results: PlantResults, **fields: object) -> list[PlantResult]:
    """Return the results whose ground truth has these values of its fields."""
    return [result for result in results if all(getattr(result.truth, name) == value for name, value in fields.items())]
