"""Open the seal and score the verdicts."""

import argparse
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_trials.cli.options import add_answers, add_trial, add_workers, progress, unsealed, workers_of
from mrd_trials.insight import insights
from mrd_trials.make import read_trial
from mrd_trials.run import VERDICTS, read_verdicts
from mrd_trials.score import score
from mrd_trials.score_report import write_score_report
from mrd_trials.tables import tables


def main() -> None:
    """Entry point of ``ros2 run mrd_trials score``."""
    run_tool(work)


def work() -> None:
    """Parse, check the commitments, score, report."""
    parser = argparse.ArgumentParser(
        prog="score", description="Open the seal of a trial, check the commitments, score the verdicts; writes score.html."
    )
    add_trial(parser)
    parser.add_argument("verdicts", type=Path, metavar="DIR", help="folder that run wrote; gets the score too")
    add_answers(parser)
    add_workers(parser)
    arguments = parser.parse_args()
    submissions = read_verdicts(arguments.verdicts / VERDICTS, read_trial(arguments.trial).exhibits)
    if not submissions:
        raise InputError(f"{arguments.verdicts}: holds no verdicts, so the answers stay sealed; name what run wrote to")
    answers = unsealed(arguments)
    with progress("asking one who knows, and simpler methods") as show:
        found = insights(arguments.trial, answers, submissions, arguments.verdicts, workers_of(arguments), show)
    scored = score(answers, submissions, found)
    print(tables(scored))
    print(write_score_report(scored, arguments.verdicts))
