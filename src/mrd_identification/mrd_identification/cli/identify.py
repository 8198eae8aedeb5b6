"""Identify a damper model from recordings."""

import argparse
import math

from mrd_base import run_tool
from mrd_base.json_file import make_folder
from mrd_base.progress import shown_progress
from mrd_base.quantities import per_cent
from mrd_identification.cli.options import (
    add_anyway,
    add_method_arguments,
    add_run_arguments,
    announce,
    look_at_runs,
    read_arguments_runs,
    read_method,
)
from mrd_identification.fit_file import write_fit
from mrd_identification.identify import identify
from mrd_identification.report import next_command, write_report
from mrd_runs.read import describe_runs
from mrd_sim.models import MODELS, find_model


def main() -> None:
    """Entry point of ``ros2 run mrd_identification identify``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, identify, write the files, print the result."""
    parser = argparse.ArgumentParser(
        description="Identify a damper model from recordings by NSGA-II and least squares; writes fit.json and fit.html."
    )
    add_run_arguments(parser)
    parser.add_argument("--model", required=True, help=f"one of {', '.join(MODELS)}")
    add_method_arguments(parser)
    add_anyway(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for fit.json and fit.html")
    arguments = parser.parse_args()
    method = read_method(arguments)
    model = find_model(arguments.model, method.laws, method.given_effects)
    runs, held_out = read_arguments_runs(arguments)
    look_at_runs([*runs, *held_out], arguments.anyway, model)
    folder = make_folder(arguments.output)
    announce(describe_runs([*runs, *held_out]))
    total = method.total_generations
    with shown_progress("identifying") as show:

        def progress(generation: int, nrmse: float) -> None:
            found = "" if math.isnan(nrmse) else f"NRMSE {per_cent(nrmse)}"
            show("assessing" if generation == total else found, generation / total)

        fit = identify(
            runs, arguments.model, held_out=held_out, method=method, scheduler=arguments.scheduler, progress=progress
        )
    write_fit(fit, folder)
    report = write_report(fit, folder)
    print(fit.summary())
    for text in fit.selection.sentences if fit.selection else ():
        print(f"{text}.")
    print(f"next command: {next_command(fit)}")
    print(report)
