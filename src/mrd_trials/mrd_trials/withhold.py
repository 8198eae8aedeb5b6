"""Withhold the true effect from the catalogue: every effect that is named then is wrong."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from mrd_base.progress import ignore
from mrd_sim.effects import EFFECTS
from mrd_trials.parallel import run_in_processes
from mrd_trials.records import GroundTruth, Submission, complete_records
from mrd_trials.run import read_recordings, read_verdicts
from mrd_trials.scoring.plant_result import members_of
from mrd_trials.submission import diagnose_plant, installed_diagnoser, reserve_folder
from mrd_trials.trial_design import is_detectable
from mrd_trials.trial_folder import PublicPlant, read_trial

WITHHELD_FILE = "withheld.jsonl"


def withhold_effects(
    folder: Path,
    answers: Mapping[str, GroundTruth],
    output: Path,
    *,
    most: int = 2,
    workers: int = 1,
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, Submission]:
    """Diagnose plants with one detectable effect by a catalogue that lacks it.

    Parameters
    ----------
    folder : Path
        Folder of the trial.
    answers : mapping
        Answers by plant (`mrd_trials.commitments.open_answers`).
    output : Path
        Folder that gets `WITHHELD_FILE`; plants that it holds already are not diagnosed again.
    most : int
        Largest number of plants of each effect.
    workers : int
        Number of processes.
    progress : callable
        Called with the number of finished plants and of all plants.

    Raises
    ------
    InputError
        When ``output`` holds verdicts of another diagnoser or on another trial.
    """
    by_effect: dict[str, list[PublicPlant]] = {}
    for plant in read_trial(folder).plants:
        truth = answers[plant.plant]
        if truth.kind == "single" and is_detectable(truth) and plant.excitation == "rich":
            by_effect.setdefault(truth.causes[0], []).append(plant)
    chosen = {plant.plant: plant for plants in by_effect.values() for plant in plants[:most]}
    reserve_folder(installed_diagnoser(), output)
    read_verdicts(output / WITHHELD_FILE, chosen.values())

    def work(names: Sequence[str]) -> Iterator[Submission]:
        missing = [(folder, chosen[name], answers[name].causes[0]) for name in names]
        return run_in_processes(_diagnose_without, missing, workers)

    return complete_records(Submission, output / WITHHELD_FILE, list(chosen), work, progress)


def withheld_table(answers: Mapping[str, GroundTruth], submissions: Mapping[str, Submission]) -> str:
    """Return a table in Markdown of what was named where the true effect could not be.

    What the form of a damper contains is neither right nor wrong, so it is left out.
    """
    lines = ["| effect withheld | signal to floor | verdict | named | resembles |", "|" + "---|" * 5]
    wrong = 0
    for plant, submission in sorted(submissions.items(), key=lambda item: answers[item[0]].causes):
        truth = answers[plant]
        claims = [claim for claim in submission.causes if not set(truth.implied) & set(members_of(claim))]
        wrong += bool(claims)
        verdict = f"failed: {submission.failure}" if submission.failure else submission.verdict
        named = ", ".join(f"`{claim.effects[0]}`" for claim in claims) or "–"
        nearest = ", ".join(f"`{effect}`" for effect in submission.nearest) or "–"
        lines.append(f"| `{truth.causes[0]}` | {truth.signal_to_floor:.1f} | {verdict} | {named} | {nearest} |")
    failed = sum(submission.verdict == "failed" for submission in submissions.values())
    diagnosed = len(submissions) - failed
    return "\n".join(
        [*lines, "", f"An effect is named, wrongly, for {wrong} of {diagnosed} plants; the diagnosis failed on {failed}."]
    )


def catalogue_without(effect: str) -> list[str]:
    """Return the effects that are tried where one is withheld; recordings alone cannot show a change."""
    return [name for name, entry in EFFECTS.items() if name != effect and not entry.only_as_change]


def _diagnose_without(folder: Path, plant: PublicPlant, effect: str) -> Submission:
    read = read_recordings(folder, plant)
    if isinstance(read, Submission):
        return read
    return diagnose_plant(plant, read[0], effects=catalogue_without(effect))
