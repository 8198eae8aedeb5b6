"""Compare control laws on roads with dampers: one table, one page."""

import argparse
from functools import partial
from itertools import product
from pathlib import Path

from rich.table import Column, Table

from mrd_base import InputError, run_tool
from mrd_base.console import print_table
from mrd_base.json_file import make_folder
from mrd_base.progress import shown_progress
from mrd_control.controller import Actuator
from mrd_control.evaluation import Candidate, Conditions, evaluate, optimise_gains, parse_candidate
from mrd_control.excitations import Excitation, Road, read_excitation
from mrd_control.excitations.road import CLASSES
from mrd_control.laws import LAWS, find_law
from mrd_control.prediction import PREDICTORS
from mrd_control.report import columns, knee_columns, knee_rows, rows, sentence, write_evaluation
from mrd_control.ride import DataSheet
from mrd_control.systems import SYSTEMS, System, read_system
from mrd_identification.export import load_damper
from mrd_sim.cli.options import add_effects_folder, add_models_folder
from mrd_sim.damper import Damper, parse_values
from mrd_sim.models import MODELS
from mrd_sim.plant import DamperConfig, read_damper
from mrd_trajectory.limits import LARGEST_CURRENT

LONGEST = 3600.0
"""s of a run."""


def main() -> None:
    """Entry point of ``ros2 run mrd_control evaluate``."""
    run_tool(work)


def work() -> None:
    """Read the arguments, run the loops, write page and file, print the table."""
    arguments = _parser().parse_args()
    conditions = _conditions(arguments)
    system = _read_system(arguments.system)
    dampers = _read_dampers(arguments)
    candidates = [parse_candidate(text) for text in arguments.laws] or [Candidate(name, name) for name in LAWS]
    excitations = _read_excitations(arguments)
    searched = [find_law(name) for name in arguments.pareto]
    make_folder(arguments.output)
    runs = len(dampers) * len(excitations) * (len(candidates) + len(conditions.currents))
    with shown_progress("evaluating") as report:
        evaluation = evaluate(
            system, dampers, candidates, excitations, conditions, arguments.scheduler, lambda count: report("", count / runs)
        )
    fronts = []
    for law, damper, excitation in product(searched, dampers.items(), excitations.items()):
        with shown_progress(f"searching the gains of {law.id} on {excitation[0]} with {damper[0]}") as report:
            found = optimise_gains(
                system,
                damper,
                law,
                excitation,
                conditions,
                arguments.population,
                arguments.generations,
                arguments.seed,
                partial(report, ""),
            )
        fronts.append(found)
    system_file = [] if arguments.system in SYSTEMS else [arguments.system]
    files = [*arguments.damper, *system_file, *arguments.excitation]
    page = write_evaluation(evaluation, fronts, arguments.output, files)
    _print(columns(evaluation), rows(evaluation), 1)
    if fronts:
        _print(knee_columns(fronts), knee_rows(fronts), 4)
    print(sentence(evaluation))
    print(page)


def _print(titles: list[str], lines: list[list[str]], left: int) -> None:
    """Print a table whose first columns are words."""
    table = Table(*titles[:left], *(Column(title, justify="right") for title in titles[left:]), box=None)
    for line in lines:
        table.add_row(*line)
    print_table(table)


def _conditions(arguments: argparse.Namespace) -> Conditions:
    """Return the conditions of the arguments, which are refused where no loop could run."""
    for name, value, lower, upper in (
        ("--rate", arguments.rate, 50.0, 20e3),
        ("--duration", arguments.duration, 5.0, LONGEST),
        ("--most-current", arguments.most_current, 0.01, LARGEST_CURRENT),
        ("--stroke", arguments.stroke, 0.1, 2000.0),
        ("--coil-resistance", arguments.coil_resistance, 0.0, 1e4),
        ("--delay", arguments.delay or 0.0, 0.0, 200.0),
        ("--lag", arguments.lag, 0.0, 200.0),
        ("--population", arguments.population, 4, 1000),
        ("--generations", arguments.generations, 1, 1000),
    ):
        if not lower <= value <= upper:
            raise InputError(f"{name} is {value:g}, expected {lower:g} to {upper:g}")
    if arguments.delay is None:
        if arguments.lag or arguments.predictor != "none":
            raise InputError("--lag and --predictor are of the actuator of a hybrid test; give its --delay, which may be 0")
        actuator = None
    else:
        actuator = Actuator(1e-3 * arguments.delay, 1e-3 * arguments.lag, arguments.predictor)
    return Conditions(
        arguments.rate,
        arguments.duration,
        most_current=arguments.most_current,
        actuator=actuator,
        data_sheet=DataSheet(1e-3 * arguments.stroke, arguments.coil_resistance),
    )


def _read_system(text: str) -> System:
    """Return the emulated system that is named, or described by a file."""
    if text in SYSTEMS:
        return SYSTEMS[text]()
    if Path(text).suffix not in (".yaml", ".yml"):
        raise InputError(f"--system {text}: expected one of {', '.join(SYSTEMS)}, or a YAML file")
    return read_system(text)


def _read_dampers(arguments: argparse.Namespace) -> dict[str, Damper]:
    """Return the dampers by label: fits, plants, models; without any, that of the simulated bench."""
    dampers: dict[str, Damper] = {}
    for path in arguments.damper:
        file = Path(path)
        label = file.stem if file.stem != "fit" else file.resolve().parent.name
        if label in dampers:
            raise InputError(f"--damper {path}: another damper is called {label} as well; rename its folder or file")
        dampers[label] = load_damper(path) if file.suffix == ".json" else read_damper(path).build()
    if arguments.model:
        dampers[arguments.model] = Damper(arguments.model, parse_values(arguments.parameters, "--parameters"))
    elif arguments.parameters:
        raise InputError("--parameters are those of a --model, which is missing")
    return dampers or {"bench": DamperConfig().build()}


def _read_excitations(arguments: argparse.Namespace) -> dict[str, Excitation]:
    """Return the excitations by label."""
    excitations: dict[str, Excitation] = {}
    if not 0.1 <= arguments.speed <= 150.0:
        raise InputError(f"--speed is {arguments.speed:g} m/s, expected 0.1 to 150")
    if not 0 <= arguments.seed < 2**31:
        raise InputError(f"--seed is {arguments.seed}, expected 0 to {2**31 - 1}")
    files = arguments.excitation
    for name in filter(None, arguments.roads.split(",") if arguments.roads is not None else [] if files else ["B", "C"]):
        if name not in CLASSES:
            raise InputError(f"--roads: unknown class {name} (known: {', '.join(CLASSES)})")
        excitations[f"class {name}, {arguments.speed:g} m/s"] = Road(name, arguments.speed, seed=arguments.seed)
    for path in files:
        excitations[Path(path).stem] = read_excitation(path)
    if not excitations:
        raise InputError("--roads is empty, expected classes of ISO 8608 such as B,C, or an --excitation")
    return excitations


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Close the loop of an emulated mechanical system, a control law and a damper offline, for every law on "
        "every road with every damper; writes evaluation.json and evaluation.html."
    )
    parser.add_argument(
        "--system",
        default="quarter_car",
        metavar="NAME|FILE.yaml",
        help=f"{', '.join(SYSTEMS)}, or a file with its parameters (default %(default)s)",
    )
    parser.add_argument(
        "--damper",
        action="append",
        default=[],
        metavar="FIT.json|PLANT.yaml",
        help="identified damper or that of a simulated bench; may be repeated (default: the simulated bench's)",
    )
    parser.add_argument("--model", default="", help=f"a damper model instead: one of {', '.join(MODELS)}")
    parser.add_argument("--parameters", default="", metavar="'{NAME: VALUE}'", help="of the model, in SI")
    add_effects_folder(parser)
    add_models_folder(parser)
    parser.add_argument(
        "--laws",
        nargs="+",
        default=[],
        metavar="LAW[:NAME=VALUE,...]",
        help=f"control laws with their gains: {', '.join(LAWS)} (default: all)",
    )
    parser.add_argument("--roads", metavar="CLASS,...", help="classes of ISO 8608, A to H (default: B,C)")
    parser.add_argument("--speed", type=float, default=20.0, help="speed on these roads in m/s (default %(default)g)")
    parser.add_argument(
        "--excitation",
        action="append",
        default=[],
        metavar="FILE.yaml",
        help="road, bump, sine_sweep, ground_motion or recorded_profile with its parameters; may be repeated",
    )
    parser.add_argument("--duration", type=float, default=60.0, help="duration of each run in s (default %(default)g)")
    parser.add_argument("--rate", type=float, default=1000.0, help="sample rate in Hz (default %(default)g)")
    parser.add_argument(
        "--most-current", type=float, default=1.0, help="largest current of the supply in A (default %(default)g)"
    )
    parser.add_argument(
        "--stroke",
        type=float,
        default=1e3 * DataSheet.stroke,
        metavar="MM",
        help="stroke of the damper from end to end (default %(default)g)",
    )
    parser.add_argument(
        "--coil-resistance",
        type=float,
        default=DataSheet.coil_resistance,
        metavar="OHM",
        help="resistance of its coil (default %(default)g)",
    )
    parser.add_argument("--delay", type=float, metavar="MS", help="dead time of the actuator of a hybrid test")
    parser.add_argument(
        "--lag", type=float, default=0.0, metavar="MS", help="first-order lag of this actuator (default %(default)g)"
    )
    parser.add_argument(
        "--predictor", choices=list(PREDICTORS), default="none", help="compensation of delay and lag (default %(default)s)"
    )
    parser.add_argument(
        "--pareto",
        nargs="+",
        default=[],
        metavar="LAW",
        help="search the gains of laws for comfort against contact force, anew on each road with each damper",
    )
    parser.add_argument("--population", type=int, default=24, help="population of NSGA-II (default %(default)s)")
    parser.add_argument("--generations", type=int, default=12, help="generations of NSGA-II (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of roads and search (default %(default)s)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="run the loops on the dask cluster of this scheduler")
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the results")
    return parser
