"""Identify a damper model from recordings."""

import argparse
import sys

from tqdm import tqdm

from mrd_base import InputError, run_tool
from mrd_identification.fit_file import make_folder, write_fit
from mrd_identification.identify import GENERATIONS, POPULATION, identify
from mrd_identification.report import sentence, write_report
from mrd_runs import read_runs
from mrd_sim.models import MODELS, find_model


def main() -> None:
    """Entry point of ``ros2 run mrd_identification identify``."""
    run_tool(work)


def work() -> None:
    """Parse, identify, write, report."""
    parser = argparse.ArgumentParser(
        prog="identify",
        description="Identify a damper model from recordings by NSGA-II and least squares; writes fit.json and fit.html.",
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help="bag folder, .mcap or .db3 file, or CSV")
    parser.add_argument("--model", required=True, help=f"one of {', '.join(MODELS)}")
    parser.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs that judge the fit")
    parser.add_argument("--population", type=int, default=POPULATION, help="of NSGA-II (default %(default)s)")
    parser.add_argument("--generations", type=int, default=GENERATIONS, help="of NSGA-II (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="same seed, same result (default %(default)s)")
    parser.add_argument("--no-polish", action="store_true", help="keep the knee of the front as it is")
    parser.add_argument("--output", required=True, metavar="DIR", help="where fit.json and fit.html go")
    arguments = parser.parse_args()
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")

    find_model(arguments.model)
    folder = make_folder(arguments.output)
    runs = read_runs([*arguments.runs, *arguments.held_out])
    fitted, held_out = runs[: len(arguments.runs)], runs[len(arguments.runs) :]
    with tqdm(
        total=arguments.generations, desc="NSGA-II", unit="gen", file=sys.stderr, disable=None, leave=False
    ) as bar:

        def progress(_generation: int, nrmse: float) -> None:
            bar.set_postfix_str(f"NRMSE {nrmse:.4f}", refresh=False)
            bar.update()

        fit = identify(
            fitted,
            arguments.model,
            held_out=held_out,
            population=arguments.population,
            generations=arguments.generations,
            seed=arguments.seed,
            polish_result=not arguments.no_polish,
            progress=progress,
        )
    write_fit(fit, folder)
    report = write_report(fit, folder)
    print(sentence(fit))
    for warning in fit.warnings:
        print(f"note: {warning}")
    print(f"{report}")
