"""Options that name a simulator of the user's own."""

import argparse
import math
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from mrd_base import InputError
from mrd_sim.simulators.adjusted import AdjustedSimulator
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
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=VALUE",
        help="other values of the simulator's parameters",
    )
    add_variable_arguments(parser)


def add_variable_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that tell how a simulator is asked."""
    parser.add_argument(
        "--inputs",
        default="",
        metavar="QUANTITY=VARIABLE,...",
        help="inputs of an FMU whose names do not tell: time, position, velocity, acceleration, current; without a "
        "VARIABLE, the FMU has no such input",
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


def take_from_source(arguments: argparse.Namespace, source: str) -> None:
    """Fill what the arguments leave open with what a report says of its simulator (`Simulator.source`)."""
    parser = argparse.ArgumentParser()
    add_simulator_arguments(parser)
    of_report = parser.parse_args(["--simulator", *shlex.split(source)]) if source else parser.parse_args([])
    arguments.simulator = arguments.simulator or of_report.simulator
    arguments.inputs = arguments.inputs or of_report.inputs
    arguments.output_variable = arguments.output_variable or of_report.output_variable
    if arguments.simulator_limit == TIME_LIMIT:
        arguments.simulator_limit = of_report.simulator_limit


@contextmanager
def opened_simulator(arguments: argparse.Namespace) -> Iterator[Simulator | None]:
    """Open the simulator of the arguments, and end it afterwards; None where none is named.

    Raises
    ------
    InputError
        As of `mrd_sim.simulators.opening.open_simulator`; also for options of a simulator without one.
    """
    inputs = parse_inputs(arguments.inputs)
    values = parse_values_set(arguments.set)
    if not arguments.simulator:
        if inputs or arguments.output_variable or values:
            raise InputError("--inputs, --output-variable and --set: belong to a simulator, and there is no --simulator")
        yield None
        return
    with open_simulator(
        arguments.simulator,
        inputs=inputs,
        output=arguments.output_variable,
        limit=arguments.simulator_limit,
        skip=getattr(arguments, "skip", 0.0),
    ) as simulator:
        yield AdjustedSimulator(simulator, values) if values else simulator


def parse_inputs(text: str) -> dict[str, str]:
    """Read variables by quantity from ``QUANTITY=VARIABLE,...``."""
    pairs = [entry.partition("=") for entry in filter(None, text.split(","))]
    for quantity, equals, variable in pairs:
        if not (quantity and equals):
            raise InputError(f"--inputs: found {quantity}{equals}{variable}, expected QUANTITY=VARIABLE,...")
    return {quantity.strip(): variable.strip() for quantity, _, variable in pairs}


def parse_values_set(entries: Sequence[str]) -> dict[str, float]:
    """Read parameters by name from ``NAME=VALUE`` each."""
    values = {}
    for entry in entries:
        name, _, text = entry.rpartition("=")
        try:
            values[name] = float(text)
        except ValueError:
            values[name] = math.nan
        if not (name and math.isfinite(values[name])):
            raise InputError(f"--set: found {entry}, expected NAME=VALUE with a number")
    return values


def parse_free(entries: Sequence[str]) -> dict[str, tuple[float, float] | None]:
    """Read bounds of parameters by name from ``NAME`` or ``NAME:LOW:HIGH`` each."""
    free: dict[str, tuple[float, float] | None] = {}
    for entry in entries:
        parts = entry.rsplit(":", 2)
        try:
            bounds = None if len(parts) == 1 else (float(parts[1]), float(parts[2]))
        except (ValueError, IndexError):
            raise InputError(f"--free: found {entry}, expected NAME or NAME:LOW:HIGH with two numbers") from None
        free[parts[0]] = bounds
    return free
