"""Write a fitted model as C source or as an FMU."""

import argparse

from mrd_base import run_tool
from mrd_identification.export import export_damper
from mrd_sim.cli.options import add_effects_folder, add_models_folder


def main() -> None:
    """Entry point of ``ros2 run mrd_identification export``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, export, print what was written."""
    parser = argparse.ArgumentParser(
        description="Write a fitted damper as self-contained C source or as an FMI 2.0 co-simulation FMU."
    )
    parser.add_argument(
        "damper",
        metavar="FIT.json|GAP_REPORT.json|PLANT.yaml",
        help="file of identify, of diagnose (its corrected simulator), or of apply",
    )
    parser.add_argument(
        "--without-effects", action="store_true", help="export the damper model alone, without the effects that act with it"
    )
    parser.add_argument(
        "--anyway", action="store_true", help="take the corrected simulator of a diagnosis even if it does not prove it"
    )
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument("--output", required=True, metavar="FILE.c|FILE.fmu", help="new file; its ending selects C or FMU")
    parser.add_argument(
        "--prefix", default="mrd", metavar="NAME", help="prefix of the names in the C file (default %(default)s)"
    )
    arguments = parser.parse_args()
    damper = export_damper(arguments.damper, arguments.output, arguments.prefix, arguments.without_effects, arguments.anyway)
    print(f"{arguments.output}: {damper.description}, {len(damper.model.parameters)} parameters")
