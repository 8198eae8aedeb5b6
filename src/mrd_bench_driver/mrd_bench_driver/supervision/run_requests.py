"""Requests for runs: which experiment to run, and where to record it."""

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mrd_base import InputError
from mrd_base.config import parse_yaml
from mrd_bench_driver.supervision.errors import RefusedError
from mrd_trajectory.experiment import parse_experiment


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
    """Return the request for one run; without ``bag``, its folder is a new one in ``runs``."""
    if not bag:
        try:
            name = str(parse_yaml(experiment, "experiment").get("name"))
        except InputError as error:
            raise RefusedError(str(error)) from None
        # The generator checks the experiment as a whole. Here the name must only be safe as the name of a folder.
        name = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else "experiment"
        bag = str(runs / f"{name}-{_now()}")
    return RunRequest(experiment, Path(bag).resolve(), seed)


def set_of_runs(experiments: Sequence[str], folder: str, seed: int, runs: Path) -> list[RunRequest]:
    """Return the requests for a set of runs, whose bags are named after their experiments.

    Without ``folder``, the folder of the bags is a new one in ``runs``.

    Raises
    ------
    RefusedError
        If an experiment is invalid, if two have the same name, or if a bag exists.
    """
    if not experiments:
        raise RefusedError("the set has no experiments; give their texts")
    parent = Path(folder or runs / f"set-{_now()}").resolve()
    requests: dict[str, RunRequest] = {}
    for number, text in enumerate(experiments, 1):
        try:
            name = parse_experiment(text, f"experiment {number}").name
        except InputError as error:
            raise RefusedError(str(error)) from None
        if name in requests:
            raise RefusedError(f"experiment {number}: another one of the set has the name {name}, too; rename one")
        if (parent / name).exists():
            raise RefusedError(f"{parent / name}: exists already and is not overwritten; give another folder")
        requests[name] = RunRequest(text, parent / name, seed)
    return list(requests.values())


def _now() -> str:
    return f"{datetime.datetime.now():%Y%m%d-%H%M%S}"
