"""Requests for runs: which experiment to run, and where to record it."""

import datetime
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mrd_base import InputError
from mrd_base.config import named_path, parse_yaml
from mrd_base.text_file import read_text_file
from mrd_bench_driver.supervision.errors import RefusedError
from mrd_trajectory.experiment import experiment_text, parse_experiment


@dataclass(frozen=True)
class RunRequest:
    """One run.

    Attributes
    ----------
    experiment : str
        Text of the experiment file.
    bag : Path
        Folder of the bag to record.
    seed : int
        Seed of everything random in the run.
    """

    experiment: str
    bag: Path
    seed: int

    @property
    def name(self) -> str:
        """Name of the bag, which in a set is the name of the experiment."""
        return self.bag.name


def single_run(experiment: str, bag: str, seed: int, runs: Path) -> RunRequest:
    """Return the request for one run; without ``bag``, its folder is a new one in ``runs``.

    Raises
    ------
    RefusedError
        If the experiment is invalid.
    """
    text, name = _read(experiment, "experiment")
    return RunRequest(text, _folder(bag) if bag else runs.resolve() / f"{name}-{_now()}", seed)


def control_run(experiment: str, bag: str, seed: int, runs: Path) -> RunRequest:
    """Return the request for one hybrid test, whose content the controller checks; otherwise as `single_run`."""
    try:
        line = experiment.strip()
        text = experiment
        if "\n" not in line and ":" not in line:
            text = read_text_file(named_path(line), "a control experiment")
        name = parse_yaml(text, "control experiment").get("name")
    except InputError as error:
        raise RefusedError(str(error)) from None
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise RefusedError(f"control experiment: name: found {name!r}, expected 1 to 64 letters, digits, - and _")
    return RunRequest(text, _folder(bag) if bag else runs.resolve() / f"{name}-{_now()}", seed)


def set_of_runs(experiments: Sequence[str], folder: str, seed: int, runs: Path) -> list[RunRequest]:
    """Return the requests for a set of runs, whose bags are named after their experiments.

    Without ``folder``, the folder of the bags is a new one in ``runs``.

    Raises
    ------
    RefusedError
        If an experiment is invalid, if two have the same name, or if a bag exists.
    """
    if not experiments:
        raise RefusedError("the set has no experiments; give their texts, or paths of their files")
    parent = _folder(folder) if folder else runs.resolve() / f"set-{_now()}"
    requests: dict[str, RunRequest] = {}
    for number, experiment in enumerate(experiments, 1):
        text, name = _read(experiment, f"experiment {number}")
        if name in requests:
            raise RefusedError(f"experiment {number}: another one of the set has the name {name}, too; rename one")
        requests[name] = RunRequest(text, parent / name, seed)
        require_new(requests[name])
    return list(requests.values())


def require_new(request: RunRequest) -> None:
    """Refuse a run whose bag exists, cannot be looked for, or can obviously not be made."""
    try:
        exists = request.bag.exists()
        folder = next(parent for parent in request.bag.parents if parent.exists())
    except OSError as error:
        raise RefusedError(f"{request.bag}: cannot be used ({error.strerror})") from None
    if exists:
        raise RefusedError(f"{request.bag}: exists already and is not overwritten; give another folder")
    if not folder.is_dir():
        raise RefusedError(f"{request.bag}: cannot be made, because {folder} is not a folder; give another folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise RefusedError(f"{request.bag}: cannot be made, because {folder} cannot be written to; give another folder")


def _read(goal: str, where: str) -> tuple[str, str]:
    """Return text and name of the experiment of a goal."""
    try:
        text = experiment_text(goal)
        return text, parse_experiment(text, where).name
    except InputError as error:
        raise RefusedError(str(error)) from None


def _folder(name: str) -> Path:
    """Return the folder that a goal names."""
    try:
        return named_path(name).resolve()
    except InputError as error:
        raise RefusedError(str(error)) from None


def _now() -> str:
    return f"{datetime.datetime.now():%Y%m%d-%H%M%S}"
