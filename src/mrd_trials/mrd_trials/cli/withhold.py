"""Judge plants by a catalogue that lacks their effect."""

import argparse
from pathlib import Path

from mrd_base import run_tool
from mrd_trials.cli.options import add_answers, add_trial, add_workers, progress, unsealed, workers_of
from mrd_trials.withhold import table, withhold


def main() -> None:
    """Entry point of ``ros2 run mrd_trials withhold``."""
    run_tool(work)


def work() -> None:
    """Parse, diagnose, report."""
    parser = argparse.ArgumentParser(
        prog="withhold",
        description="Take each effect of the catalogue away in turn and diagnose plants that have it: any name is wrong.",
    )
    add_trial(parser)
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="where the verdicts go")
    parser.add_argument("--plants", type=int, default=2, metavar="N", help="of each effect, at most (default %(default)s)")
    add_answers(parser)
    add_workers(parser)
    arguments = parser.parse_args()
    answers = unsealed(arguments)
    with progress("diagnosing") as show:
        found = withhold(
            arguments.trial, answers, arguments.output, most=arguments.plants, workers=workers_of(arguments), progress=show
        )
    print(table(answers, found))
