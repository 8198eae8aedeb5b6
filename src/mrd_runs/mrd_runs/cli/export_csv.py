"""Write the samples of a bag as a CSV file, and its setpoints and servo states into files beside it."""

import argparse
import sys
from functools import partial
from pathlib import Path

from mrd_base import run_tool
from mrd_runs.csv_export import export_csv


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag folder, .mcap or .db3 file")
    parser.add_argument("--output", type=Path, metavar="FILE", help="CSV file of the samples; by default beside BAG")
    arguments = parser.parse_args()
    run_tool(lambda: _export(arguments.bag, arguments.output))


def _export(bag: Path, output: Path | None) -> None:
    name = bag.resolve().name if bag.is_dir() else bag.stem
    target = output or bag.resolve().parent / f"{name}.csv"
    for path, rows in export_csv(bag, target, partial(print, file=sys.stderr)).items():
        print(f"{path}: {rows} rows")
