"""Text about a candidate for the page, its chart and the terminal."""

from typing import NamedTuple

from mrd_diagnosis.diagnosis import Candidate, Diagnosis
from mrd_diagnosis.effect_names import effect_names
from mrd_diagnosis.quantities import format_error, format_probability, format_share


class CandidateText(NamedTuple):
    """The columns of a table of candidates, without the name of the candidate."""

    probability: str
    removed: str
    error: str
    p_value: str
    remark: str


def describe_candidate(diagnosis: Diagnosis, candidate: Candidate) -> CandidateText:
    """Return the columns of a table of candidates."""
    similar = effect_names(candidate.indistinguishable)
    return CandidateText(
        format_probability(candidate_probability(diagnosis, candidate)),
        format_share(candidate.closed_fraction),
        format_error(candidate.nrmse),
        f"{candidate.p_value:.3f}",
        f"fits nearly as well as {similar}" if similar else "",
    )


def with_probabilities(diagnosis: Diagnosis) -> bool:
    """Whether to show probabilities of candidates.

    Without a gap there is no cause, and with an unknown effect none of the candidates is the cause, so that a probability
    would mislead there.
    """
    return diagnosis.verdict in ("explained", "ambiguous")


def candidate_probability(diagnosis: Diagnosis, candidate: Candidate) -> float:
    """Return the probability that a candidate is the cause, or one of the causes.

    An alternative to one of several causes has the probability that the table of alternatives states.
    """
    alternatives = [other.probability for other in diagnosis.alternatives if (other.effect,) == candidate.effects]
    return max([candidate.probability, *alternatives])
