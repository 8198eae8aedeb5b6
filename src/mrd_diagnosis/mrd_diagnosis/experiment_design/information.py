"""Information that an experiment is expected to give about which of several explanations is true."""

import itertools
from collections.abc import Mapping

import numpy as np

from mrd_diagnosis.experiment_design.separation import Pair, Separation

DISCOUNTS = (1.0, 0.1, 0.01, 0.001)
"""Factors of the predicted squared distances over which the information is averaged. What explanations predict for a run
that is not recorded yet is inexact, so that the experiment is better whose answer is clear with a large margin.
"""


def expected_information(probabilities: Mapping[str, float], separations: Mapping[Pair, Separation]) -> float:
    """Return a lower bound in nats of the information that an experiment gives about which explanation is true.

    What a run shows is a mixture of what the explanations predict, each with its probability. Its entropy is bounded by the
    pairwise Bhattacharyya distances of the predictions (Kolchinsky & Tracey 2017, eq. 10), which are an eighth of the
    squared distances, since the predictions have the same errors. Explanations that an experiment does not separate give
    nothing; a certain answer is worth the entropy of the probabilities. The bound is averaged over `DISCOUNTS`.

    Parameters
    ----------
    probabilities : mapping
        Probability of each explanation by name, before the experiment. Their sum does not count.
    separations : mapping
        For each pair of them.
    """
    names = list(probabilities)
    probability = np.array([probabilities[name] for name in names], dtype=float)
    total = probability.sum()
    probability = probability / total if total > 0.0 else np.full(len(names), 1.0 / len(names))
    distances = np.zeros((len(names), len(names)))
    for (first, name), (second, other) in itertools.combinations(enumerate(names), 2):
        separation = separations.get((name, other)) or separations[other, name]
        distances[first, second] = distances[second, first] = separation.tempered_squared_distance / 8.0
    possible = probability > 0.0
    mixed = [np.exp(-discount * distances) @ probability for discount in DISCOUNTS]
    return max(0.0, float(np.mean([-np.sum(probability[possible] * np.log(of_all[possible])) for of_all in mixed])))
