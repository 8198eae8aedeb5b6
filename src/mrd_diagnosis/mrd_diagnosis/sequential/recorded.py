"""Recordings of the rounds of a sequential diagnosis in a folder, so that an interrupted one goes on."""

import itertools
from collections.abc import Sequence
from pathlib import Path

from mrd_base import InputError
from mrd_runs import Run, read_run
from mrd_runs.read import require_whole
from mrd_trajectory.plan import Plan


def folder_of_round(folder: Path, number: int) -> Path:
    """Return the folder of the recordings of a round, given its number from 1; its reports are in ``report`` there."""
    return folder / f"round_{number}"


def set_aside_incomplete(plans: Sequence[Plan], folder: Path) -> list[Path]:
    """Move recordings that do not hold their whole experiment, or cannot be read, into ``incomplete`` in their folder.

    Such a recording is left by a stop or by a recorder that was killed. Its name is then free, so that the experiment is
    recorded again.

    Parameters
    ----------
    plans : sequence of Plan
        Experiments of a round, none of which is being recorded.
    folder : Path
        Folder of the round.

    Returns
    -------
    list of Path
        Where they are now.
    """
    moved = []
    for planned in plans:
        bag = folder / planned.experiment.name
        if not bag.exists() or _is_whole(bag, planned.duration):
            continue
        (folder / "incomplete").mkdir(exist_ok=True)
        places = (folder / "incomplete" / f"{bag.name}_{number}" for number in itertools.count(1))
        place = next(place for place in places if not place.exists())
        moved.append(bag.rename(place))
    return moved


def _is_whole(bag: Path, duration: float) -> bool:
    try:
        require_whole(read_run(bag), bag, duration)
    except InputError:
        return False
    return True


def read_recorded(plans: Sequence[Plan], folder: Path) -> list[Run]:
    """Read the recordings of experiments from the folder of a round.

    Raises
    ------
    InputError
        For a recording that cannot be read, or that does not hold its whole experiment.
    """
    runs = [read_run(folder / planned.experiment.name) for planned in plans]
    for planned, run in zip(plans, runs, strict=True):
        require_whole(run, folder / planned.experiment.name, planned.duration)
    return runs
