"""Recordings of the rounds of a sequential diagnosis in a folder, so that an interrupted one goes on."""

from collections.abc import Sequence
from pathlib import Path

from mrd_runs import Run, read_run
from mrd_runs.read import require_whole
from mrd_trajectory.plan import Plan


def folder_of_round(folder: Path, number: int) -> Path:
    """Return the folder of the recordings of a round, given its number from 1; its reports are in ``report`` there."""
    return folder / f"round_{number}"


def missing_plans(plans: Sequence[Plan], folder: Path) -> list[Plan]:
    """Return the experiments that are not recorded yet in the folder of a round."""
    return [planned for planned in plans if not (folder / planned.experiment.name).exists()]


def read_recorded(plans: Sequence[Plan], folder: Path) -> list[Run]:
    """Read the recordings of experiments from the folder of a round.

    Raises
    ------
    InputError
        For a recording that cannot be read, or that does not hold its whole experiment: it is not recorded again, because
        nothing recorded is overwritten.
    """
    runs = [read_run(folder / planned.experiment.name) for planned in plans]
    for planned, run in zip(plans, runs, strict=True):
        require_whole(run, folder / planned.experiment.name, planned.duration)
    return runs
