"""Classes of causes: effects that imitate each other in the given recordings, and what can be said of them together.

A delay of the force channel and a lag of its sensor change most recordings alike. Which effects do so is a property of the
recordings: it is computed from the effects fitted in each other's place, and not listed.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import Member
from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_diagnosis.fitting.weighting import sum_of_squares
from mrd_diagnosis.search.model_comparison import NO_EFFECT
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_sim.effects import EFFECTS

Array = NDArray[np.float64]


def class_of(effect: str, refits: Mapping[str, Refit], probabilities: Mapping[str, float]) -> tuple[Member, ...]:
    """Return the effects among which recordings do not decide: ``effect`` first, then those that imitate it.

    Parameters
    ----------
    effect : str
        The most probable one.
    refits : mapping
        Refits by name: with the effect, with another one in its place, and with none (`NO_EFFECT`).
    probabilities : mapping
        Their probabilities by name.
    """
    alike = imitations(effect, refits)
    members = [
        name
        for name, probability in sorted(probabilities.items(), key=lambda item: -item[1])
        if name != effect
        and name in EFFECTS
        and probability >= THRESHOLDS.listed_probability
        and alike.get(name, 0.0) >= THRESHOLDS.least_imitation
    ]
    return tuple(
        Member(
            name,
            float(probabilities[name]),
            alike.get(name, 1.0),
            {key: value for key, value in effect_parameters(refits[name]).items() if key.startswith(f"{name}.")},
        )
        for name in [effect, *members]
    )


def imitations(effect: str, refits: Mapping[str, Refit]) -> dict[str, float]:
    """Return the share that others, each fitted in the place of an effect, close alike of what the effect closes or they do,
    whichever is more, by name.

    What counts of each is the direction in which it changes the white error, the model's own parameters fitted with it. What
    both close is what either does by itself, less what they do together. Sizes do not count: where no formula is exact, one
    of two look-alikes may be fitted much larger than the other.
    """
    if NO_EFFECT not in refits:
        return {}
    common = refits[NO_EFFECT].problem

    def white(refitted: Refit) -> Array:
        return common.counted(refitted.problem.errors(refitted.theta))

    without = white(refits[NO_EFFECT])
    change = white(refits[effect]) - without
    if not np.isfinite(change).all():
        return {}
    closed = _explained(without, [change])
    if not 0.0 < closed < np.inf:
        return {}

    def share(other: Array) -> float:
        if not np.isfinite(other).all():
            return 0.0
        closed_by_other = _explained(without, [other])
        alike = closed + closed_by_other - _explained(without, [change, other])
        return float(np.clip(np.nan_to_num(alike / max(closed, closed_by_other)), 0.0, 1.0))

    others = [name for name in refits if name != effect and name in EFFECTS]
    return {name: share(white(refits[name]) - without) for name in others}


def _explained(error: Array, directions: Sequence[Array]) -> float:
    """Return how much of the sum of squares of an error (n,) directions (n,) explain together."""
    matrix = np.stack(directions, axis=1)
    return sum_of_squares(matrix @ np.linalg.lstsq(matrix, error)[0])


def class_name(effects: Sequence[str]) -> str:
    """Return what effects have in common, as a clause; empty where they have nothing in common."""
    symptoms = {EFFECTS[effect].symptom if effect in EFFECTS else "" for effect in effects}
    return symptoms.pop() if len(symptoms) == 1 else ""
