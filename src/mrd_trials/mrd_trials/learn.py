"""Learn how evidence combines to a probability, from trials whose answers are open.

A logistic regression with a quadratic penalty, whose weights must not have the sign that physics forbids. Each kind of plant
counts as much as it does in the standard trial, however many of it there are: what a cause has for it depends on how many
dampers lack nothing, or something that the catalogue lacks too. How far the probabilities are right is measured on dampers
that were left out, each with all its plants.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from mrd_base import InputError
from mrd_diagnosis.decision.presence import COVERAGE, PresenceModel, cumulative_shares, with_presence
from mrd_diagnosis.evidence.evidence import EVIDENCE
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_trials.excitation import SEMIREAL
from mrd_trials.records import GroundTruth, Submission, WeighedEffect
from mrd_trials.trial_design import SHARES

Array = NDArray[np.float64]

PENALTIES = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
"""Penalties of the squared weights that are tried; weights are those of evidence of standard deviation one."""

LEAST_ROWS = 20
"""Rows of either kind, right and wrong, below which nothing is learnt."""


@dataclass(frozen=True)
class Row:
    """An effect that was weighed on a plant.

    Attributes
    ----------
    damper : str
        Form of the plant's damper, or the measured damper.
    weighed : WeighedEffect
    causes : frozenset of str
        True causes of the plant.
    plants : tuple of str
        Excitation and kind of the plant.
    """

    damper: str
    weighed: WeighedEffect
    causes: frozenset[str]
    plants: tuple[str, str]

    @property
    def right(self) -> bool:
        """Whether its class holds a true cause."""
        return not self.causes.isdisjoint(self.weighed.members)


def rows_of(answers: Mapping[str, GroundTruth], submissions: Mapping[str, Submission]) -> list[Row]:
    """Return every effect that was weighed and is known to be right or wrong.

    Nobody knows which effects are in measured recordings that are untouched. So what was weighed there counts neither there
    nor on the same recordings with an effect. Neither does what the form of a simulated damper contains.
    """
    rows = []
    for plant, submission in submissions.items():
        truth = answers[plant]
        causes = frozenset(truth.causes)
        unknown = set(truth.implied)
        measured = truth.excitation == SEMIREAL
        if measured and truth.background:
            untouched = submissions.get(truth.background)
            if untouched is None or untouched.verdict == "failed":
                continue
            unknown |= {name for entry in untouched.weighed for name in entry.members}
            unknown |= {name for cause in untouched.causes for name in (*cause.effects, *cause.members)}
        for entry in submission.weighed:
            if not (measured and truth.kind == "null") and unknown.isdisjoint(entry.members):
                rows.append(Row(truth.base, entry, causes, (truth.excitation, truth.kind)))
    return rows


def plants_of(answers: Mapping[str, GroundTruth], submissions: Mapping[str, Submission]) -> Counter[tuple[str, str]]:
    """Return how many plants were diagnosed, by excitation and kind."""
    return Counter((answers[plant].excitation, answers[plant].kind) for plant in submissions)


def learn(rows: Sequence[Row], plants: Mapping[tuple[str, str], int], trials: Sequence[Mapping[str, Any]]) -> PresenceModel:
    """Fit the weights, and measure on left-out dampers how far they are right.

    Parameters
    ----------
    rows : sequence of Row
    plants : mapping
        How many plants were diagnosed, by excitation and kind, those without rows included.
    trials : sequence of mapping
        The recipes of their trials, for the model card.

    Raises
    ------
    InputError
        When there are too few rows to learn from.
    """
    right = np.array([row.right for row in rows], dtype=bool)
    if min(right.sum(), (~right).sum()) < LEAST_ROWS:
        raise InputError(
            f"found {right.sum()} right and {(~right).sum()} wrong effects with evidence, expected {LEAST_ROWS} of each at "
            "least; make larger trials"
        )
    if len({row.damper for row in rows}) < 2:
        raise InputError("found plants of one form of damper only, expected several: each is left out in turn")
    names = [entry.name for entry in EVIDENCE]
    evidence = np.array([[row.weighed.evidence[name] for name in names] for row in rows])
    dampers = np.array([row.damper for row in rows])
    counts = np.array([_count(row, plants) for row in rows])
    left_out = {penalty: _left_out(evidence, right, counts, dampers, names, penalty) for penalty in PENALTIES}
    penalty = min(PENALTIES, key=lambda value: _log_loss(left_out[value], right, counts))
    probability = left_out[penalty]
    intercept, weights = _fit(evidence, right, counts, names, penalty)
    mean = float(np.average(right, weights=counts))
    named = probability >= THRESHOLDS.least_probability
    card = {
        "trials": list(trials),
        "plants": {f"{excitation}, {kind}": number for (excitation, kind), number in sorted(plants.items())},
        "effects weighed": len(rows),
        "of them right": int(right.sum()),
        "dampers": sorted(set(dampers.tolist())),
        "penalty": penalty,
        "left out by damper": {
            "log loss": round(_log_loss(probability, right, counts), 3),
            "log loss of the mean alone": round(_log_loss(np.full(len(right), mean), right, counts), 3),
            "named": int(named.sum()),
            "named and right": int((named & right).sum()),
            "right and not named": int((~named & right).sum()),
        },
    }
    return PresenceModel(
        round(intercept, 4),
        _rounded(names, weights),
        _rounded(names, evidence.std(axis=0)),
        round(set_share(rows, probability), 4),
        card,
    )


def set_share(rows: Sequence[Row], presence: Array) -> float:
    """Return the share of the probability that sets of effects must have to hold the true one as often as `COVERAGE`.

    Split conformal prediction (Vovk, Gammerman & Shafer, 2005): the quantile, over rows whose class is right, of the share
    that the effects before the true one have together; 1 where it was not tried in its place.

    Parameters
    ----------
    rows : sequence of Row
    presence : ndarray (rows,)
        Probability of the class of each.
    """
    before = []
    for row, probability in zip(rows, presence, strict=True):
        if not row.right:
            continue
        probabilities = with_presence(row.weighed.table, row.weighed.members, float(probability))
        ranked = sorted(probabilities, key=lambda name: -probabilities[name])
        places = [ranked.index(cause) for cause in row.causes if cause in probabilities]
        shares = cumulative_shares(probabilities)
        before.append((shares[min(places) - 1] if min(places) else 0.0) if places else 1.0)
    rank = min(int(np.ceil((len(before) + 1) * COVERAGE)), len(before))
    # A set is complete once it has more than the share before the effect that belongs to it as the last one.
    return min(float(np.sort(before)[rank - 1]) + 1e-4, 1.0)


def _count(row: Row, plants: Mapping[tuple[str, str], int]) -> float:
    """Return how many plants with its excitation the standard trial would have of its kind, per plant that was diagnosed."""
    excitation, kind = row.plants
    total = sum(number for (of, _), number in plants.items() if of == excitation)
    return SHARES[kind] * total / plants[row.plants]


def _left_out(
    evidence: Array, right: NDArray[np.bool_], counts: Array, dampers: NDArray[Any], names: Sequence[str], penalty: float
) -> Array:
    """Return the probability of each row from weights that were fitted without its damper."""
    probability = np.empty(len(right))
    for damper in np.unique(dampers):
        out = dampers == damper
        intercept, weights = _fit(evidence[~out], right[~out], counts[~out], names, penalty)
        probability[out] = expit(intercept + evidence[out] @ weights)
    return probability


def _fit(
    evidence: Array, right: NDArray[np.bool_], counts: Array, names: Sequence[str], penalty: float
) -> tuple[float, Array]:
    """Return intercept and weights of the penalised regression."""
    mean, deviation = evidence.mean(axis=0), evidence.std(axis=0) + 1e-9
    scaled = (evidence - mean) / deviation
    sign = np.where(right, 1.0, -1.0)

    def cost(theta: Array) -> tuple[float, Array]:
        margin = sign * (theta[0] + scaled @ theta[1:])
        pull = -sign * counts * expit(-margin)
        value = float(counts @ np.logaddexp(0.0, -margin) + 0.5 * penalty * theta[1:] @ theta[1:])
        return value, np.concatenate([[pull.sum()], scaled.T @ pull + penalty * theta[1:]])

    against = {entry.name for entry in EVIDENCE if entry.against}
    bounds = [(None, None), *((None, 0.0) if name in against else (0.0, None) for name in names)]
    theta = minimize(cost, np.zeros(1 + len(names)), jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = theta[1:] / deviation
    return float(theta[0] - mean @ weights), weights


def _log_loss(probability: Array, right: NDArray[np.bool_], counts: Array) -> float:
    bounded = np.clip(probability, 1e-6, 1.0 - 1e-6)
    return float(-np.average(np.where(right, np.log(bounded), np.log(1.0 - bounded)), weights=counts))


def _rounded(names: Sequence[str], values: Array) -> dict[str, float]:
    return {name: round(float(value), 4) for name, value in zip(names, values, strict=True)}
