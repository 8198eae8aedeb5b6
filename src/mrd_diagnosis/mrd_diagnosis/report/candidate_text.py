"""Text about a candidate for the page, its chart and the terminal."""

from typing import NamedTuple

import numpy as np

from mrd_diagnosis.diagnosis import Candidate, Diagnosis
from mrd_diagnosis.report.sentences import found_several, what_was_found
from mrd_diagnosis.wording.effect_names import effect_names
from mrd_diagnosis.wording.quantities import format_error, format_p_value, format_probability, format_share

LEAST_SHOWN = 0.005
"""Share of the gap that rounds to 0 %."""


class CandidateText(NamedTuple):
    """The columns of a table of candidates, without the name of the candidate."""

    probability: str
    removed: str
    error: str
    p_value: str
    remark: str


def describe_candidate(diagnosis: Diagnosis, candidate: Candidate) -> CandidateText:
    """Return the columns of a table of candidates."""
    return CandidateText(
        format_probability(candidate_probability(diagnosis, candidate)),
        format_share(candidate.closed_fraction),
        format_error(candidate.nrmse),
        format_p_value(candidate.p_value),
        _remark(diagnosis, candidate),
    )


def ordered_candidates(diagnosis: Diagnosis) -> list[Candidate]:
    """Return the candidates as tables show them: those with several effects, then by probability if shown, then by the
    share of the gap that they remove.
    """

    def key(candidate: Candidate) -> tuple[bool, float, float]:
        probability = candidate_probability(diagnosis, candidate) if with_probabilities(diagnosis) else 0.0
        # Probabilities that read the same count as the same.
        return len(candidate.effects) == 1, -round(probability, 2), -float(np.nan_to_num(candidate.closed_fraction.value))

    return sorted(diagnosis.candidates, key=key)


def nothing_removes(diagnosis: Diagnosis) -> bool:
    """Whether no candidate removes as much of the gap as a table in whole per cent can show."""
    return not any(candidate.closed_fraction.value >= LEAST_SHOWN for candidate in diagnosis.candidates)


def _remark(diagnosis: Diagnosis, candidate: Candidate) -> str:
    if diagnosis.verdict == "partly_explained":
        if {cause.effect for cause in diagnosis.causes}.issuperset(candidate.effects):
            return "named as a cause"
        if any((other.effect,) == candidate.effects for other in diagnosis.alternatives):
            return "an alternative to a cause"
        return "not proven around other damper models" if candidate.closed_fraction.lower > LEAST_SHOWN else ""
    if candidate.indistinguishable:
        return f"fits nearly as well as {effect_names(candidate.indistinguishable)}"
    likely = {cause.effect for cause in diagnosis.causes} | {alternative.effect for alternative in diagnosis.alternatives}
    if (
        with_probabilities(diagnosis)
        and not likely.intersection(candidate.effects)
        and candidate.closed_fraction.lower > LEAST_SHOWN
    ):
        return f"imitates {what_was_found(diagnosis)}, which {'remove' if found_several(diagnosis) else 'removes'} more"
    return ""


def with_probabilities(diagnosis: Diagnosis) -> bool:
    """Whether to show probabilities of candidates.

    Without a gap there is no cause, and with an unknown effect none of the candidates is the cause, so that a probability
    would mislead there. With a partly explained gap, only the causes and their alternatives have one: they were compared
    around several damper models, the candidates around one. What is seen but not determined has none either.
    """
    return diagnosis.verdict in ("explained", "ambiguous") and bool(diagnosis.causes)


def candidate_probability(diagnosis: Diagnosis, candidate: Candidate) -> float:
    """Return the probability that a candidate is the cause, or one of the causes.

    An alternative to one of several causes has the probability that the table of alternatives states.
    """
    alternatives = [other.probability for other in diagnosis.alternatives if (other.effect,) == candidate.effects]
    return max([candidate.probability, *alternatives])
