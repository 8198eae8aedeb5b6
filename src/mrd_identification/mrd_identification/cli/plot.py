"""The tool ``plot``: look at recordings, and at what dampers or simulators answer to them."""

import argparse
from contextlib import ExitStack
from pathlib import Path

from mrd_base import InputError, run_tool
from mrd_base.json_file import make_folder
from mrd_identification.cli.options import add_reading_arguments
from mrd_identification.export import load_damper
from mrd_identification.low_pass import with_force_filters
from mrd_identification.plot import write_plot
from mrd_runs import read_runs
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.cli.simulator_options import add_variable_arguments, parse_inputs
from mrd_sim.damper import Damper
from mrd_sim.simulators.command import COMMAND
from mrd_sim.simulators.opening import is_simulator, open_simulator
from mrd_sim.simulators.simulator import Simulator

DAMPER_FILES = (".json", ".yaml", ".yml")
"""Ends of the names of files that describe a damper."""


def main() -> None:
    """Entry point of ``ros2 run mrd_identification plot``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, predict where a damper is given, write the page."""
    parser = argparse.ArgumentParser(
        description="Look at recordings: plot.html shows them over time and as loops, any number laid over each other. Fits "
        "and simulators that are named as well are shown beside them, from the same motion and current."
    )
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="RUN|FIT|SIMULATOR",
        help="recordings; files of identify, diagnose or apply; FMUs, Python files with a function force, commands after "
        f"'{COMMAND}'",
    )
    add_variable_arguments(parser)
    add_reading_arguments(parser)
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the page")
    arguments = parser.parse_args()
    simulators = [name for name in arguments.sources if is_simulator(name)]
    dampers = [name for name in arguments.sources if Path(name).suffix.lower() in DAMPER_FILES and Path(name).is_file()]
    paths = [name for name in arguments.sources if name not in (*simulators, *dampers)]
    if not paths:
        raise InputError("no recording to plot, expected one at least; a fit or a simulator is shown along recordings")
    if (arguments.inputs or arguments.output_variable) and not any(name.lower().endswith(".fmu") for name in simulators):
        raise InputError("--inputs and --output-variable name variables of an FMU, and there is none")
    (runs,) = with_force_filters([read_runs(paths, arguments.skip)], arguments.force_filter, "--force-filter")
    with ExitStack() as stack:
        shown: dict[str, Damper | Simulator] = {name: load_damper(name, anyway=True) for name in dampers}
        for name in simulators:
            is_fmu = Path(name).suffix.lower() == ".fmu"
            inputs, output = (parse_inputs(arguments.inputs), arguments.output_variable) if is_fmu else ({}, "")
            opened = open_simulator(name, inputs=inputs, output=output, limit=arguments.simulator_limit)
            shown[name if opened.name in shown else opened.name] = stack.enter_context(opened)
        print(write_plot(runs, make_folder(arguments.output), shown))
