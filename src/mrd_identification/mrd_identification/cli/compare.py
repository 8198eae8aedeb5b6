"""Fit several damper models to the same recordings and rank them by held-out error."""

import argparse
import sys

from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from mrd_base import run_tool
from mrd_identification.cli.options import add_method_arguments, add_run_arguments, method, read_arguments_runs
from mrd_identification.compare import Comparison, compare
from mrd_identification.compare_file import folder_of, sentence, write_comparison
from mrd_identification.json_file import make_folder
from mrd_sim.models import MODELS, find_model


def main() -> None:
    """Entry point of ``ros2 run mrd_identification compare``."""
    run_tool(work)


def work() -> None:
    """Parse, compare, write, report."""
    parser = argparse.ArgumentParser(
        prog="compare",
        description="Fit damper models to recordings and rank them by their error on runs that they have not seen; "
        "writes compare.json, compare.md, compare.html and a folder with fit.json for each model.",
    )
    add_run_arguments(parser)
    parser.add_argument(
        "--models",
        default=",".join(MODELS),
        metavar="ID[:LAW],...",
        help="models, each with a current law if wanted (default: all)",
    )
    add_method_arguments(parser, one_model=False)
    parser.add_argument("--output", required=True, metavar="DIR", help="where the results go")
    arguments = parser.parse_args()
    how = method(arguments)
    runs, held_out = read_arguments_runs(arguments)
    models = arguments.models.split(",")
    make_folder(arguments.output)
    for name in models:
        find_model(name.partition(":")[0])
        make_folder(f"{arguments.output}/{folder_of(name)}")
    with tqdm(total=100, desc="comparing", unit="%", file=sys.stderr, disable=None, leave=False) as bar:

        def progress(share: float) -> None:
            bar.update(int(100 * share) - bar.n)

        found = compare(
            runs, models, held_out=held_out, method=how, profile=False, scheduler=arguments.scheduler, progress=progress
        )
    page = write_comparison(found, arguments.output)
    Console().print(table(found))
    print(f"intervals in brackets: 95 %, by bootstrap over {found.units} {found.resampled}")
    print(sentence(found))
    print(page)


def table(found: Comparison) -> Table:
    """The ranking for a terminal; intervals of 95 % in brackets."""
    ranking = Table("model", box=None)
    for title in ("free", "NRMSE, unseen", "behind the best", "fitted", "s"):
        ranking.add_column(title, justify="right", no_wrap=True)
    for entry in found.entries:
        behind = "on par" if entry.on_par else f"{entry.behind_lower:.3f} to {entry.behind_upper:.3f}"
        ranking.add_row(
            entry.name,
            str(entry.free),
            f"{entry.nrmse:.4f} ({entry.lower:.3f} to {entry.upper:.3f})",
            "the best" if entry is found.entries[0] else behind,
            f"{entry.fit.pooled_fitted.nrmse:.4f}",
            f"{entry.fit.elapsed:.0f}",
        )
    return ranking
