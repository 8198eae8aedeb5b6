"""The folder of a trial: its description that everybody may read, and the recordings of its plants."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs import Run, read_runs
from mrd_trials.excitation import FRESH_RUNS
from mrd_trials.trial_design import Recipe
from mrd_trials.truth import Readings

DESCRIPTION = "trial.json"

FORMAT = 2
"""Version of a trial: its keys, and what a recipe stands for. In 1, every effect had a single formula."""

COLUMNS = "time_s,position_m,current_A,force_N,acceleration_mps2"


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
    """

    plant: str
    model: str
    excitation: str
    rate: float
    runs: tuple[str, ...]
    commitment: str


@dataclass(frozen=True)
class PublicTrial:
    """What everybody may know of a trial."""

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
        plants = tuple(PublicPlant(**{**entry, "runs": tuple(entry["runs"])}) for entry in values["plants"])
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


def write_recordings(folder: Path, plant: str, recordings: Sequence[tuple[str, Readings]]) -> tuple[str, ...]:
    """Write the recordings of a plant as CSV, and return the files of those that the diagnosis is given."""
    files = []
    for place, (name, readings) in enumerate(recordings):
        is_fresh = place >= len(recordings) - FRESH_RUNS
        file = Path("fresh" if is_fresh else "plants", plant, f"{place + 1:02d}_{name}.csv")
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        columns = (readings.time, readings.position, readings.current, readings.force, readings.acceleration)
        np.savetxt(path, np.stack(columns, axis=1), fmt="%.8g", delimiter=",", header=COLUMNS, comments="")
        if not is_fresh:
            files.append(str(file))
    return tuple(files)


def read_given_runs(folder: Path, plant: PublicPlant) -> list[Run]:
    """Read the recordings of a plant that the diagnosis is given."""
    return read_runs([str(folder / file) for file in plant.runs])


def read_fresh_runs(folder: Path, plant: str) -> list[Run]:
    """Read the recordings of a plant that only the evaluation uses."""
    return read_runs([str(file) for file in sorted((folder / "fresh" / plant).glob("*.csv"))])
