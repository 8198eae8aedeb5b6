"""Whether diagnoses of the same plants around several damper models find the same causes."""

from collections.abc import Iterable, Mapping, Sequence

from mrd_trials.excitation import BLACK_BOX
from mrd_trials.records import GroundTruth, Submission
from mrd_trials.scoring.plant_result import members_of
from mrd_trials.scoring.rates import Rate
from mrd_trials.trial_design import is_detectable


def found_around_all(answers: Iterable[GroundTruth], by_model: Sequence[Mapping[str, Submission]]) -> Rate:
    """Return the share of detectable causes that are in a class that is named around every model, of those around any.

    Counted are plants with one effect that have a verdict around each model. A black box is diagnosed around no model.

    Parameters
    ----------
    answers : iterable of GroundTruth
    by_model : sequence of mapping
        Submissions by plant, around one model after the other.
    """
    outcomes = []
    for truth in answers:
        submissions = [of_model[truth.plant] for of_model in by_model if truth.plant in of_model]
        is_counted = truth.kind == "single" and is_detectable(truth) and truth.excitation != BLACK_BOX
        if not is_counted or len(submissions) < len(by_model):
            continue
        found = [any(truth.causes[0] in members_of(claim) for claim in entry.causes) for entry in submissions]
        if any(found):
            outcomes.append(all(found))
    return Rate.from_outcomes(outcomes)
