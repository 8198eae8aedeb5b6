"""Rates at which the right effects are named. What is named is a class of effects that look alike, often of one effect."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from mrd_trials.records import Explanation, GroundTruth
from mrd_trials.scoring.plant_result import PlantResult, PlantResults, members_of, select
from mrd_trials.scoring.rates import Distribution, Rate

LOST = ("not weighed", "in a table, but not first", "less than half by its evidence", "rejected after that")
"""These are the steps at which a diagnosis may lose a cause, in their order. A change is never weighed, so that the first
step loses it."""


@dataclass(frozen=True)
class ClassRates:
    """Rates of what is named; only plants count of which anybody knows what is right.

    Attributes
    ----------
    right : Rate
        Detectable plants with one effect that have it in a class that is named.
    lost : mapping
        By where they were lost (`LOST`): detectable plants with one effect, of those that have it in no class that is named.
    cause : Rate
        Detectable plants with one effect that is named by itself or first of its class.
    effect : Rate
        Names of one effect by itself that are right.
    both : Rate
        Detectable plants with two effects that have each in a class of its own that is named.
    wrong : Rate
        Plants with effects on which something is named that has none of them, or whose diagnosis failed.
    wrong_unshown : Rate
        The same without what the untouched recordings show as well.
    absent : Rate
        The same as ``wrong`` of plants with an effect that the catalogue lacks.
    null : Rate
        Plants without effects on which something is named, or whose diagnosis failed. Nobody knows whether that is wrong on
        untouched recordings that are compared with nothing.
    undivided : Rate
        Names that end at a class or at a stage.
    members : Distribution
        Number of effects in what is named.
    covered : Rate
        Names whose class is right that have a cause in their stated set, of 90 %.
    covered_named : Rate
        Detectable plants with one effect and something named, right or wrong, that have the effect in one of these sets.
    set_sizes : Distribution
        Number of effects in these sets.
    """

    right: Rate
    lost: Mapping[str, Rate]
    cause: Rate
    effect: Rate
    both: Rate
    wrong: Rate
    wrong_unshown: Rate
    absent: Rate
    null: Rate
    undivided: Rate
    members: Distribution
    covered: Rate
    covered_named: Rate
    set_sizes: Distribution

    @classmethod
    def from_results(cls, results: PlantResults) -> "ClassRates":
        """Count plants."""
        counted = [result for result in results if result.counts]
        altered = [result for result in counted if result.truth.kind != "null"]
        detectable = [result for result in counted if result.detectable]
        singles = select(detectable, kind="single")
        claims = [(result, claim, right) for result in counted for claim, right in result.claims]
        named = [claim for _, claim, _ in claims]
        missed = [result for result in singles if not result.names_causes]
        return cls(
            right=Rate.from_outcomes([result.names_causes for result in singles]),
            lost={place: Rate.from_outcomes([lost_at(result) == place for result in missed]) for place in LOST},
            cause=Rate.from_outcomes([result.truth.causes[0] in result.named for result in singles]),
            effect=Rate.from_outcomes([right for _, claim, right in claims if claim.level == "effect"]),
            both=Rate.from_outcomes([result.names_causes for result in select(detectable, kind="pair")]),
            wrong=Rate.from_outcomes([result.names_wrong for result in altered]),
            wrong_unshown=Rate.from_outcomes(
                [replace(result, background=result.background | result.shown).names_wrong for result in altered]
            ),
            absent=Rate.from_outcomes([result.names_wrong for result in select(altered, kind="absent")]),
            null=Rate.from_outcomes([result.names_wrong for result in select(results, kind="null")]),
            undivided=Rate.from_outcomes([claim.level != "effect" for claim in named]),
            members=Distribution(tuple(float(len(members_of(claim))) for claim in named)),
            covered=Rate.from_outcomes(
                [
                    bool(result.judge(claim.plausible))
                    for result, claim, _ in claims
                    if result.judge(_class_of(result, claim))
                ]
            ),
            covered_named=Rate.from_outcomes(
                [any(result.judge(claim.plausible) for claim, _ in result.claims) for result in singles if result.claims]
            ),
            set_sizes=Distribution(tuple(float(len(claim.plausible)) for claim in named)),
        )


def lost_at(result: PlantResult) -> str:
    """Return where a diagnosis lost the only effect of a plant, one of `LOST`."""
    (cause,), weighed = result.truth.causes, result.submission.weighed
    if led := [entry.probability for entry in weighed if cause in (entry.effect, *entry.members)]:
        return LOST[2] if max(led) < 0.5 else LOST[3]
    return LOST[1] if any(cause in entry.table for entry in weighed) else LOST[0]


def _class_of(result: PlantResult, claim: Explanation) -> tuple[str, ...]:
    """Return the class of what is named, also where one effect stands for it, as far as it is known."""
    weighed = (entry.members for entry in result.submission.weighed if entry.effect in claim.effects)
    return next(weighed, tuple(members_of(claim)))


@dataclass(frozen=True)
class Stratum:
    """Rate at which the right class is named on plants with one effect that have something in common.

    Attributes
    ----------
    factor, name : str
        What they have in common: ``effect`` and ``backlash``, for instance.
    right : Rate
    """

    factor: str
    name: str
    right: Rate


def strata_of(results: PlantResults) -> tuple[Stratum, ...]:
    """Return the rates by strength of all plants with one effect, and by effect, damper and rate of the detectable ones."""
    singles = [result for result in select(results, kind="single") if result.counts]
    detectable = [result for result in singles if result.detectable]
    factors: list[tuple[str, PlantResults, Callable[[GroundTruth], str], Callable[[GroundTruth], Any]]] = [
        ("strength", singles, lambda truth: truth.stratum, lambda truth: truth.signal_to_floor),
        ("effect", detectable, lambda truth: truth.causes[0], lambda truth: truth.causes),
        ("damper", detectable, lambda truth: truth.base, lambda truth: truth.base),
        ("rate", detectable, lambda truth: f"{truth.rate:.3g} Hz", lambda truth: truth.rate),
    ]
    return tuple(
        Stratum(factor, name, Rate.from_outcomes([result.names_causes for result in among if label(result.truth) == name]))
        for factor, among, label, order in factors
        for name in dict.fromkeys(label(truth) for truth in sorted((result.truth for result in among), key=order))
    )
