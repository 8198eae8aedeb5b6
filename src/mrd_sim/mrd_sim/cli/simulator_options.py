"""Options that name a simulator of the user's own."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from mrd_base import InputError
from mrd_sim.simulators.command import COMMAND
from mrd_sim.simulators.opening import open_simulator
from mrd_sim.simulators.process import TIME_LIMIT
from mrd_sim.simulators.simulator import Simulator


def add_simulator_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a simulator."""
    parser.add_argument(
        "--simulator",
        nargs="+",
        default=[],
        metavar="S",
        help="a simulator of your own: an FMU, a Python file with a function force, a command after "
        f"'{COMMAND}', or recordings of a simulator, one for each run",
    )
    add_variable_arguments(parser)


def add_variable_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that tell how a simulator is asked."""
    parser.add_argument(
        "--inputs",
        default="",
        metavar="QUANTITY=VARIABLE,...",
        help="inputs of an FMU whose names do not tell: time, position, velocity, acceleration, current",
    )
    parser.add_argument(
        "--output-variable", default="", metavar="VARIABLE", help="force of an FMU, where its name does not tell"
    )
    parser.add_argument(
        "--simulator-limit",
        type=float,
        default=TIME_LIMIT,
        metavar="SECONDS",
        help="time that one answer of the simulator may take (default %(default)g s)",
    )


@contextmanager
def opened_simulator(arguments: argparse.Namespace) -> Iterator[Simulator | None]:
    """Open the simulator of the arguments, and end it afterwards; None where none is named.

    Raises
    ------
    InputError
        As of `mrd_sim.simulators.opening.open_simulator`; also for options of a simulator without one.
    """
    inputs = parse_inputs(arguments.inputs)
    if not arguments.simulator:
        if inputs or arguments.output_variable:
            raise InputError("--inputs and --output-variable: name variables of an FMU, and there is no --simulator")
        yield None
        return
    with open_simulator(
        arguments.simulator,
        inputs=inputs,
        output=arguments.output_variable,
        limit=arguments.simulator_limit,
        skip=getattr(arguments, "skip", 0.0),
    ) as simulator:
        yield simulator


def parse_inputs(text: str) -> dict[str, str]:
    """Read variables by quantity from ``QUANTITY=VARIABLE,...``."""
    pairs = [entry.partition("=") for entry in filter(None, text.split(","))]
    for quantity, equals, variable in pairs:
        if not (quantity and equals and variable):
            raise InputError(f"--inputs: found {quantity}{equals}{variable}, expected QUANTITY=VARIABLE,...")
    return {quantity.strip(): variable.strip() for quantity, _, variable in pairs}
