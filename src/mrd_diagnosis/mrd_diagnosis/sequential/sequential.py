"""Sequential diagnosis: record, diagnose, record what separates the candidates, and again, until the cause is known.

The measurement that is expected to tell most about what is still open comes next (de Kleer & Williams 1987).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_diagnosis.decision.rejection_rules import leaves_open
from mrd_diagnosis.diagnose import BEST_MODEL, diagnose
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.report.sentences import is_seen, least_probability, open_share
from mrd_diagnosis.sequential.first_set import first_set
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_diagnosis.wording.effect_names import effect_name, effect_names
from mrd_diagnosis.wording.quantities import capitalised, format_probability, format_share, probability_clause
from mrd_identification.fit_file import StoredFit
from mrd_identification.preflight import preflight
from mrd_runs import Run
from mrd_trajectory.experiment import Experiment, parse_experiment
from mrd_trajectory.plan import Plan, plan
from mrd_trajectory.settings import GeneratorSettings

Ending = Literal["data_fault", "no_gap", "cause_known", "nothing_separates", "not_in_catalogue", "budget"]
Record = Callable[[int, Sequence[Plan]], list[Run]]
"""Records experiments in a round, given its number from 1, and returns the runs in their order."""
Progress = Callable[[int, str, float], None]
"""Called with the number of the round, the current step, and the fraction of the diagnosis of this round that is done."""

BUDGET = 180.0
"""Bench time in s that all recordings together may take."""


@dataclass(frozen=True)
class Round:
    """Recordings, and the diagnosis of all recordings until then.

    Attributes
    ----------
    number : int
        From 1.
    runs : tuple of Run
        What was recorded in this round.
    duration : float
        Bench time in s of these recordings.
    diagnosis : Diagnosis
    candidates : dict of str to float
        Probability of each effect that may be a cause after the round, the most probable first; see `open_candidates`.
    added : str
        What the round added to the answer, in one sentence.
    """

    number: int
    runs: tuple[Run, ...]
    duration: float
    diagnosis: Diagnosis
    candidates: dict[str, float]
    added: str


@dataclass(frozen=True)
class SequentialDiagnosis:
    """The rounds of a sequential diagnosis, and why it ended.

    Attributes
    ----------
    rounds : tuple of Round
    ending : {"data_fault", "no_gap", "cause_known", "nothing_separates", "not_in_catalogue", "budget"}
    why : str
        The ending in words, and what a person can do then.
    """

    rounds: tuple[Round, ...]
    ending: Ending
    why: str

    @property
    def diagnosis(self) -> Diagnosis:
        """The last diagnosis, of all recordings."""
        return self.rounds[-1].diagnosis

    @property
    def duration(self) -> float:
        """Bench time in s of all recordings."""
        return sum(of_round.duration for of_round in self.rounds)


def diagnose_sequentially(
    record: Record,
    model: str = BEST_MODEL,
    *,
    bench: GeneratorSettings,
    budget: float = BUDGET,
    first: Sequence[Plan] = (),
    further: Sequence[Run] = (),
    earlier: Sequence[Run] = (),
    earlier_rounds: int = 0,
    parameters: StoredFit | None = None,
    effects: Sequence[str] = (),
    seed: int = 0,
    on_round: Callable[[Round], None] = ignore,
    progress: Progress = ignore,
) -> SequentialDiagnosis:
    """Record and diagnose until the cause is known, nothing on the bench separates what is open, or the budget is used up.

    Parameters
    ----------
    record : callable
        Records experiments. An exception that it raises ends the diagnosis.
    first : sequence of Plan
        Experiments of the first round, by default `first_set`. A fault in the first of them ends the diagnosis.
    further : sequence of Run
        Recordings of the same damper that a person made, such as those that an earlier diagnosis advised; they are diagnosed
        with all others.
    earlier : sequence of Run
        Recordings of further rounds of a diagnosis that was ended and goes on; the first round has them as well.
    earlier_rounds : int
        Number of these rounds; the second round now has the number behind them.
    model, parameters, effects, seed
        As of `mrd_diagnosis.diagnose.diagnose`.
    bench : GeneratorSettings
        Limits that no experiment exceeds.
    budget : float
        Bench time in s that all recordings together may take.
    on_round : callable
        Called with each round when it has been diagnosed.
    progress : callable
        As `Progress`.

    Raises
    ------
    InputError
        For a budget that the first recordings exceed, for a further recording that has a fault or no motion, and as
        `diagnose`.
    """
    for finding in preflight(list(further)) if further else ():
        # It would spoil what all the other recordings say.
        if finding.run and (finding.severity == "fault" or (finding.kind, finding.severity) == ("coverage", "limitation")):
            raise InputError(f"{finding.run}: {finding.text}")
    asked = list(first) or first_set(bench)
    needed = sum(planned.duration for planned in asked)
    if budget < needed:
        raise InputError(
            f"budget: found {budget:g} s of bench time, expected at least {needed:.0f} s for the first recordings"
        )
    rounds: list[Round] = []
    runs: list[Run] = []
    while True:
        number = len(rounds) + 1 + (earlier_rounds if rounds else 0)
        new: list[Run] = []
        if not rounds:
            # A fault of the measurement shows in the first recording; the others would have it as well.
            new, asked = record(number, asked[:1]), asked[1:]
        if rounds or not any(finding.severity == "fault" for finding in preflight(new)):
            new += record(number, asked)
        new += [] if rounds else earlier
        runs += new
        _require_none_twice(runs, further)
        diagnosis = diagnose(
            [*runs, *further],
            model,
            parameters=parameters,
            effects=effects,
            bench=bench,
            seed=seed,
            progress=lambda stage, fraction, number=number: progress(number, stage, fraction),  # type: ignore[misc]
        )
        candidates = open_candidates(diagnosis)
        before = rounds[-1].candidates if rounds else {}
        duration = sum(run.duration for run in new)
        rounds.append(Round(number, tuple(new), duration, diagnosis, candidates, _added(before, candidates, diagnosis)))
        on_round(rounds[-1])
        left = budget - sum(of_round.duration for of_round in rounds)
        asked = [plan(experiment, bench.limits, bench.force_envelope) for experiment in _advised(diagnosis)]
        if ended := _ending(diagnosis, asked, left):
            return SequentialDiagnosis(tuple(rounds), *ended)


def _require_none_twice(runs: Sequence[Run], further: Sequence[Run]) -> None:
    """Refuse a further recording that is one of the diagnosis already: it would count twice."""
    known = {run.info.get("checksum"): run.name for run in runs}
    for run in further:
        if (checksum := run.info.get("checksum")) and checksum in known:
            raise InputError(f"{run.name}: is the recording {known[checksum]} of this diagnosis; leave it out")


def open_candidates(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the probability of each effect that may be a cause after a diagnosis, the most probable first.

    These are the causes, what looks like them, the alternatives to them, and what is seen but not determined; what is less
    likely than `Thresholds.listed_probability` is left out.
    """
    found: dict[str, float] = {}
    entries = [(cause.effect, cause.probability) for cause in diagnosis.causes]
    entries += [(member.effect, member.probability) for cause in diagnosis.causes for member in cause.members]
    entries += [(alternative.effect, alternative.probability) for alternative in diagnosis.alternatives]
    seen = [entry for entry in diagnosis.rejected if entry.chosen and leaves_open(entry.rule)]
    entries += [(entry.effect, entry.probability) for entry in seen]
    for effect, probability in entries:
        if probability >= THRESHOLDS.listed_probability:
            found[effect] = max(probability, found.get(effect, 0.0))
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _advised(diagnosis: Diagnosis) -> list[Experiment]:
    advice = diagnosis.next_experiment
    return [parse_experiment(advice.experiment, "next_experiment")] if advice and advice.experiment else []


def _ending(diagnosis: Diagnosis, asked: Sequence[Plan], left: float) -> tuple[Ending, str] | None:
    """Return why a diagnosis ends after a round, given the experiments that would come next and the time in s that is left;
    None where it goes on.
    """
    if diagnosis.verdict == "data_fault":
        return "data_fault", "The recordings have a fault of the measurement. Mend it, and begin anew."
    if diagnosis.verdict == "no_gap":
        return "no_gap", "The simulator agrees with the damper within the noise, so that there is nothing to look for."
    if not asked:
        advice = diagnosis.next_experiment
        if advice:
            return "nothing_separates", f"No recording of this bench would separate what is open. {advice.text}"
        if diagnosis.causes:
            found = "The cause" if len(diagnosis.causes) == 1 else "The least likely of the causes"
            rest = ""
            if diagnosis.verdict == "partly_explained" and diagnosis.gap is not None:
                rest = f"; {format_share(open_share(diagnosis.gap))} of the gap stays open"
            return "cause_known", f"{found} has {probability_clause(least_probability(diagnosis))}{rest}."
        return "not_in_catalogue", _without_cause(diagnosis)
    duration = sum(planned.duration for planned in asked)
    if duration > left:
        name = asked[0].experiment.name
        return (
            "budget",
            f"The next recording, {name}, takes {duration:.0f} s, and {max(left, 0.0):.0f} s of the budget are left.",
        )
    return None


def _without_cause(diagnosis: Diagnosis) -> str:
    """Return what is known of the effects where none is named."""
    if is_seen(diagnosis):
        return "An effect is seen, but these recordings do not determine it."
    if not diagnosis.candidates:
        return "These recordings cannot test any effect of the catalogue."
    nearest = diagnosis.nearest
    if nearest is None or nearest.closed_fraction.value <= 0.0:
        return "No effect of the catalogue predicts the recordings better than the model alone."
    comes = "comes nearest: it removes" if len(nearest.effects) == 1 else "come nearest: they remove"
    share = format_share(nearest.closed_fraction.value)
    return (
        f"No effect of the catalogue explains the gap. {capitalised(effect_names(nearest.effects))} {comes} {share} of it."
    )


def _added(before: dict[str, float], after: dict[str, float], diagnosis: Diagnosis) -> str:
    """Return what a round added, in sentences: which candidates it removed, and how likely the first one is now."""
    if diagnosis.verdict in ("data_fault", "no_gap"):
        return diagnosis.sentence
    if not after:
        return "No effect of the catalogue is likely to be the cause."
    lead, probability = next(iter(after.items()))
    now = probability_clause(probability)
    if not before:
        if len(after) == 1:
            return f"One effect may be the cause: {effect_name(lead)}, with {now}."
        return f"{len(after)} effects may be the cause: {effect_names(list(after))}. The first one has {now}."
    removed, new = ([name for name in a if name not in b] for a, b in ((before, after), (after, before)))
    parts = [f"{effect_names(removed)} {'is' if len(removed) == 1 else 'are'} no longer likely"] if removed else []
    parts += [f"{effect_names(new)} may be the cause as well"] if new else []
    changed = ", and ".join(parts) or "the candidates stay the same"
    was = f", {format_probability(before[lead])} before" if lead in before else ""
    return f"{capitalised(changed)}. {capitalised(effect_name(lead))} has {now}{was}."
