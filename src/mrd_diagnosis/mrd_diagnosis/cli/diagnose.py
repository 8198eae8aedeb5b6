"""Explain the gap between simulator and recordings."""

import argparse
import os
import sys

from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tqdm import tqdm

from mrd_base import InputError, run_tool
from mrd_diagnosis.diagnose import diagnose
from mrd_diagnosis.diagnosis import Candidate, Diagnosis
from mrd_diagnosis.report.page import write_gap_report
from mrd_diagnosis.quantities import format_share
from mrd_identification.cli.options import add_run_arguments, read_arguments_runs
from mrd_identification.fit_file import read_fit
from mrd_identification.json_file import make_folder
from mrd_sim.cli.options import add_effects_folder
from mrd_sim.current import LAWS, parse_laws
from mrd_sim.effects import find_effects
from mrd_sim.models import MODELS, find_model
from mrd_trajectory.settings import read_settings

MOST_ROWS = 8
"""Candidates that the terminal shows; the report has all."""


def main() -> None:
    """Entry point of ``ros2 run mrd_diagnosis diagnose``."""
    run_tool(work)


def work() -> None:
    """Parse, diagnose, write, report."""
    parser = argparse.ArgumentParser(
        prog="diagnose",
        description="Find where a damper model and recordings disagree, which missing effect causes it, and how far the gap "
        "shrinks with it; writes gap_report.json and gap_report.html.",
    )
    add_run_arguments(parser)
    parser.add_argument("--model", required=True, help=f"one of {', '.join(MODELS)}")
    parser.add_argument("--parameters", metavar="FIT.json", help="the simulator as it is: a fit of the model to start from")
    parser.add_argument(
        "--law", default="", metavar="LAW|COEFFICIENT=LAW,...", help=f"current laws of the model: {', '.join(LAWS)}"
    )
    parser.add_argument(
        "--effects", default="", metavar="ID,...", help="candidates (ros2 run mrd_sim effects lists them; default: all)"
    )
    add_effects_folder(parser)
    parser.add_argument(
        "--bench",
        metavar="FILE",
        default=os.environ.get("MRD_BENCH"),
        help="bench.yaml whose limits an advised experiment must not exceed; default: $MRD_BENCH",
    )
    parser.add_argument("--seed", type=int, default=0, help="same seed, same result (default %(default)s)")
    parser.add_argument("--output", required=True, metavar="DIR", help="where gap_report.json and gap_report.html go")
    arguments = parser.parse_args()
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")
    effects = tuple(filter(None, arguments.effects.split(",")))
    laws = parse_laws(arguments.law, "--law")
    find_model(arguments.model, laws)
    find_effects(effects)
    parameters = read_fit(arguments.parameters) if arguments.parameters else None
    bench = read_settings(arguments.bench)
    runs, held_out = read_arguments_runs(arguments)
    folder = make_folder(arguments.output)
    with tqdm(total=100, desc="diagnosing", unit="%", file=sys.stderr, disable=None, leave=False) as bar:

        def progress(stage: str, fraction: float) -> None:
            bar.set_description_str(stage, refresh=False)
            bar.update(int(100 * fraction) - bar.n)

        found = diagnose(
            runs,
            arguments.model,
            held_out=held_out,
            parameters=parameters,
            laws=laws or None,
            effects=effects,
            bench=bench,
            seed=arguments.seed,
            progress=progress,
        )
    page = write_gap_report(found, folder)
    print(found.sentence)
    for finding in found.findings:
        print(f"{finding.severity}: {': '.join(filter(None, (finding.run, finding.text)))}")
    if found.candidates:
        Console().print(table(found))
    if found.next_experiment:
        print(f"next: {found.next_experiment.text}")
    for note in found.notes:
        print(f"note: {note}")
    print(page)
    print(page.with_suffix(".json"))


def table(found: Diagnosis) -> Table:
    """The leading candidates for a terminal, by what they close of the gap on unseen runs; intervals of 95 % in brackets."""
    ranking = Table(box=None)
    ranking.add_column("effect", min_width=22, overflow="fold")
    for title in ("probability", "closes", "NRMSE", "p"):
        ranking.add_column(title, justify="right", no_wrap=True)
    ranking.add_column("remark")
    for candidate in found.candidates[:MOST_ROWS]:
        ranking.add_row(
            escape(" + ".join(candidate.effects)),
            format_share(candidate.probability),
            format_share(candidate.closed_fraction),
            f"{candidate.nrmse:.4f}",
            f"{candidate.p_value:.3f}",
            escape(_remark(candidate)),
        )
    return ranking


def _remark(candidate: Candidate) -> str:
    alike = f"like {', '.join(candidate.indistinguishable)}" if candidate.indistinguishable else ""
    return "; ".join(filter(None, (candidate.remark, alike)))
