"""The way from recordings to the cause of a gap in five steps: data, check, fit, diagnosis, validation."""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mrd_base import InputError
from mrd_dashboard.jobs import Job
from mrd_dashboard.kept_file import keep, read_kept
from mrd_diagnosis.closure.closure import exceeded_ranges
from mrd_diagnosis.report.gap_file import read_gap_report
from mrd_diagnosis.thresholds import is_noise
from mrd_identification.correction import correction_of_report
from mrd_identification.fit_file import read_fit
from mrd_identification.parallel import in_threads
from mrd_identification.preflight import preflight
from mrd_identification.recording import prepare_recording
from mrd_runs import Run, read_runs

Step = Literal["data", "check", "fit", "diagnose", "validate"]
STEPS: tuple[Step, ...] = ("data", "check", "fit", "diagnose", "validate")

LEAST_FITTED = 2
"""Runs that are left to fit when one is held back: each of them is left out in turn, too."""
AS_GOOD = 2.0
"""Ratio of errors up to which a new run counts as predicted as well as the others; runs differ as much among themselves."""


@dataclass(frozen=True)
class Outcome:
    """What a step has found.

    Attributes
    ----------
    passed : bool
        Whether the next step is open.
    sentence : str
    folder : str
        Name of the folder of its job among the results, or "".
    """

    passed: bool
    sentence: str
    folder: str = ""


@dataclass
class Guide:
    """The chosen recordings, and what each step has found. One thread changes it.

    It is kept in a file, so that it outlives the page.

    Attributes
    ----------
    file : Path or None
        Where it is kept.
    runs, held_back : tuple of str
        Ids of the chosen recordings, and of those among them that are not fitted, but predicted at the end.
    outcomes : dict of Step to Outcome
        Of the steps that have been taken.
    under_way : (Step, str) or None
        The step whose job runs, and the name of the folder of this job.
    problem : str
        Why the file could not be written, or "".
    """

    file: Path | None = None
    runs: tuple[str, ...] = ()
    held_back: tuple[str, ...] = ()
    outcomes: dict[Step, Outcome] = field(default_factory=dict)
    under_way: tuple[Step, str] | None = None
    problem: str = ""

    def __post_init__(self) -> None:
        kept = read_kept(self.file)
        try:
            self.outcomes = {step: Outcome(**kept["outcomes"][step]) for step in STEPS if step in kept["outcomes"]}
            self.runs, self.held_back = tuple(kept["runs"]), tuple(kept["held_back"])
            self.under_way = tuple(kept["under_way"]) if kept["under_way"] else None
        except (TypeError, KeyError):  # nothing kept, or by another version
            self.outcomes = {}

    def _keep(self) -> None:
        content = dataclasses.asdict(self)
        kept = {name: content[name] for name in ("runs", "held_back", "outcomes", "under_way")}
        self.problem = keep(kept, self.file, "the guide")

    @property
    def fitted(self) -> tuple[str, ...]:
        """Ids of the recordings that are fitted."""
        return tuple(name for name in self.runs if name not in self.held_back)

    def is_open(self, step: Step) -> bool:
        """Return whether all steps before one have passed."""
        before = STEPS[: STEPS.index(step)]
        return all(earlier in self.outcomes and self.outcomes[earlier].passed for earlier in before)

    def require_open(self, step: Step) -> None:
        """Raise `InputError` unless a step is open."""
        if not self.is_open(step):
            missing = next(earlier for earlier in STEPS if earlier not in self.outcomes or not self.outcomes[earlier].passed)
            raise InputError(f"{step}: the step before it, {missing}, has not passed; take that one first")

    def choose(self, runs: Sequence[str]) -> None:
        """Begin with other recordings; all later steps close."""
        chosen = tuple(runs)
        sentence = f"{_count(len(chosen))} {'is' if len(chosen) == 1 else 'are'} chosen: {', '.join(chosen)}."
        self.runs, self.held_back = chosen, ()
        self.end("data", Outcome(bool(chosen), sentence if chosen else "No recording is chosen."))

    def check(self, found: "DataCheck") -> None:
        """Note what the data check has found, and hold back what it has chosen."""
        self.held_back = () if found.held_back is None else (self.runs[found.held_back],)
        self.end("check", Outcome(found.passed, " ".join(filter(None, (found.sentence, found.held_back_sentence)))))

    def begin(self, step: Step, folder: str) -> None:
        """Note that the job of a step has begun; what this step and later ones have found is no longer true."""
        self._close(step)
        self.under_way = step, folder
        self._keep()

    def end(self, step: Step, outcome: Outcome) -> None:
        """Note what a step has found; what later steps have found is no longer true."""
        self._close(step)
        self.outcomes[step] = outcome
        self._keep()

    def _close(self, step: Step) -> None:
        kept = STEPS[: STEPS.index(step)]
        self.outcomes = {earlier: found for earlier, found in self.outcomes.items() if earlier in kept}
        self.under_way = None

    def hear(self, jobs: Iterable[Job]) -> None:
        """Note what the job under way has found, once it has ended. It reads the files of this job."""
        if self.under_way is None:
            return
        step, folder = self.under_way
        job = next((job for job in jobs if job.folder.name == folder), None)
        if job is None:
            self.end(step, Outcome(False, "The page was started again meanwhile; take this step again."))
        elif job.state != "running":
            self.end(step, self._outcome(step, job))

    def _outcome(self, step: Step, job: Job) -> Outcome:
        passed, sentence = job.state == "done", job.message
        try:
            if passed and step == "fit":
                sentence = f"{read_fit(job.folder / 'fit.json').model} is fitted. {sentence}"
            if passed and step == "diagnose":
                passed = read_gap_report(job.folder / "gap_report.json")["verdict"] != "data_fault"
            if passed and step == "validate":
                passed, sentence = judge_prediction(job.folder, self.folder(job.folder.parent, "diagnose"), job.message)
        except InputError as error:
            passed, sentence = False, str(error)
        return Outcome(passed, sentence, job.folder.name)

    def folder(self, results: Path, step: Step) -> Path:
        """Return the folder in which the job of a step has written its files.

        Raises
        ------
        InputError
            When the step has not passed, or its files are not there any more.
        """
        outcome = self.outcomes.get(step)
        found = results / outcome.folder if outcome and outcome.folder else None
        if found is None or not found.is_dir():
            raise InputError(f"{step}: its files are not there; take this step again")
        return found


@dataclass(frozen=True)
class DataCheck:
    """What the data check finds in recordings, and which of them can be held back.

    Attributes
    ----------
    passed : bool
        Whether there is no fault.
    sentence : str
        The worst finding with its remedy.
    held_back : int or None
        Place of the recording that can be held back.
    held_back_sentence : str
        What is held back, or what to record so that something can be.
    """

    passed: bool
    sentence: str
    held_back: int | None
    held_back_sentence: str


def check_data(paths: Sequence[str]) -> DataCheck:
    """Check recordings as the diagnosis does, and choose one to hold back. It takes seconds.

    Raises
    ------
    InputError
        When one of them cannot be read.
    """
    runs = read_runs(paths)
    findings = preflight(runs)
    passed = all(finding.severity != "fault" for finding in findings)
    # A remark describes what was recorded.
    worst = [finding for finding in findings if finding.severity != "remark"]
    sentence = f"The data check finds nothing wrong in {_count(len(runs))}."
    if worst:
        others = f" There {'is' if len(worst) == 2 else 'are'} {len(worst) - 1} more." if len(worst) > 1 else ""
        sentence = f"The worst finding is a {worst[0].severity}: {worst[0].sentence.rstrip('.')}.{others}"
    place, held_back = hold_back(runs) if passed else (None, "")
    return DataCheck(passed, sentence, place, held_back)


def hold_back(runs: Sequence[Run]) -> tuple[int | None, str]:
    """Choose a run that is predicted at the end, and is not fitted: of those within the others, the middle one.

    Returns
    -------
    place : int or None
        None where no run can be held back.
    sentence : str
        Which one, or what to record.
    """
    if len(runs) <= LEAST_FITTED:
        return None, (
            f"Of {_count(len(runs))} none is held back to be predicted: record one more run of another motion within the "
            "same stroke, speed and current, and choose it for the step Validate."
        )
    recordings = in_threads(prepare_recording, runs)
    within = [
        place
        for place, recording in enumerate(recordings)
        if not exceeded_ranges(recording, [*recordings[:place], *recordings[place + 1 :]])
    ]
    if not within:
        return None, (
            "None is held back to be predicted, because each goes beyond the others in stroke, speed or current: record one "
            "more run within them, and choose it for the step Validate."
        )
    by_force = sorted(within, key=lambda place: float(np.std(runs[place].force)))
    place = by_force[(len(by_force) - 1) // 2]
    return place, f"{runs[place].name} is held back: it is not fitted, but predicted at the end."


def damper_to_validate(fit: Path, diagnosis: Path) -> Path:
    """Return the file of the damper that a diagnosis leaves: the corrected simulator where it proves a cause, else the fit.

    Parameters
    ----------
    fit, diagnosis : Path
        Folders of their files.
    """
    report = diagnosis / "gap_report.json"
    try:
        proven = correction_of_report(read_gap_report(report), str(report)).effects
    except InputError:
        proven = {}
    return report if proven else fit / "fit.json"


def judge_prediction(validation: Path, diagnosis: Path, sentence: str) -> tuple[bool, str]:
    """Return whether a damper predicts new runs, and that in a sentence.

    It does where their error is hardly more than noise, or at most `AS_GOOD` times that of the data which the diagnosis has
    left out of its fits.

    Parameters
    ----------
    validation, diagnosis : Path
        Folders of their files.
    sentence : str
        What the validation has found.

    Raises
    ------
    InputError
        When a file cannot be read.
    """
    found, gap = _read(validation / "validation.json"), read_gap_report(diagnosis / "gap_report.json")["gap"]
    corrected = bool(found["effects"])
    expected = gap["after" if corrected else "before"]["value"]
    error, floor = found["nrmse"], found["noise_floor"]
    if error is None or expected is None:
        return False, f"The recordings do not tell whether the damper predicts them. {sentence}"
    what = f"The simulator corrected by {', '.join(found['effects'])}" if corrected else f"The fitted {found['model']}"
    runs = ", ".join(run["name"] for run in found["runs"])
    noise = floor is not None and is_noise(error, floor)
    passed = noise or error <= AS_GOOD * expected
    verb = "predicts" if passed else "does not predict"
    why = "hardly more than noise" if noise else f"and {100 * expected:.3g} % on what was left out of the fits before"
    return passed, f"{what} {verb} {runs}: the error is {100 * error:.3g} % of the force's standard deviation, {why}."


def _read(file: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}); take this step again") from None
    return content


def _count(runs: int) -> str:
    return f"{runs} recording{'' if runs == 1 else 's'}"
