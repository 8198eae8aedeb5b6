"""Diagnose plants sequentially, as on a bench that records what the diagnosis asks for."""

import argparse
from pathlib import Path

from mrd_base import run_tool
from mrd_trials.cli.options import (
    add_answers,
    add_trial,
    add_workers,
    check_plants,
    checked_workers,
    progress_bar,
    read_answers,
)
from mrd_trials.sequential import policy_table, run_sequential_trial


def main() -> None:
    """Entry point of ``ros2 run mrd_trials sequential``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, diagnose, report."""
    parser = argparse.ArgumentParser(
        prog="sequential",
        description="Let the diagnosis choose what plants record after a short first set, and compare it with random "
        "recordings and a fixed set, diagnosed as often at the same bench time; an interrupted trial is continued.",
    )
    add_trial(parser)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for the outcomes")
    parser.add_argument(
        "--plants", type=int, metavar="N", help="only the first N plants with rich excitation (default: all)"
    )
    add_answers(parser)
    add_workers(parser)
    arguments = parser.parse_args()
    check_plants(arguments)
    answers = read_answers(arguments)
    with progress_bar("diagnosing") as show:
        outcomes = run_sequential_trial(
            arguments.trial,
            answers,
            arguments.output,
            most=arguments.plants,
            workers=checked_workers(arguments),
            progress=show,
        )
    print(policy_table(list(outcomes.values())))
