"""Run a trial: one submission of one diagnoser for each plant, failures included."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_diagnosis import diagnose
from mrd_identification.cluster import run_on_cluster
from mrd_runs import Run
from mrd_trials.parallel import run_in_processes
from mrd_trials.records import SequentialOutcome, Submission, complete_records, read_records
from mrd_trials.submission import (
    Diagnoser,
    Method,
    check_comparison,
    diagnose_plant,
    failed_submission,
    installed_diagnoser,
    reserve_folder,
)
from mrd_trials.trial_folder import PublicPlant, read_given_runs, read_reference_runs, read_trial

VERDICTS_FILE = "verdicts.jsonl"

PORTION = 16
"""Number of plants that are sent to a cluster at once; an interruption loses the work on one portion at most."""


def run_trial(
    folder: Path,
    output: Path,
    diagnoser: Diagnoser | None = None,
    *,
    method: Method = diagnose,
    workers: int = 1,
    scheduler: str = "",
    progress: Callable[[int, int], None] = ignore,
) -> dict[str, Submission]:
    """Diagnose every plant of a trial that has no verdict yet.

    Parameters
    ----------
    folder : Path
        Folder of the trial. The answers are not in it, and nothing here knows where they are.
    output : Path
        Folder that gets `mrd_trials.submission.DIAGNOSER_FILE` and, one line a plant, `VERDICTS_FILE`.
    diagnoser : Diagnoser, optional
        As `mrd_trials.submission.installed_diagnoser` returns it.
    method : callable
        What diagnoses, a function at the top level of a module; takes what `mrd_diagnosis.diagnose` takes.
    workers : int
        Number of processes.
    scheduler : str
        Address of a dask cluster that does the work instead of processes.
    progress : callable
        Called with the number of finished plants and of all plants.

    Raises
    ------
    InputError
        When there is no trial, ``output`` holds verdicts of another diagnoser or on another trial, or the trial asks for
        comparisons that the method cannot make, or no file has its source.
    """
    diagnoser = (diagnoser or installed_diagnoser()).with_method(method)
    plants = {plant.plant: replace(plant, model=diagnoser.model or plant.model) for plant in read_trial(folder).plants}
    check_comparison(plants.values(), method)
    reserve_folder(diagnoser, output)
    read_verdicts(output / VERDICTS_FILE, plants.values())

    def work(names: Sequence[str]) -> Iterator[Submission]:
        if not scheduler:
            arguments = [(folder, plants[name], diagnoser.seed, method) for name in names]
            yield from run_in_processes(_diagnose_files, arguments, workers)
            return
        for first in range(0, len(names), PORTION):
            pieces = []
            for plant in (plants[name] for name in names[first : first + PORTION]):
                read = read_recordings(folder, plant)
                if isinstance(read, Submission):
                    yield read
                else:
                    runs, reference = read
                    pieces.append((plant, tuple(runs), diagnoser.seed, (), tuple(reference), method))
            yield from run_on_cluster(scheduler, diagnose_plant, pieces)

    return complete_records(Submission, output / VERDICTS_FILE, list(plants), work, progress)


def read_verdicts(path: Path, plants: Iterable[PublicPlant]) -> dict[str, Submission]:
    """Read submissions by plant, and check that each is on the plant that a trial has under this name.

    Raises
    ------
    InputError
        When one is on a plant of another trial.
    """
    submissions = read_records(Submission, path)
    require_same_trial(submissions, plants, path)
    return submissions


def require_same_trial(
    records: Mapping[str, Submission] | Mapping[str, SequentialOutcome], plants: Iterable[PublicPlant], path: Path
) -> None:
    """Require that the records of a file are on the plants that a trial has under these names.

    Raises
    ------
    InputError
        When one is on a plant of another trial.
    """
    for plant in plants:
        if plant.plant in records and records[plant.plant].commitment != plant.commitment:
            raise InputError(
                f"{path}: the verdict on {plant.plant} is on a plant of another trial; name this trial's folder"
            )


def _diagnose_files(folder: Path, plant: PublicPlant, seed: int, method: Method) -> Submission:
    read = read_recordings(folder, plant)
    if isinstance(read, Submission):
        return read
    runs, reference = read
    return diagnose_plant(plant, runs, seed, reference=reference, method=method)


def read_recordings(folder: Path, plant: PublicPlant) -> tuple[list[Run], list[Run]] | Submission:
    """Return the recordings of a plant and its reference, or the failure of a plant whose recordings are refused."""
    try:
        return read_given_runs(folder, plant), read_reference_runs(folder, plant)
    except InputError as error:
        return failed_submission(plant, error)
