"""Make a bag of each CSV file."""

import argparse
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_runs import read_runs
from mrd_runs.bag_import import bag_folders, import_run
from mrd_runs.formats import BAG


def main() -> None:
    parser = argparse.ArgumentParser(prog="import_csv", description=__doc__)
    parser.add_argument(
        "csv",
        nargs="+",
        type=Path,
        metavar="CSV",
        help="header time_s,position_m,current_A,force_N; optionally acceleration_mps2, velocity_mps, temperature_C",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for the bags")
    arguments = parser.parse_args()
    run_tool(lambda: _import(arguments.csv, arguments.output))


def _import(files: list[Path], output: Path) -> None:
    for file in files:
        if file.is_dir() or file.suffix in BAG.suffixes:
            raise InputError(f"{file}: is a bag or a folder; expected a CSV file")
    # All files are read and all folders checked before the first bag is written.
    runs = read_runs(files)
    for run, path in zip(runs, bag_folders(runs, output), strict=True):
        import_run(run, path)
        print(f"{path}: {len(run)} samples")
