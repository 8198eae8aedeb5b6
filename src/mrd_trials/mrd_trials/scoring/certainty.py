"""Justified certainty of a diagnosis: calibration of its probabilities, coverage of its intervals."""

from collections.abc import Iterable

import numpy as np

from mrd_trials.learn import rows_of
from mrd_trials.scoring.plant_result import PlantResults
from mrd_trials.scoring.rates import Calibration, Rate, calibration


def calibration_of_names(results: PlantResults) -> Calibration:
    """Compute the calibration of what is named, each effect or class with the probability that is stated of it."""
    claims = [claim for result in results if result.counts for claim in result.claims]
    return _calibration((claim.claimed_probability, right) for claim, right in claims)


def calibration_of_presence(results: PlantResults) -> Calibration:
    """Compute the calibration of the classes that were weighed by their evidence, named or not."""
    answers = {result.truth.plant: result.truth for result in results}
    rows = rows_of(answers, {result.truth.plant: result.submission for result in results})
    return _calibration((row.weighed.probability, row.right) for row in rows)


def _calibration(claims: Iterable[tuple[float, bool]]) -> Calibration:
    """Compute the calibration of claims, of those that have a probability."""
    usable = [(probability, right) for probability, right in claims if np.isfinite(probability)]
    probabilities = np.clip([probability for probability, _ in usable], 0.0, 1.0).astype(float)
    return calibration(probabilities, np.array([right for _, right in usable], dtype=bool))


def coverage_by_effect(results: PlantResults) -> dict[str, Rate]:
    """Return how often the 95 % intervals of rightly named causes hold the true sizes, by effect."""
    outcomes: dict[str, list[bool]] = {}
    for truth, cause in ((result.truth, cause) for result in results for cause in result.submission.causes):
        for name, ends in cause.sizes.items():
            effect = name.partition(".")[0]
            if effect in truth.causes and name in truth.sizes and np.isfinite(ends).all():
                outcomes.setdefault(effect, []).append(bool(ends[1] <= truth.sizes[name] <= ends[2]))
    return {effect: Rate.from_outcomes(outcomes[effect]) for effect in sorted(outcomes)}
