"""Fit several damper models to the same recordings and rank them by held-out error."""

import argparse

from rich.console import Console
from rich.table import Column, Table

from mrd_base import run_tool
from mrd_base.progress import shown_progress
from mrd_identification.cli.options import (
    add_anyway,
    add_method_arguments,
    add_run_arguments,
    announce,
    look_at_runs,
    read_arguments_runs,
    read_method,
)
from mrd_identification.compare import compare, parse_row
from mrd_identification.compare_file import COLUMNS, fit_folder, ranking, selections, sentence, write_comparison
from mrd_identification.json_file import make_folder
from mrd_runs.read import describe_runs
from mrd_sim.models import MODELS

TABLE_WIDTH = 110
"""Characters; a narrower terminal breaks the lines of the table, and no figure is cut off."""


def main() -> None:
    """Entry point of ``ros2 run mrd_identification compare``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, compare, write the files, print the ranking."""
    parser = argparse.ArgumentParser(
        description="Fit damper models to recordings and rank them by their error on held-out runs; "
        "writes compare.json, compare.md, compare.html and a folder with fit.json for each model."
    )
    add_run_arguments(parser)
    parser.add_argument(
        "--models",
        default=",".join(MODELS),
        metavar="ID[:LAW][+EFFECT...],...",
        help="models, each optionally with a current law and effects, or +auto for selected ones (default: all)",
    )
    add_method_arguments(parser, one_model=False)
    add_anyway(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the results")
    arguments = parser.parse_args()
    method = read_method(arguments)
    runs, held_out = read_arguments_runs(arguments)
    look_at_runs([*runs, *held_out], arguments.anyway)
    models = arguments.models.split(",")
    make_folder(arguments.output)
    for name in models:
        parse_row(name, method)
        make_folder(f"{arguments.output}/{fit_folder(name)}")
    each = "once" if held_out else f"{1 + len(runs)} times: to all runs, and without each"
    announce(
        describe_runs([*runs, *held_out]),
        f"{len(models)} model{'s' if len(models) > 1 else ''} (--models), each fitted {each}",
    )
    with shown_progress("comparing") as report:
        comparison = compare(
            runs,
            models,
            held_out=held_out,
            method=method,
            profile=False,
            scheduler=arguments.scheduler,
            progress=lambda share: report("", share),
        )
    page = write_comparison(comparison, arguments.output)
    table = Table(Column(COLUMNS[0], no_wrap=True), *(Column(title, justify="right") for title in COLUMNS[1:]), box=None)
    for row in ranking(comparison):
        table.add_row(*row)
    Console(width=max(Console().width, TABLE_WIDTH)).print(table)
    print(f"The 95 % intervals come from a bootstrap over {comparison.units} {comparison.resampled}.")
    print(sentence(comparison))
    for text in selections(comparison):
        print(f"{text}.")
    print(page)
