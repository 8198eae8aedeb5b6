"""Where the error lies in words, and whether the named causes would show there."""

from collections.abc import Sequence

from mrd_diagnosis.diagnosis import Diagnosis, Interval, Region
from mrd_diagnosis.localisation.axis_bins import NEAR_LABELS, PLACES, near_label
from mrd_diagnosis.wording.effect_names import effect_name, effect_names
from mrd_diagnosis.wording.quantities import capitalised, format_share, join_words
from mrd_sim.effects import EFFECTS, Place
from mrd_sim.effects import PLACES as WHERE

NEARLY_ALL = 0.95
"""Share of the error from which a reader calls it nearly all."""

NEARLY_ALL_OSCILLATES = 0.85
"""Share from which a reader calls an oscillation nearly all of the error."""

FRACTIONS = [
    (1 / 3, "a third of", "lies"),
    (1 / 2, "half of", "lies"),
    (2 / 3, "two thirds of", "lie"),
    (3 / 4, "three quarters of", "lie"),
    (9 / 10, "nine tenths of", "lie"),
]
"""Fractions that have a name, with the verb after them."""

WIDTH_OF_FRACTION = 0.03
"""Difference from a named fraction up to which a share is called by its name."""

LEAST_LIFT = 1.3
"""Lift from which a place is named: what has hardly more of the error than of the samples tells nobody where to look."""

LEAST_DENSITY = 0.5
"""Lift of a bin over that of the bins before it, from the event on, from which it belongs to one place with them."""

AS_DENSE = 0.9
"""Part of share and lift of a time that one run has, from which the place is the run, which was recorded at that time."""


def where_sentence(diagnosis: Diagnosis, error: str = "the error") -> str:
    """Return where most of the error lies; empty where no place of the recordings has significantly more than the others."""
    oscillation, place = diagnosis.oscillation, _named_place(diagnosis)
    there = _share_clause(place, error) if place else ""
    if oscillation is None:
        return f"{capitalised(there)}." if there else ""
    share = oscillation.share.value
    much = f"{'Nearly all' if share > NEARLY_ALL_OSCILLATES else 'Most'} of {error}"
    also = f", and {there}" if there else ""
    return f"{much} ({format_share(share)}) is {oscillation.label}{also}."


def _named_place(diagnosis: Diagnosis) -> Region | None:
    """Return the place that `where_sentence` names; beside an oscillation, only one that has most of the error."""
    place = headline_place(diagnosis.where)
    is_named = place is not None and (diagnosis.oscillation is None or place.share.value > 0.5)
    return place if is_named else None


def place_sentence(where: Sequence[Region], error: str = "the error") -> str:
    """Return where most of an error lies; empty where no place has significantly more than the others."""
    place = headline_place(where)
    return f"{capitalised(_share_clause(place, error))}." if place else ""


def headline_place(where: Sequence[Region]) -> Region | None:
    """Return the place that a headline names: the significant one on the axes of `PLACES` in which the error is densest.

    On an axis that counts from an event, significant bins from the event on are taken together, without a thin tail.
    """
    significant = [region for region in where if region.axis in PLACES and region.significant]
    places = [region for region in significant if region.lift >= LEAST_LIFT]
    if not places:
        return None
    first = places[0]
    if first.axis == "time":
        runs = [region for region in places if region.axis == "run"]
        first = next((run for run in runs if _is_as_dense(run, first)), first)
    if first.axis not in NEAR_LABELS:
        return first
    bins = sorted((region for region in where if region.axis == first.axis), key=lambda region: region.lower)
    together: list[Region] = []
    for region in bins[:-1]:
        if not region.significant or (together and region.lift < LEAST_DENSITY * _joined(together).lift):
            break
        together.append(region)
    return _joined(together) if first in together else first


def agreement_sentence(diagnosis: Diagnosis) -> str:
    """Return whether the error lies where causes and alternatives must show; empty where these may show anywhere.

    An effect contradicts the place only where there is no more error in any place where it must show than elsewhere.
    """
    headline = _named_place(diagnosis)
    if headline is None and diagnosis.oscillation is None:
        return ""
    as_it: list[str] = []
    there: list[str] = []
    sentences: list[str] = []
    explanations = [cause.effect for cause in diagnosis.causes] + [other.effect for other in diagnosis.alternatives]
    for effect in dict.fromkeys(explanations):
        places = EFFECTS[effect].shows if effect in EFFECTS else ()
        near = [region for region in diagnosis.where if region.axis in places and not _is_away(region, diagnosis.where)]
        found = [region for region in near if region.significant]
        if "frequency" in places and diagnosis.oscillation is not None:
            as_it.append(effect)
        elif headline is not None and headline.axis in {region.axis for region in found}:
            there.append(effect)
        elif found:
            among = _in_words([place for place in places if place in {region.axis for region in found}], "and")
            sentences.append(f"The error is also larger {among}, where {effect_name(effect)} must show.")
        elif near and all(region.lift <= 1.0 for region in near):
            name = capitalised(effect_name(effect))
            sentences.append(f"{name} would show {_in_words(places, 'or')}, and the error lies elsewhere.")
    agreeing = [
        f"That is {word} {effect_names(effects)} must show."
        for word, effects in (("how", as_it), ("where", there))
        if effects
    ]
    return " ".join([*agreeing, *sentences])


def share_in_words(share: float) -> tuple[str, str]:
    """Return a share before what it is a share of, such as "three quarters of", and the verb "lies" or "lie" after that."""
    if share >= NEARLY_ALL:
        return "nearly all of", "lies"
    value, words, verb = min(FRACTIONS, key=lambda fraction: abs(fraction[0] - share))
    if abs(value - share) <= WIDTH_OF_FRACTION:
        return words, verb
    return f"{format_share(share)} of", "lies"


def _share_clause(place: Region, error: str) -> str:
    """Return how much of the error lies in a place, and how many of the samples."""
    much, verb = share_in_words(place.share.value)
    samples = place.share.value / place.lift
    part = format_share(samples) if samples >= 0.005 else "less than 1 %"
    return f"{much} {error} {verb} {_at(place)}, which is {part} of the samples"


def _joined(regions: Sequence[Region]) -> Region:
    """Return neighbouring bins from an event on as one; the interval and q-value are those of the first."""
    first, last = regions[0], regions[-1]
    if first is last:
        return first
    share = min(sum(region.share.value for region in regions), 1.0)
    samples = sum(region.share.value / region.lift for region in regions)
    label = near_label(first.axis, last.upper)
    return Region(first.axis, first.lower, last.upper, first.unit, Interval(share), share / samples, first.q_value, label)


def _is_as_dense(run: Region, time: Region) -> bool:
    return run.share.value > AS_DENSE * time.share.value and run.lift > AS_DENSE * time.lift


def _is_away(region: Region, where: Sequence[Region]) -> bool:
    """Whether a bin is where no effect shows: the one away from an event, or that of the lowest accelerations."""
    of_axis = [other for other in where if other.axis == region.axis]
    if region.axis == "acceleration":
        return region.lower == min(other.lower for other in of_axis)
    return region.axis in NEAR_LABELS and region.upper == max(other.upper for other in of_axis)


def _in_words(places: Sequence[Place], last: str) -> str:
    return join_words([WHERE[place] for place in places], last)


def _at(place: Region) -> str:
    """Return the label of one of the `PLACES` after "lies"."""
    if place.axis == "run" or place.label.startswith("the "):
        return f"in {place.label}"
    return f"at {place.label}" if place.axis == "position" else place.label
