"""The tool ``batch``: what the tests of many dampers tell together."""

import argparse
import sys

from mrd_base import run_tool
from mrd_base.json_file import make_folder
from mrd_characterisation.batch import read_batch
from mrd_characterisation.batch_file import write_batch


def main() -> None:
    """Entry point of ``ros2 run mrd_characterisation batch``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, read the tests, write the files, print which dampers failed."""
    parser = argparse.ArgumentParser(
        description="Read all acceptance.json and characterisation.json below a folder: dampers that failed, mean and "
        "spread, Cp and Cpk, change over time. Writes batch.json, batch.csv and batch.html."
    )
    parser.add_argument(
        "folder", metavar="FOLDER", help="folder with a folder for each damper, as accept and characterise write them"
    )
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the files")
    arguments = parser.parse_args()
    batch = read_batch(arguments.folder)
    written = write_batch(batch, make_folder(arguments.output))
    print(*(f"note: {note}" for note in batch.notes), sep="\n", end="\n" if batch.notes else "", file=sys.stderr)
    print(batch.sentence)
    for word, verdict in (("failed", "fail"), ("not decided", "not_decided")):
        serials = [entry.serial for entry in batch.entries if entry.verdict == verdict]
        if serials:
            print(f"{word}: {', '.join(serials)}")
    print(*written, sep="\n")
