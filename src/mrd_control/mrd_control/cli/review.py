"""Compare a recorded hybrid test with its offline twin: ride metrics and tracking, one table, one page."""

import argparse

from mrd_base import run_tool
from mrd_control.comparison import Comparison, compare_with_twin, write_comparison
from mrd_control.recording import read_hybrid_run
from mrd_identification.json_file import make_folder


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
    arguments = parser.parse_args()
    make_folder(arguments.output)
    comparison = compare_with_twin(read_hybrid_run(arguments.run))
    print_comparison(comparison)
    print(write_comparison(comparison, arguments.output))


def print_comparison(comparison: Comparison) -> None:
    """Print tracking, ride metrics and timing."""
    print(f"{'metric':18} {'bench':>10} {'twin':>10}")
    for name, bench, twin, difference in comparison.rows():
        print(f"{name:18} {bench:>10} {twin:>10}  {difference}")
    timing = comparison.run.timing
    print(
        f"{len(timing.interval)} cycles at {timing.rate:.1f} Hz, largest jitter {1e3 * timing.jitter:.3f} ms, "
        f"{timing.missed} deadlines missed, {100 * timing.punctual:.2f} % computed within 2 ms"
    )
    print(comparison.sentence)
