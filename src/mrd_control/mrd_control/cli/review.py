"""Compare a recorded hybrid test with its offline twin: ride metrics and tracking, one table, one page."""

import argparse

from mrd_base import run_tool
from mrd_base.json_file import make_folder
from mrd_base.tool import command
from mrd_control.comparison import Comparison, compare_with_twin, write_comparison
from mrd_control.recording import read_hybrid_run
from mrd_identification.export import load_damper


def main() -> None:
    """Entry point of ``ros2 run mrd_control review``."""
    run_tool(work)


def work() -> None:
    """Read the bag, run the twin, write page and file, print the table."""
    parser = argparse.ArgumentParser(
        description="Compare a recorded hybrid test with its offline twin; writes hybrid_test.json and hybrid_test.html."
    )
    parser.add_argument("run", metavar="BAG", help="bag of a hybrid test")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the results")
    parser.add_argument(
        "--diagnosis",
        metavar="GAP_REPORT.json",
        help="what diagnose wrote of this recording, or a plant.yaml of apply: explain the difference in ride by its causes",
    )
    arguments = parser.parse_args()
    run = read_hybrid_run(arguments.run)
    damper = load_damper(arguments.diagnosis) if arguments.diagnosis else None
    make_folder(arguments.output)
    comparison = compare_with_twin(run, damper)
    print_comparison(comparison)
    page = write_comparison(comparison, arguments.output)
    if damper is None:
        diagnose, review = command("mrd_diagnosis", "diagnose"), command("mrd_control", "review")
        model = run.experiment.damper.model.id
        print(f"Next, what explains the difference: {diagnose} {run.bag} --model {model} --output DIR")
        print(f"and then: {review} {run.bag} --diagnosis DIR/gap_report.json --output {arguments.output}")
    print(page)


def print_comparison(comparison: Comparison) -> None:
    """Print tracking, ride metrics and timing."""
    print(f"{'metric':32} {'bench':>10} {'twin':>10}")
    for name, bench, twin, difference in comparison.rows():
        print(f"{name:32} {bench:>10} {twin:>10}  {difference}")
    if comparison.explanation:
        print(
            f"\n{'in % of the twin':18}",
            *(f"{cause:>18}" for cause in ("difference", *comparison.explanation.causes, "rest")),
        )
        for row in comparison.explained_rows():
            print(f"{row[0]:18}", *(f"{value:>18}" for value in row[1:]))
        print()
    timing = comparison.run.timing
    print(
        f"{len(timing.interval)} cycles at {timing.rate:.1f} Hz, largest jitter {1e3 * timing.jitter:.3f} ms, "
        f"{timing.missed} deadlines missed, {100 * timing.punctual:.2f} % computed within 2 ms"
    )
    print(comparison.sentence)
