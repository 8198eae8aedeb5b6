"""The folder of a trial: its description that everybody may read, and the recordings of its plants."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs import Run, read_runs
from mrd_trials.excitation import FRESH_RUNS
from mrd_trials.size import REFERENCE, Size
from mrd_trials.trial_design import Recipe

DESCRIPTION = "trial.json"

FORMAT = 7
"""Version of a trial: its keys, and what a recipe stands for. In 1, every effect had a single formula; in 2, all dampers had
one size; in 3, effects were drawn up to the end of their plausible range; in 4, plays were crossed in measured recordings as
fast as the force could, and the curve of a transducer was counted from their zero; in 5, stops and springs were as well;
in 6, any effect could be a substitute in measured recordings."""

COLUMNS = "time_s,position_m,current_A,force_N"


@dataclass(frozen=True)
class PublicPlant:
    """One plant as everybody may see it.

    Attributes
    ----------
    plant, model : str
    excitation : str
    rate : float
        Sample rate in Hz.
    runs : tuple of str
        Files, relative to the trial's folder, in the order in which they were recorded.
    commitment : str
        Commitment to its answer.
    reference : tuple of str
        Files of recordings from before, with which the diagnosis compares the others; mostly empty.
    size : Size
        Size of the bench for this plant: the diagnosis is told its limits.
    """

    plant: str
    model: str
    excitation: str
    rate: float
    runs: tuple[str, ...]
    commitment: str
    reference: tuple[str, ...] = ()
    size: Size = REFERENCE


@dataclass(frozen=True)
class PublicTrial:
    """Public part of a trial."""

    recipe: Recipe
    plants: tuple[PublicPlant, ...]

    @property
    def commitments(self) -> dict[str, str]:
        """Commitment to the answer of each plant."""
        return {plant.plant: plant.commitment for plant in self.plants}


def read_trial(folder: Path) -> PublicTrial:
    """Read the description of a trial.

    Raises
    ------
    InputError
        When the folder holds none.
    """
    path = folder / DESCRIPTION
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        if values.get("format", 1) != FORMAT:
            raise ValueError(f"format {values.get('format', 1)}, expected {FORMAT}")
        plants = tuple(
            PublicPlant(
                **{
                    **entry,
                    "runs": tuple(entry["runs"]),
                    "reference": tuple(entry["reference"]),
                    "size": Size(**entry["size"]),
                }
            )
            for entry in values["plants"]
        )
        return PublicTrial(Recipe(**values["recipe"]), plants)
    except FileNotFoundError:
        raise InputError(f"{folder}: is not a trial, expected {DESCRIPTION} in it; make one with make") from None
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path}: does not describe a trial ({error}), expected a file that make has written") from None


def write_trial(trial: PublicTrial, folder: Path) -> None:
    """Write the description of a trial; the file is complete at any time."""
    values = {"format": FORMAT, "recipe": asdict(trial.recipe), "plants": [asdict(plant) for plant in trial.plants]}
    partial = folder / f"{DESCRIPTION}.part"
    partial.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    partial.replace(folder / DESCRIPTION)


def write_recordings(folder: Path, plant: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Write the recordings of a plant as CSV, and return the files of those that the diagnosis is given."""
    given = [_write_run(folder, "plants", plant, place, run) for place, run in enumerate(runs[:-FRESH_RUNS], 1)]
    for place, run in enumerate(runs[-FRESH_RUNS:], len(given) + 1):
        _write_run(folder, "fresh", plant, place, run)
    return tuple(given)


def write_reference(folder: Path, plant: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Write recordings from before as CSV, and return the files."""
    return tuple(_write_run(folder, "before", plant, place, run) for place, run in enumerate(runs, 1))


def _write_run(folder: Path, part: str, plant: str, place: int, run: Run) -> str:
    file = Path(part, plant, f"{place:02d}_{run.name}.csv")
    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = [run.time, run.position, run.current, run.force]
    header = COLUMNS
    if run.acceleration is not None:
        columns, header = [*columns, run.acceleration], f"{COLUMNS},acceleration_mps2"
    np.savetxt(path, np.stack(columns, axis=1), fmt="%.8g", delimiter=",", header=header, comments="")
    return str(file)


def read_given_runs(folder: Path, plant: PublicPlant) -> list[Run]:
    """Read the recordings of a plant that the diagnosis is given."""
    return read_runs([str(folder / file) for file in plant.runs])


def read_reference_runs(folder: Path, plant: PublicPlant) -> list[Run]:
    """Read the recordings from before, with which the diagnosis compares those of a plant; often none."""
    return read_runs([str(folder / file) for file in plant.reference]) if plant.reference else []


def read_fresh_runs(folder: Path, plant: str) -> list[Run]:
    """Read the recordings of a plant that only the evaluation uses."""
    return read_runs([str(file) for file in sorted((folder / "fresh" / plant).glob("*.csv"))])
