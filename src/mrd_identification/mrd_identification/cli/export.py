"""Write a fitted model as C source or as an FMU."""

import argparse

from mrd_base import run_tool
from mrd_identification.export import export_damper


def main() -> None:
    """Entry point of ``ros2 run mrd_identification export``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, export, print what was written."""
    parser = argparse.ArgumentParser(
        description="Write a fitted model as self-contained C source or as an FMI 2.0 co-simulation FMU."
    )
    parser.add_argument("fit", metavar="FIT.json", help="file that identify wrote")
    parser.add_argument("--output", required=True, metavar="FILE.c|FILE.fmu", help="new file; its ending selects C or FMU")
    parser.add_argument(
        "--prefix", default="mrd", metavar="NAME", help="prefix of the names in the C file (default %(default)s)"
    )
    arguments = parser.parse_args()
    damper = export_damper(arguments.fit, arguments.output, arguments.prefix)
    print(f"{arguments.output}: {damper.model.title}, {len(damper.model.parameters)} parameters")
