"""Recordings of the rounds of a sequential diagnosis in a folder, so that an interrupted one goes on."""

import itertools
import re
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
        if bag.exists() and not _is_whole(bag, planned.duration):
            moved.append(set_aside(bag))
    return moved


def set_aside(bag: Path) -> Path:
    """Move a recording into ``incomplete`` in its folder, and return where it is now; none that does not exist."""
    if not bag.exists():
        return bag
    folder = bag.parent / "incomplete"
    folder.mkdir(exist_ok=True)
    places = (folder / f"{bag.name}_{number}" for number in itertools.count(1))
    return bag.rename(next(place for place in places if not place.exists()))


def _is_whole(bag: Path, duration: float) -> bool:
    """Whether a recording holds its whole experiment, without samples that are lost."""
    try:
        run = read_run(bag)
        require_whole(run, bag, duration)
    except InputError:
        return False
    return not run.info.get("lost")


def read_later_rounds(folder: Path) -> tuple[list[Run], int]:
    """Return the recordings of all rounds but the first one of a diagnosis, and the number of these rounds.

    Those of a round are in the order in which they were recorded, as far as that is known: heat carries over.
    """
    named = ((re.fullmatch(r"round_(\d+)", path.name), path) for path in folder.glob("round_*/"))
    rounds = {int(match[1]): path for match, path in named if match}
    runs: list[Run] = []
    for number in sorted(rounds):
        if number > 1:
            bags = [bag for bag in sorted(rounds[number].iterdir()) if (bag / "metadata.yaml").exists()]
            runs += sorted(map(read_run, bags), key=lambda run: str(run.info.get("started", "")))
    return runs, max(rounds, default=1) - 1


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
