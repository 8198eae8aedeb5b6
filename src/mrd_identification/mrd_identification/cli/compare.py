"""Fit several damper models to the same recordings and rank them by held-out error."""

import argparse
import math
from collections.abc import Sequence

from rich.table import Column, Table

from mrd_base import InputError, run_tool
from mrd_base.console import print_table
from mrd_base.json_file import make_folder
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
from mrd_identification.compare import check_selection, compare, parse_row
from mrd_identification.compare_file import COLUMNS, fit_folder, ranking, selections, sentence, write_comparison
from mrd_identification.method import Method
from mrd_runs.read import describe_runs
from mrd_sim.models import MODELS

SECONDS_PER_SAMPLE = 2.5e-7
"""Seconds for a sample of a candidate of the search, with all that follows it; of two cores and the cheapest models."""

LONG, TOO_LONG = 60.0, 3600.0
"""Estimated seconds from which the time is announced, and from which it has to be asked for by ``--long``."""


def estimated_seconds(methods: Sequence[Method], samples: int) -> float:
    """Return about how long a comparison takes in s; models differ by a factor of three, machines by as much."""
    return SECONDS_PER_SAMPLE * samples * sum(method.population * method.total_generations for method in methods)


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
        default="",
        metavar="ID[:LAW][+EFFECT...],...",
        help="models, each optionally with a current law and effects; with --held-out, +auto selects these (default: all)",
    )
    add_method_arguments(parser, one_model=False)
    add_anyway(parser)
    parser.add_argument("--long", action="store_true", help="compare even if that takes more than an hour")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the results")
    arguments = parser.parse_args()
    method = read_method(arguments)
    runs, held_out = read_arguments_runs(arguments)
    look_at_runs([*runs, *held_out], arguments.anyway)
    models = arguments.models.split(",") if arguments.models else list(MODELS)
    rows = [parse_row(name, method) for name in models]
    check_selection(rows, held_out)
    seconds = estimated_seconds([of_row for _, of_row in rows], sum(map(len, runs)))
    minutes = f"this takes about {max(seconds / 60, 1):.0f} min"
    if seconds > TOO_LONG and not arguments.long:
        raise InputError(
            f"{describe_runs(runs)}: {minutes} with {len(models)} models; give fewer --models, fewer runs or fewer "
            "--generations, or ask for it with --long"
        )
    make_folder(arguments.output)
    for name in models:
        make_folder(f"{arguments.output}/{fit_folder(name)}")
    each = "once" if held_out else f"{1 + len(runs)} times: to all runs, and without each"
    announce(
        describe_runs([*runs, *held_out]),
        f"{len(models)} model{'s' if len(models) > 1 else ''} (--models), each fitted {each}",
        *([minutes] if seconds > LONG else []),
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
    table = Table(COLUMNS[0], *(Column(title, justify="right") for title in COLUMNS[1:]), box=None)
    for row in ranking(comparison):
        table.add_row(*row)
    print_table(table)
    if not math.isnan(comparison.best.lower):
        print(f"The 95 % intervals come from a bootstrap over {comparison.units} {comparison.resampled}.")
    print(sentence(comparison))
    for text in selections(comparison):
        print(f"{text}.")
    print(page)
