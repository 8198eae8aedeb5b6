"""Show the summary of recordings."""

import argparse

from rich.table import Table
from rich.text import Text

from mrd_base import run_tool
from mrd_base.console import print_table
from mrd_runs import read_runs
from mrd_runs.read import RUN_HELP
from mrd_runs.summary import summarise


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", metavar="RUN", help=RUN_HELP)
    arguments = parser.parse_args()
    run_tool(lambda: _show(arguments.runs))


def _show(paths: list[str]) -> None:
    for run in read_runs(paths):
        table = Table(title=Text(run.name), show_header=False, title_justify="left")
        for name, content in summarise(run).items():
            table.add_row(name, Text(content))  # a text of a stranger's file is no markup
        print_table(table)
