"""A plant with the answer, what was said of it, and what one who knows found."""

from collections.abc import Sequence
from dataclasses import dataclass

from mrd_trials.records import Answer, Insight, Submission

DETECTABLE = 3.0
"""Signal to floor from which on an effect should be found."""

LIKELY = 0.05
"""Probability from which on a candidate belongs to the set that a diagnosis leaves open."""

_NAMING = ("explained", "ambiguous")


@dataclass(frozen=True)
class Case:
    """A plant with all that is kept of it."""

    answer: Answer
    submission: Submission
    insight: Insight

    @property
    def failed(self) -> bool:
        return self.submission.verdict == "failed"

    @property
    def claimed(self) -> tuple[str, ...]:
        """Every effect that is given as a cause, whatever the verdict: what can be wrong."""
        return tuple(effect for cause in self.submission.causes for effect in cause.effects)

    @property
    def named(self) -> tuple[str, ...]:
        """Effects that the answer consists of, first what is likely to close most: what can be right."""
        return self.claimed if self.submission.verdict in _NAMING else ()

    @property
    def ranking(self) -> tuple[str, ...]:
        """What is named, then all candidates, best first."""
        tried = [effect for candidate in self.submission.candidates for effect in candidate.effects]
        return tuple(dict.fromkeys([*self.named, *tried]))

    @property
    def detectable(self) -> bool:
        return self.answer.signal_to_floor > DETECTABLE

    @property
    def truth(self) -> frozenset[str]:
        return frozenset(self.answer.causes)

    def group(self, cause: str) -> frozenset[str]:
        """Effects as good as ``cause`` on these runs: as one who knows the answer found, or else as was claimed."""
        if cause in self.insight.alike:
            return frozenset({cause, *self.insight.alike[cause]})
        said = self.submission.causes + self.submission.candidates
        claimed = [effect for one in said if cause in one.alike for effect in one.effects]
        return frozenset({cause, *claimed})

    @property
    def groups(self) -> frozenset[str]:
        return frozenset[str]().union(*(self.group(cause) for cause in self.answer.causes))

    @property
    def left_open(self) -> frozenset[str]:
        """The set that the diagnosis leaves open: causes, what it says acts alike, likely ones, what it cannot test."""
        causes = self.submission.causes
        likely = [
            one
            for one in self.submission.candidates
            if one.probability > LIKELY or not set(self.claimed).isdisjoint(one.alike)
        ]
        return frozenset(
            [*self.submission.untestable, *(effect for one in (*causes, *likely) for effect in (*one.effects, *one.alike))]
        )


Cases = Sequence[Case]
