"""Causes: the effects of an explanation, and what the recordings determine of each."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mrd_diagnosis.closure.closure import closed_fraction_between
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.decision.presence import plausible_set
from mrd_diagnosis.diagnosis import Cause, Interval, Level, Member
from mrd_diagnosis.evidence.cause_class import class_of
from mrd_diagnosis.fitting.statistics import effect_parameters
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_sim.effects import EFFECTS


def name_causes(explanation: Explanation, rng: np.random.Generator) -> tuple[Cause, ...]:
    """Return the effects of an explanation as causes; first the one that is likely to close most.

    One that was judged around other forms has the share of the gap that it closes there, any other the one that it adds to
    those before it.
    """
    if explanation.verdict in ("no_gap", "unknown_effect"):
        return ()
    comparison, probabilities = explanation.comparison, explanation.probabilities
    steps = [comparison.base, *comparison.chain]
    parameters = effect_parameters(comparison.best)
    causes = []
    for index, effect in enumerate(comparison.effects):
        robust = explanation.robust.get(effect)
        own = {name: value for name, value in parameters.items() if name.startswith(f"{effect}.")}
        members = robust.members if robust else class_of(effect, comparison.alternatives[effect], probabilities[effect])
        members = tuple(replace(member, parameters=own) if member.effect == effect else member for member in members)
        step = (steps[index], steps[index + 1])
        closed = robust.closed_fraction if robust else closed_fraction_between(*step, comparison, rng)
        causes.append(
            Cause(
                effect,
                float(probabilities[effect][effect]),
                explanation.p_values[effect],
                closed,
                own,
                level_of(effect, members, probabilities[effect], beside_wrong_form=robust is not None),
                members,
                plausible_set({name: probability for name, probability in probabilities[effect].items() if name in EFFECTS}),
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.probability * float(np.nan_to_num(cause.closed_fraction.value))))


def with_intervals_of_all_forms(cause: Cause, explanation: Explanation) -> Cause:
    """Return a cause with intervals of its parameters that hold those around other forms as well: nobody knows the right
    form of the damper.
    """
    robust = explanation.robust.get(cause.effect)
    forms = robust.parameters_by_form if robust else ()
    parameters = {
        name: replace(estimate, value=_around([estimate.value, *(form[name].value for form in forms if name in form)]))
        for name, estimate in cause.parameters.items()
    }
    return replace(cause, parameters=parameters)


def _around(intervals: Sequence[Interval]) -> Interval:
    """Return the first of intervals, as wide as all together; as it is where one of them has no ends."""
    lower, upper = (float(end) for end in (min(i.lower for i in intervals), max(i.upper for i in intervals)))
    finite = all(np.isfinite([interval.lower, interval.upper]).all() for interval in intervals)
    return Interval(intervals[0].value, lower, upper) if finite else intervals[0]


def level_of(
    effect: str, members: tuple[Member, ...], probabilities: Mapping[str, float], beside_wrong_form: bool = False
) -> Level:
    """Return what can be said of a cause: the effect, its class, its stage, or nothing.

    The effect is named where it is alone in its class or clearly the likeliest one of it; the class where it is likelier
    than all other effects together; the stage where the effects that act in it are.
    """
    of_class = sum(member.probability for member in members)
    needed = THRESHOLDS.least_probability * sum(probability for name, probability in probabilities.items() if name)
    if of_class >= needed:
        share = THRESHOLDS.sole_share if beside_wrong_form else THRESHOLDS.named_probability
        clear = members[0].probability >= share * of_class
        return "effect" if clear else "class"
    stage = EFFECTS[effect].stage
    of_stage = sum(
        probability for name, probability in probabilities.items() if name in EFFECTS and EFFECTS[name].stage == stage
    )
    return "stage" if of_stage >= needed else "undecided"
