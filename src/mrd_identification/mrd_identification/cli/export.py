"""Write a fitted model as C source or as an FMU."""

import argparse
import shlex
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_identification.export import export_damper, source_of_simulator
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.cli.simulator_options import add_simulator_arguments, opened_simulator, take_from_source
from mrd_sim.fmu import VERSIONS


def main() -> None:
    """Entry point of ``ros2 run mrd_identification export``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, export, print what was written."""
    parser = argparse.ArgumentParser(
        description="Write a fitted damper as self-contained C source or as a co-simulation FMU. Of a diagnosis of an FMU "
        "of your own, the new FMU carries yours, with the effects around it."
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
    parser.add_argument("--fmi", type=int, choices=VERSIONS, help="version of the standard of an FMU (default 2)")
    parser.add_argument(
        "--block",
        action="store_true",
        help="for a diagnosis of an FMU of your own: a block that gets its force as an input, and does not carry it",
    )
    add_simulator_arguments(parser)
    arguments = parser.parse_args()
    if arguments.block and arguments.simulator:
        raise InputError("--block: gets the force of the simulator as an input; leave out --simulator")
    if not arguments.block and Path(arguments.output).suffix == ".fmu":
        source = source_of_simulator(arguments.damper)
        file = next(iter(shlex.split(source)), "")
        wraps = file.lower().endswith(".fmu")
        if wraps and not arguments.simulator and not Path(file).is_file():
            raise InputError(
                f"{arguments.damper}: corrects the simulator {file}, which is no longer there; name it with "
                "--simulator, or add --block for a block that gets its force as an input"
            )
        if wraps:
            take_from_source(arguments, source)
    with opened_simulator(arguments) as simulator:
        exported = export_damper(
            arguments.damper,
            arguments.output,
            arguments.prefix,
            arguments.without_effects,
            arguments.anyway,
            simulator,
            arguments.fmi,
        )
    damper = exported.damper
    print(f"{arguments.output}: {damper.description}, {len(damper.model.parameters)} parameters ({exported.kind})")
    for note in exported.notes:
        print(f"note: {note}")
