"""Diagnose plants by a catalogue that lacks their effect."""

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
from mrd_trials.withhold import withheld_table, withhold_effects


def main() -> None:
    """Entry point of ``ros2 run mrd_trials withhold``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, diagnose, report."""
    parser = argparse.ArgumentParser(
        prog="withhold",
        description="Remove each effect from the catalogue in turn and diagnose plants that have it: any name is wrong.",
    )
    add_trial(parser)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for the verdicts")
    parser.add_argument(
        "--plants", type=int, default=2, metavar="N", help="most plants of each effect (default %(default)s)"
    )
    add_answers(parser)
    add_workers(parser)
    arguments = parser.parse_args()
    check_plants(arguments)
    answers = read_answers(arguments)
    with progress_bar("diagnosing") as show:
        submissions = withhold_effects(
            arguments.trial,
            answers,
            arguments.output,
            most=arguments.plants,
            workers=checked_workers(arguments),
            progress=show,
        )
    print(withheld_table(answers, submissions))
