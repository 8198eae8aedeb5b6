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
    """Return the share (R²) of what an effect changes that others change alike, each fitted in its place, by name.

    The changes are those of the white error, the model's own parameters fitted with each effect. Their sizes do not count:
    where no formula is exact, one of two look-alikes may be fitted much larger than the other. So R² is the squared cosine
    of the angle between both changes, and 0 where they are opposite.
    """
    if NO_EFFECT not in refits:
        return {}
    common = refits[NO_EFFECT].problem

    def white(refitted: Refit) -> Array:
        return common.counted(refitted.problem.errors(refitted.theta))

    without = white(refits[NO_EFFECT])

    def direction(name: str) -> Array:
        """Return the change with its length taken out; zeros where there is none, or none that is finite."""
        change = white(refits[name]) - without
        largest = float(np.abs(change).max())
        if not 0.0 < largest < np.inf:
            return np.zeros_like(change)
        scaled = change / largest
        return np.asarray(scaled / np.linalg.norm(scaled))

    of_effect = direction(effect)
    return {name: max(float(of_effect @ direction(name)), 0.0) ** 2 for name in refits if name != effect and name in EFFECTS}


def class_name(effects: Sequence[str]) -> str:
    """Return what effects have in common, as a clause; empty where they have nothing in common."""
    symptoms = {EFFECTS[effect].symptom if effect in EFFECTS else "" for effect in effects}
    return symptoms.pop() if len(symptoms) == 1 else ""
