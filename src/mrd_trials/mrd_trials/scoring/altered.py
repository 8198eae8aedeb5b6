"""Scores on measured recordings into which effects were put.

What the diagnosis says of the untouched recordings is the background: nobody knows which effects are in them. A name that it
also gives to the untouched recordings counts neither for nor against it. Where it compares recordings with earlier ones,
there is no background: whatever it names without a change is wrong.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mrd_trials.excitation import BEFORE_AFTER
from mrd_trials.scoring.classes import ClassRates
from mrd_trials.scoring.gap import places_found
from mrd_trials.scoring.plant_result import PlantResult, PlantResults, select
from mrd_trials.scoring.rates import Calibration, Distribution, Rate, calibration

SHOWN = 0.2
"""Share of the gap of the untouched recordings from which an effect that closes it by itself is shown by them, too."""


@dataclass(frozen=True)
class AlteredResult:
    """A plant of measured recordings, and what the diagnosis names on the same recordings without the effects."""

    result: PlantResult
    background: frozenset[str]

    @property
    def named(self) -> tuple[str, ...]:
        """What is named beyond the background."""
        return tuple(effect for effect in self.result.named if effect not in self.background)

    @property
    def counts(self) -> bool:
        """Whether the causes can be found at all: none of them belongs to the background."""
        return self.background.isdisjoint(self.result.truth.causes)

    @property
    def names_causes(self) -> bool:
        """Whether all causes are named."""
        return self.result.true_causes.issubset(self.named)

    @property
    def names_wrong(self) -> bool:
        """Whether something else is named, or the diagnosis failed."""
        return self.result.failed or not self.result.true_causes.issuperset(self.named)


@dataclass(frozen=True)
class AlteredScore:
    """The figures of one tier of measured recordings.

    Attributes
    ----------
    plants : int
    single, detectable : Rate
        Plants with one effect whose cause is named, whatever the verdict: all, and the detectable ones.
    equivalent : Rate
        The same with what the diagnosis itself says cannot be told from what it names, of the detectable ones.
    not_counted : int
        Plants whose cause is also named on the untouched recordings.
    pair : Rate
        Plants with two effects of which both are named.
    wrong : Rate
        Plants with effects on which something wrong is named, beyond the background.
    wrong_absent : Rate
        The same of plants with an effect that the catalogue lacks.
    untouched : Rate
        Untouched recordings on which something is named: wrong where they are compared with earlier ones, else nobody knows.
    calibration : Calibration
        Of every name beyond the background.
    closed : Distribution
        Share of the added error that is closed on fresh runs, beyond what is closed without it; the oracle closes 1.
    by_strength, by_effect : mapping
        Plants with one effect whose cause is named; by effect, the detectable ones.
    wrong_unshown : Rate
        Plants with effects on which a wrong class is named, beyond the background and beyond what the untouched recordings
        show as well (`SHOWN`).
    places : Rate
        Diagnoses that say where a large error lies.
    classes : ClassRates
        The same by classes, beyond the background: of plants with effects whose cause does not belong to it.
    """

    plants: int
    single: Rate
    detectable: Rate
    equivalent: Rate
    not_counted: int
    pair: Rate
    wrong: Rate
    wrong_absent: Rate
    untouched: Rate
    calibration: Calibration
    closed: Distribution
    by_strength: Mapping[str, Rate]
    by_effect: Mapping[str, Rate]
    wrong_unshown: Rate
    places: Rate
    classes: ClassRates

    @classmethod
    def from_results(cls, results: PlantResults) -> "AlteredScore":
        """Compute the figures of the plants of one tier."""
        by_plant = {result.truth.plant: result for result in results}
        untouched = select(results, kind="null")
        altered = [AlteredResult(result, _background(result, by_plant)) for result in results if result.truth.kind != "null"]
        counted = [entry for entry in altered if entry.counts]
        singles = [entry for entry in counted if entry.result.truth.kind == "single"]
        detectable = [entry for entry in singles if entry.result.detectable]
        return cls(
            plants=len(results),
            single=_named(singles),
            detectable=_named(detectable),
            equivalent=Rate.from_outcomes(
                [bool(entry.result.right_answers.intersection(entry.named)) for entry in detectable]
            ),
            not_counted=len(altered) - len(counted),
            pair=_named([entry for entry in counted if entry.result.truth.kind == "pair"]),
            wrong=Rate.from_outcomes([entry.names_wrong for entry in altered]),
            wrong_absent=Rate.from_outcomes([entry.names_wrong for entry in altered if entry.result.truth.kind == "absent"]),
            untouched=Rate.from_outcomes([result.failed or bool(result.named) for result in untouched]),
            calibration=_calibration(altered, untouched),
            closed=Distribution.of_finite(
                entry.result.evaluation.fresh_closure
                for entry in counted
                if entry.result.detectable and entry.result.truth.kind in ("single", "pair")
            ),
            by_strength=_named_by(singles, lambda entry: entry.result.truth.stratum),
            by_effect=_named_by(detectable, lambda entry: entry.result.truth.causes[0]),
            wrong_unshown=ClassRates.from_results(
                [entry.result for entry in counted],
                {entry.result.truth.plant: entry.background | _shown(entry.result, by_plant) for entry in counted},
            ).wrong,
            places=places_found(results),
            classes=ClassRates.from_results(
                [entry.result for entry in counted], {entry.result.truth.plant: entry.background for entry in counted}
            ),
        )


def _background(result: PlantResult, by_plant: Mapping[str, PlantResult]) -> frozenset[str]:
    """Return what is named on the same recordings without the effects; nothing where they are compared with earlier ones."""
    if result.truth.excitation == BEFORE_AFTER or result.truth.background not in by_plant:
        return frozenset()
    return frozenset(by_plant[result.truth.background].named)


def _shown(result: PlantResult, by_plant: Mapping[str, PlantResult]) -> frozenset[str]:
    """Return the effects that close much of the gap of the same recordings without the effects, whether named or not."""
    if result.truth.excitation == BEFORE_AFTER or result.truth.background not in by_plant:
        return frozenset()
    candidates = by_plant[result.truth.background].submission.candidates
    return frozenset(
        entry.effects[0] for entry in candidates if len(entry.effects) == 1 and entry.closed_fraction[0] >= SHOWN
    )


def _named(entries: Sequence[AlteredResult]) -> Rate:
    return Rate.from_outcomes([entry.names_causes for entry in entries])


def _named_by(entries: Sequence[AlteredResult], label: Callable[[AlteredResult], str]) -> dict[str, Rate]:
    return {name: _named([entry for entry in entries if label(entry) == name]) for name in sorted(set(map(label, entries)))}


def _calibration(altered: Sequence[AlteredResult], untouched: PlantResults) -> Calibration:
    """Compute the calibration of every name beyond the background; a name on an unchanged comparison is a wrong one."""
    compared = [AlteredResult(result, frozenset()) for result in untouched if result.truth.excitation == BEFORE_AFTER]
    claims = [
        (cause.probability, entry.result.true_causes.issuperset(cause.effects))
        for entry in (*altered, *compared)
        for cause in entry.result.submission.causes
        if entry.background.isdisjoint(cause.effects) and np.isfinite(cause.probability)
    ]
    probabilities = np.clip([probability for probability, _ in claims], 0.0, 1.0).astype(float)
    return calibration(probabilities, np.array([right for _, right in claims], dtype=bool))
