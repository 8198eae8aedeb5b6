"""Rates at which the right class of effects is named, where the recordings do not decide between effects that look alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mrd_trials.records import Explanation
from mrd_trials.scoring.plant_result import PlantResult, PlantResults
from mrd_trials.scoring.rates import Distribution, Rate

LOST = ("not weighed", "in a table, but not first", "less than half by its evidence", "rejected after that")
"""These are the steps at which a diagnosis may lose a cause, in their order. A change is never weighed, so that the first
step loses it."""


@dataclass(frozen=True)
class ClassRates:
    """Rates of what is named, counted by classes. An effect that is named by itself is a class of one.

    Attributes
    ----------
    right : Rate
        Detectable plants with one effect that have it in a class that is named.
    both : Rate
        Detectable plants with two effects that have each in a class that is named.
    lost : mapping
        By where they were lost (`LOST`): detectable plants with one effect, of those that have it in no class that is named.
    wrong : Rate
        Plants with something named that has none of their effects, or whose diagnosis failed.
    effect : Rate
        Names of one effect by itself that are right.
    undivided : Rate
        Names that end at a class or at a stage.
    members : Distribution
        Number of effects in what is named.
    covered : Rate
        Detectable plants with one effect and something named that have it in one of the stated sets, of 90 %.
    set_sizes : Distribution
        Number of effects in these sets.
    """

    right: Rate
    both: Rate
    lost: Mapping[str, Rate]
    wrong: Rate
    effect: Rate
    undivided: Rate
    members: Distribution
    covered: Rate
    set_sizes: Distribution

    @classmethod
    def from_results(cls, results: PlantResults, not_counted: Mapping[str, frozenset[str]] | None = None) -> "ClassRates":
        """Count plants; effects that are named without reason to know are ``not_counted``, by plant."""
        claims = {
            result.truth.plant: _claims(result, (not_counted or {}).get(result.truth.plant, frozenset()))
            for result in results
        }
        detectable = [result for result in results if result.detectable]

        def holds_all(result: PlantResult) -> bool:
            classes = [frozenset(members_of(claim)) for claim in claims[result.truth.plant]]
            return all(any(cause in members for members in classes) for cause in result.truth.causes)

        def is_wrong(result: PlantResult) -> bool:
            named = claims[result.truth.plant]
            return result.failed or any(result.not_wrong.isdisjoint(members_of(claim)) for claim in named)

        missed = [result for result in detectable if result.truth.kind == "single" and not holds_all(result)]
        every = [(result, claim) for result in results for claim in claims[result.truth.plant]]
        alone = [(result, claim) for result, claim in every if claim.level == "effect"]
        return cls(
            right=Rate.from_outcomes([holds_all(result) for result in detectable if result.truth.kind == "single"]),
            both=Rate.from_outcomes([holds_all(result) for result in detectable if result.truth.kind == "pair"]),
            lost={place: Rate.from_outcomes([lost_at(result) == place for result in missed]) for place in LOST},
            wrong=Rate.from_outcomes([is_wrong(result) for result in results]),
            effect=Rate.from_outcomes([not result.not_wrong.isdisjoint(claim.effects) for result, claim in alone]),
            undivided=Rate.from_outcomes([claim.level != "effect" for _, claim in every]),
            members=Distribution(tuple(float(len(members_of(claim))) for _, claim in every)),
            covered=Rate.from_outcomes(
                [
                    any(result.truth.causes[0] in claim.plausible for claim in claims[result.truth.plant])
                    for result in detectable
                    if result.truth.kind == "single" and claims[result.truth.plant]
                ]
            ),
            set_sizes=Distribution(tuple(float(len(claim.plausible)) for _, claim in every)),
        )


def lost_at(result: PlantResult) -> str:
    """Return where a diagnosis lost the only effect of a plant, one of `LOST`."""
    (cause,), weighed = result.truth.causes, result.submission.weighed
    if led := [entry.probability for entry in weighed if cause in (entry.effect, *entry.members)]:
        return LOST[2] if max(led) < 0.5 else LOST[3]
    return LOST[1] if any(cause in entry.table for entry in weighed) else LOST[0]


def members_of(claim: Explanation) -> Sequence[str]:
    """Return the effects of which one is said to be the cause."""
    return claim.members or claim.effects


def _claims(result: PlantResult, not_counted: frozenset[str]) -> list[Explanation]:
    return [claim for claim in result.submission.causes if not_counted.isdisjoint(claim.effects)]
