"""Justified certainty of a diagnosis: calibration of its probabilities, coverage of its intervals."""

from collections.abc import Sequence

import numpy as np

from mrd_trials.records import Explanation
from mrd_trials.scoring.plant_result import PlantResult, PlantResults
from mrd_trials.scoring.rates import Calibration, Rate, calibration

Claim = tuple[PlantResult, Explanation]


def claims_of_causes(results: PlantResults) -> list[Claim]:
    """Return every cause that is named."""
    return [(result, cause) for result in results for cause in result.submission.causes]


def claims_of_first_candidates(results: PlantResults) -> list[Claim]:
    """Return the first candidate of every plant without a named cause."""
    return [
        (result, result.submission.candidates[0]) for result in results if not result.named and result.submission.candidates
    ]


def calibration_of(claims: Sequence[Claim]) -> Calibration:
    """Compute the calibration of claims; those without a probability, or of what the form contains, are left out."""
    usable = [
        (result, claim)
        for result, claim in claims
        if np.isfinite(claim.probability) and not set(claim.effects) & (result.not_wrong - result.true_causes)
    ]
    probability = np.clip([claim.probability for _, claim in usable], 0.0, 1.0).astype(float)
    right = np.array([result.true_causes.issuperset(claim.effects) for result, claim in usable], dtype=bool)
    return calibration(probability, right)


def coverage_by_effect(claims: Sequence[Claim]) -> dict[str, Rate]:
    """Return how often the 95 % intervals of rightly named causes hold the true sizes, by effect."""
    outcomes: dict[str, list[bool]] = {}
    for result, cause in claims:
        for name, ends in cause.sizes.items():
            effect = name.partition(".")[0]
            if effect in result.true_causes and name in result.truth.sizes and np.isfinite(ends).all():
                outcomes.setdefault(effect, []).append(bool(ends[1] <= result.truth.sizes[name] <= ends[2]))
    return {effect: Rate.from_outcomes(outcomes[effect]) for effect in sorted(outcomes)}
