"""Make a readable bag of each damaged one: not closed, cut off, or damaged in places. The damaged one is not changed."""

import argparse
from pathlib import Path

from mrd_base import run_tool
from mrd_runs.recovery import recover_bag, recovered_path


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="bag folder, .mcap or .db3 file, in any state")
    parser.add_argument(
        "--output", type=Path, metavar="DIR", help="folder for the new bags, NAME_recovered; by default that of each BAG"
    )
    arguments = parser.parse_args()
    run_tool(lambda: _recover(arguments.bags, arguments.output))


def _recover(bags: list[Path], folder: Path | None) -> None:
    for bag in bags:
        recovery = recover_bag(bag, recovered_path(bag, folder))
        counts = ", ".join(f"{count} of {topic}" for topic, count in recovery.counts.items())
        print(f"{recovery.path}: recovered {sum(recovery.counts.values())} messages ({counts})")
        print(*(f"  lost: {loss}" for loss in recovery.losses or ["nothing"]), sep="\n")
