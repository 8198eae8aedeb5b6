"""Open the sealed answers and score the verdicts."""

import argparse
from collections.abc import Iterable
from pathlib import Path

import rich.table
from rich.text import Text

from mrd_base import InputError, run_tool
from mrd_base.console import print_table
from mrd_trials.cli.options import add_answers, add_trial, add_workers, checked_workers, progress_bar, read_answers
from mrd_trials.evaluate import evaluate_trial
from mrd_trials.records import Submission
from mrd_trials.run import VERDICTS_FILE, read_verdicts
from mrd_trials.scoring.report import write_score_report
from mrd_trials.scoring.score import score_trial
from mrd_trials.scoring.tables import Table, markdown_tables, tabulate
from mrd_trials.submission import model_of_verdicts
from mrd_trials.trial_folder import PublicPlant, read_trial


def main() -> None:
    """Entry point of ``ros2 run mrd_trials score``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, check the commitments, evaluate, score, report."""
    parser = argparse.ArgumentParser(
        prog="score",
        description="Open the sealed answers of a trial, check the commitments, score the verdicts; writes score.html.",
    )
    add_trial(parser)
    parser.add_argument("verdicts", type=Path, metavar="DIR", help="folder that run wrote; the score is written into it too")
    add_answers(parser)
    add_workers(parser)
    parser.add_argument(
        "--around",
        type=Path,
        nargs="+",
        default=[],
        metavar="DIR",
        help="folders that run --model wrote: how many causes are found around each of these models",
    )
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")
    arguments = parser.parse_args()
    if len(arguments.around) == 1:
        raise InputError(f"--around {arguments.around[0]}: found one folder, expected those of two models or more")
    if model := model_of_verdicts(arguments.verdicts):
        raise InputError(
            f"{arguments.verdicts}: holds verdicts around {model}, expected those around the model that the trial names; "
            "name such a folder after --around"
        )
    plants = read_trial(arguments.trial).plants
    submissions, *around = (_verdicts(folder, plants) for folder in (arguments.verdicts, *arguments.around))
    answers = read_answers(arguments)
    with progress_bar("evaluating") as show:
        evaluations = evaluate_trial(
            arguments.trial, answers, submissions, arguments.verdicts, checked_workers(arguments), show
        )
    score = score_trial(answers, submissions, evaluations, around)
    if arguments.markdown:
        print(markdown_tables(score))
    else:
        _print(tabulate(score))
    print(write_score_report(score, arguments.verdicts))


def _verdicts(folder: Path, plants: Iterable[PublicPlant]) -> dict[str, Submission]:
    verdicts = read_verdicts(folder / VERDICTS_FILE, plants)
    if not verdicts:
        raise InputError(f"{folder}: holds no verdicts, so the answers stay sealed; name the folder that run wrote")
    return verdicts


def _print(tables: Iterable[Table]) -> None:
    for table in tables:
        print(table.title)
        shown = rich.table.Table(*(rich.table.Column(Text(title)) for title in table.header), box=None)
        for row in table.rows:
            shown.add_row(*map(Text, row))
        print_table(shown)
        print(f"{table.note}\n" if table.note else "")
