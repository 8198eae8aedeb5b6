"""What the tools of the trials share."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tqdm import tqdm

from mrd_base import InputError
from mrd_trials.make import read_trial
from mrd_trials.records import Answer
from mrd_trials.seal import unseal


def answers_of(trial: Path) -> Path:
    """Where answers go unless it is said: beside the trial's folder, not in it."""
    return trial.resolve().with_name(f"{trial.resolve().name}.answers.jsonl")


def add_trial(parser: argparse.ArgumentParser) -> None:
    """The folder of a trial."""
    parser.add_argument("trial", type=Path, metavar="TRIAL", help="folder that make wrote")


def add_answers(parser: argparse.ArgumentParser) -> None:
    """The sealed answers."""
    parser.add_argument(
        "--answers", type=Path, metavar="FILE", help="the sealed answers (default: TRIAL.answers.jsonl, beside the folder)"
    )


def unsealed(arguments: argparse.Namespace) -> dict[str, Answer]:
    """The answers, each checked against what everybody may know of the trial."""
    commitments = {exhibit.plant: exhibit.commitment for exhibit in read_trial(arguments.trial).exhibits}
    return unseal(arguments.answers or answers_of(arguments.trial), commitments)


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Number of processes."""
    cores = os.cpu_count() or 1
    parser.add_argument("--workers", type=int, default=cores, metavar="N", help="processes (default: %(default)s)")


def workers_of(arguments: argparse.Namespace) -> int:
    """Number of processes, checked."""
    if arguments.workers < 1:
        raise InputError(f"--workers is {arguments.workers}, expected a whole number from 1")
    return int(arguments.workers)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on a terminal; elsewhere a line now and then."""
    with tqdm(desc=what, unit="plant", file=sys.stderr, disable=None, leave=False) as bar:
        told = -1.0

        def show(done: int, of: int) -> None:
            nonlocal told
            bar.held_out_cost = of
            bar.update(done - bar.n)
            if bar.disable and of and (done == of or done / of >= told + 0.1):
                told = done / of
                print(f"{what}: {done} of {of} plants", file=sys.stderr, flush=True)

        yield show
