"""Diagnose the plants of a trial."""

import argparse
from collections import Counter
from pathlib import Path

from mrd_base import run_tool
from mrd_sim.models import find_model
from mrd_trials.cli.options import add_trial, add_workers, checked_workers, progress_bar
from mrd_trials.run import run_trial
from mrd_trials.submission import installed_diagnoser


def main() -> None:
    """Entry point of ``ros2 run mrd_trials run``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, diagnose, report."""
    parser = argparse.ArgumentParser(
        prog="run", description="Diagnose every plant of a trial, one verdict each; an interrupted run is continued."
    )
    add_trial(parser)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for the verdicts")
    parser.add_argument("--seed", type=int, default=0, help="seed of every diagnosis (default %(default)s)")
    parser.add_argument(
        "--model",
        default="",
        metavar="MODEL",
        help="damper model of every diagnosis (default: the one that the trial names)",
    )
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="work on the dask cluster of this scheduler")
    add_workers(parser)
    arguments = parser.parse_args()
    with progress_bar("diagnosing") as show:
        submissions = run_trial(
            arguments.trial,
            arguments.output,
            installed_diagnoser(arguments.seed, find_model(arguments.model).id if arguments.model else ""),
            workers=checked_workers(arguments),
            scheduler=arguments.scheduler,
            progress=show,
        )
    counts = Counter(submission.verdict for submission in submissions.values())
    print(", ".join(f"{verdict}: {count}" for verdict, count in counts.most_common()))
    for submission in submissions.values():
        if submission.failure:
            print(f"{submission.plant} failed: {submission.failure}")
