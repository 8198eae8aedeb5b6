"""Options that the tools of the trials share."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tqdm import tqdm

from mrd_base import InputError
from mrd_trials.commitments import open_answers
from mrd_trials.records import GroundTruth
from mrd_trials.trial_folder import read_trial


def default_answers(trial: Path) -> Path:
    """Return where the answers are by default: beside the trial's folder, not in it."""
    return trial.resolve().with_name(f"{trial.resolve().name}.answers.jsonl")


def add_trial(parser: argparse.ArgumentParser) -> None:
    """Add the argument for the folder of a trial."""
    parser.add_argument("trial", type=Path, metavar="TRIAL", help="folder that make wrote")


def add_answers(parser: argparse.ArgumentParser) -> None:
    """Add the option for the file of sealed answers."""
    parser.add_argument(
        "--answers", type=Path, metavar="FILE", help="the sealed answers (default: TRIAL.answers.jsonl, beside the folder)"
    )


def read_answers(arguments: argparse.Namespace) -> dict[str, GroundTruth]:
    """Read the answers, each checked against its commitment."""
    return open_answers(arguments.answers or default_answers(arguments.trial), read_trial(arguments.trial).commitments)


def check_plants(arguments: argparse.Namespace) -> None:
    """Require that a number of plants is one."""
    if arguments.plants is not None and arguments.plants < 1:
        raise InputError(f"--plants is {arguments.plants}, expected a whole number from 1")


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add the option for the number of processes."""
    cores = os.cpu_count() or 1
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help="number of processes (default: %(default)s)")


def checked_workers(arguments: argparse.Namespace) -> int:
    """Return the number of processes."""
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, expected a whole number from 1")
    return int(arguments.workers)


@contextmanager
def progress_bar(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show the progress by a bar on a terminal, elsewhere by a line for about every tenth of the plants."""
    with tqdm(desc=what, unit="plant", file=sys.stderr, disable=None, leave=False) as bar:
        printed = -1.0

        def show(done: int, total: int) -> None:
            nonlocal printed
            bar.total = total
            bar.update(done - bar.n)
            if bar.disable and total and (done == total or done / total >= printed + 0.1):
                printed = done / total
                print(f"{what}: {done} of {total} plants", file=sys.stderr, flush=True)

        yield show
