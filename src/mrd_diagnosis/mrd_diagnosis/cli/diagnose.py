"""The tool ``diagnose``: explain the gap between simulator and recordings."""

import argparse
import os
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from mrd_base import FaultError, InputError, run_tool
from mrd_base.console import print_table
from mrd_base.json_file import make_folder
from mrd_base.progress import shown_progress
from mrd_diagnosis.diagnose import BEST_MODEL, diagnose
from mrd_diagnosis.diagnosis import Diagnosis
from mrd_diagnosis.report.candidate_text import (
    LEAST_SHOWN,
    describe_candidate,
    nothing_removes,
    ordered_candidates,
    with_probabilities,
)
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.report.sentences import next_command, next_step, placeholders
from mrd_identification.cli.options import add_run_arguments, announce, read_arguments_runs
from mrd_identification.fit_file import read_fit
from mrd_identification.preflight.finding import Finding
from mrd_runs.read import describe_runs
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.cli.simulator_options import add_simulator_arguments, opened_simulator, parse_free
from mrd_sim.compile_ahead import compile_beside
from mrd_sim.current import LAWS, parse_laws
from mrd_sim.effects import find_effects
from mrd_sim.models import MODELS, find_model
from mrd_trajectory.settings import read_settings

MOST_ROWS = 8
"""Candidates that the terminal shows; the page and the file list all of them."""


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis diagnose``."""
    compile_beside()
    run_tool(work)


def work() -> None:
    """Read the arguments and the runs, diagnose, write the reports and print a summary."""
    parser = argparse.ArgumentParser(
        description="Find where a damper model and recordings disagree, which missing effect causes the gap, and how much "
        "of it the effect removes. Writes gap_report.json, gap_report.html and, where an experiment is advised, "
        "next_experiment.yaml."
    )
    add_run_arguments(parser)
    parser.add_argument(
        "--reference",
        nargs="+",
        default=[],
        metavar="RUN",
        help="runs of the same rig from before something changed: explain the change instead of the gap to the model",
    )
    parser.add_argument(
        "--model",
        default=BEST_MODEL,
        help=f"one of {', '.join(MODELS)}; default: {BEST_MODEL}, the one that predicts the recordings best",
    )
    add_simulator_arguments(parser)
    parser.add_argument(
        "--free",
        nargs="+",
        default=[],
        metavar="NAME[:LOW:HIGH]",
        help="parameters of the simulator that are refitted to the recordings first",
    )
    parser.add_argument(
        "--parameters",
        metavar="FIT.json",
        help="parameters of the simulator as it is, from identify; default: fit the model first",
    )
    parser.add_argument(
        "--law", default="", metavar="LAW|COEFFICIENT=LAW,...", help=f"current laws of the model: {', '.join(LAWS)}"
    )
    parser.add_argument(
        "--effects", default="", metavar="ID,...", help="effects to try (default: all); `effects` lists them"
    )
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument(
        "--bench",
        metavar="FILE",
        default=os.environ.get("MRD_BENCH"),
        help="bench.yaml whose limits an advised experiment must not exceed; default: $MRD_BENCH",
    )
    parser.add_argument("--seed", type=int, default=0, help="same seed, same result but for rounding (default %(default)s)")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the reports")
    arguments = parser.parse_args()
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")
    effects = tuple(filter(None, arguments.effects.split(",")))
    laws = parse_laws(arguments.law, "--law")
    if arguments.model != BEST_MODEL:
        find_model(arguments.model, laws)
    find_effects(effects)
    if arguments.simulator and (arguments.parameters or laws):
        raise InputError(
            "--simulator: found --parameters or --law as well, which belong to a model of the catalogue; leave them out"
        )
    parameters = read_fit(arguments.parameters) if arguments.parameters else None
    free = parse_free(arguments.free)
    if free and not arguments.simulator:
        raise InputError("--free: names parameters of a simulator, and there is no --simulator")
    bench = read_settings(arguments.bench)
    runs, held_out, reference = read_arguments_runs(arguments, "reference")
    folder = make_folder(arguments.output)
    announce(describe_runs([*runs, *held_out, *reference]))
    with opened_simulator(arguments) as simulator, shown_progress("diagnosing") as progress:
        diagnosis = diagnose(
            runs,
            arguments.model,
            held_out=held_out,
            reference=reference,
            parameters=parameters,
            simulator=simulator,
            free=free,
            laws=laws or None,
            effects=effects,
            bench=bench,
            seed=arguments.seed,
            progress=progress,
        )
    page = write_gap_report(diagnosis, folder)
    print_summary(diagnosis, page)
    if diagnosis.verdict == "data_fault":
        raise FaultError(f"the recordings are faulty, so that nothing was diagnosed; {page} tells how to mend them")


def print_summary(diagnosis: Diagnosis, page: Path) -> None:
    """Print the verdict, what to do next, findings, candidates, notes and the paths of the reports."""
    print(diagnosis.sentence)
    if step := next_step(diagnosis):
        print(f"next step: {step}")
    if command := next_command(diagnosis, str(page.parent)):
        print(f"next command: {command}")
        for meaning in placeholders(command):
            print(f"  {meaning}")
    for finding in shown_findings(diagnosis):
        print(f"{finding.severity}: {finding.sentence}")
    if diagnosis.candidates and diagnosis.verdict == "no_gap":
        print(f"{len(diagnosis.candidates)} effects were tried. None is needed to explain the error.")
    elif diagnosis.candidates and nothing_removes(diagnosis):
        print(f"{len(diagnosis.candidates)} effects were tried; none removes more than {100 * LEAST_SHOWN:g} % of the gap.")
    elif diagnosis.candidates:
        print_table(candidate_table(diagnosis), beneath={"remark"})
        if diagnosis.held_out_by != "blocks":
            print(
                "The figures of the table are for segments of runs that were not fitted, those at the top for whole runs; "
                "they differ a little."
            )
        if len(diagnosis.candidates) > MOST_ROWS:
            print(f"The table shows the best {MOST_ROWS} of {len(diagnosis.candidates)} candidates; the report lists all.")
    for note in diagnosis.notes:
        print(f"note: {note}")
    paths = [page, page.with_suffix(".json")]
    if diagnosis.next_experiment and diagnosis.next_experiment.experiment:
        paths.append(page.with_name("next_experiment.yaml"))
    for path in paths:
        print(path)


def shown_findings(diagnosis: Diagnosis) -> list[Finding]:
    """Return the findings to print below the verdict.

    Where a fault ended the diagnosis, the verdict is the first fault, and what else was found may follow from it.
    """
    if diagnosis.verdict != "data_fault":
        return list(diagnosis.findings)
    faults = [finding for finding in diagnosis.findings if finding.severity == "fault"]
    return faults[1:] if faults else list(diagnosis.findings)


def candidate_table(diagnosis: Diagnosis) -> Table:
    """Return the best candidates as a table for a terminal; 95 % intervals in brackets."""
    table = Table(box=None)
    table.add_column("effects")
    first = 0 if with_probabilities(diagnosis) else 1
    for title in ("probability", "gap removed, by segments", "held-out error (NRMSE), by segments")[first:]:
        table.add_column(title, justify="right")
    table.add_column("remark")
    for candidate in ordered_candidates(diagnosis)[:MOST_ROWS]:
        text = describe_candidate(diagnosis, candidate)
        columns = (text.probability, text.removed, text.error, text.remark)[first:]
        table.add_row(escape(" + ".join(candidate.effects)), *map(escape, columns))
    return table
