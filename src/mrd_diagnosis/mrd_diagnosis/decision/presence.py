"""Presence: the probability that a class of effects is there, as evidence of it was right for dampers that were known.

The weights are those of a logistic regression, and none has the sign that physics forbids. They stand in `presence.json`
with the trials from which they were learnt; `ros2 run mrd_trials learn` makes this file.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from mrd_diagnosis.evidence.evidence import EVIDENCE

Array = NDArray[np.float64]

COVERAGE = 0.9
"""Share of the plausible sets that hold the true effect, where their class is right."""

LEAST_SUM = 1e-300
"""Sum of probabilities that stands for none, so that all quotients are finite."""

FILE = Path(__file__).with_name("presence.json")


@dataclass(frozen=True)
class PresenceModel:
    """Weights of the evidence.

    Attributes
    ----------
    intercept : float
        Log odds where all evidence is 0.
    weights : mapping
        Change of the log odds by one unit of each piece of evidence, by name.
    deviations : mapping
        Standard deviation of each number among the plants from which they were learnt.
    set_share : float
        Share of the probability of all effects in a place that a set of them must have to hold the true one as often as
        `COVERAGE` says, where the class is right (split conformal; Vovk, Gammerman & Shafer, 2005).
    card : mapping
        Where the weights come from, and how far they were right on dampers that were left out.
    """

    intercept: float
    weights: Mapping[str, float]
    deviations: Mapping[str, float]
    set_share: float
    card: Mapping[str, Any]

    def probability(self, evidence: Mapping[str, float]) -> float:
        """Return the probability of presence from the evidence by name."""
        return float(expit(self.intercept + sum(weight * evidence[name] for name, weight in self.weights.items())))


@cache
def presence_model() -> PresenceModel:
    """Return the model that is shipped."""
    return PresenceModel(**json.loads(FILE.read_text(encoding="utf-8")))


def presence_of(evidence: Mapping[str, float]) -> float:
    """Return the probability that the class of an effect is there, from its evidence by name."""
    return presence_model().probability(evidence)


def with_presence(table: Mapping[str, float], members: Sequence[str], presence: float) -> dict[str, float]:
    """Return the probability of each effect in a place where its class has a known one.

    Members of the class share it as they do in the table. Other effects keep their probability, as long as the sum stays
    one; what is left is that of no effect.

    Parameters
    ----------
    table : mapping
        Probability of each effect, and of none (""), by name.
    members : sequence of str
        The class.
    presence : float
    """
    of_class = sum(table[name] for name in members)
    others = {name: probability for name, probability in table.items() if name and name not in members}
    left = min(1.0, (1.0 - presence) / max(sum(others.values()), LEAST_SUM))
    shares = {name: presence * table[name] / of_class if of_class > 0.0 else presence / len(members) for name in members}
    return shares | {name: left * probability for name, probability in others.items()}


def plausible_set(probabilities: Mapping[str, float]) -> tuple[str, ...]:
    """Return the effects among which the cause is in nine of ten cases where its class is right, likeliest first.

    Parameters
    ----------
    probabilities : mapping
        Probability of each effect in its place by name.
    """
    ranked = sorted(probabilities, key=lambda name: -probabilities[name])
    return tuple(ranked[: 1 + int(np.sum(cumulative_shares(probabilities)[:-1] < presence_model().set_share))])


def cumulative_shares(probabilities: Mapping[str, float]) -> Array:
    """Return the share (effects,) of the probability that the likeliest effects have together: one, two, ..."""
    ordered = np.sort(list(probabilities.values()))[::-1]
    return np.asarray(np.cumsum(ordered) / max(ordered.sum(), LEAST_SUM))


def markdown_table() -> str:
    """Return evidence and weights as the table that stands in `docs/diagnosis.md`."""
    model = presence_model()
    rows = ["| evidence | meaning | weight |", "|---|---|---|"]
    rows += [
        f"| `{entry.name}` | {entry.meaning} | {model.weights[entry.name] * model.deviations[entry.name]:+.2f} |"
        if entry.name in model.weights
        else f"| `{entry.name}` | {entry.meaning} | not learnt yet |"
        for entry in EVIDENCE
    ]
    return "\n".join(rows) + "\n"
