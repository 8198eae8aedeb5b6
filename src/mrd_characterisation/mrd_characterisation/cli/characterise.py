"""Characterise a damper from recordings, as a test of dampers does."""

import argparse
import sys
from collections.abc import Sequence

from rich.table import Table

from mrd_base import InputError, run_tool
from mrd_base.console import print_table
from mrd_base.json_file import make_folder
from mrd_characterisation.characterisation import Characterisation
from mrd_characterisation.characterisation_file import write_characterisation
from mrd_characterisation.characterise import characterise
from mrd_characterisation.cli.options import add_serial, add_test_arguments, errors_in, read_test, write_asked_sheet
from mrd_characterisation.damper_test import checked_serial
from mrd_characterisation.listing import HEAD, value_row
from mrd_characterisation.page import HEADLINES, force_table, write_page
from mrd_characterisation.units import ORIENTATIONS, UNITS, View
from mrd_runs.read import RUN_HELP, describe_runs, read_groups

PRINTED = (*HEADLINES, "response_time_63", "response_time_95", "dynamic_range")
"""Quantities of the printed table; all values are in the files."""


def main() -> None:
    """Entry point of ``ros2 run mrd_characterisation characterise``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, characterise, write the files and the page, print the result."""
    arguments = _parse_arguments()
    view = View(arguments.units, arguments.orientation)
    compared = [_named_runs(entry) for entry in arguments.compare]
    groups = read_groups([arguments.runs, *(paths for _, paths in compared)], arguments.skip)
    speed = view.unit("m/s")
    speeds = [value / speed.factor for value in _numbers(arguments.speeds)] or None
    folder = make_folder(arguments.output)
    for runs in groups:
        print(describe_runs(runs), file=sys.stderr, flush=True)
    test = read_test(arguments, groups[0])
    with errors_in(view):
        characterisations = [
            characterise(runs, name=name, speeds=speeds, round_to=1.0 / speed.factor)
            for name, runs in zip([test.serial, *(name for name, _ in compared)], groups, strict=True)
        ]
    paths = write_characterisation(characterisations[0], folder, view)
    for one in characterisations:
        _print(one, view)
    for path in [*paths, write_page(characterisations, folder, view)]:
        print(path)
    for path in write_asked_sheet(arguments, characterisations, test, folder, view):
        print(path)


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Characterise a damper from its recordings: forces over speed, energy, response times, gas force, seal "
        "drag. "
        "Writes characterisation.html, .json, .csv and .xlsx."
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help=f"{RUN_HELP}; all of one damper")
    parser.add_argument(
        "--compare",
        action="append",
        default=[],
        metavar="NAME=RUN[,RUN...]",
        help="lay another damper, or another state of this one, over it; may be repeated",
    )
    add_serial(parser)
    parser.add_argument(
        "--speeds",
        default="",
        metavar="SPEED,...",
        help="speeds of the table of forces, in mm/s, or in in/s with --units us (default: round speeds within those "
        "recorded)",
    )
    parser.add_argument(
        "--units", choices=UNITS, default="si", help="units shown; the JSON file is in SI (default %(default)s)"
    )
    parser.add_argument(
        "--orientation",
        choices=ORIENTATIONS,
        default="bench",
        help="; ".join(
            f"{name}: {orientation.sentence[0].lower()}{orientation.sentence[1:-1]}"
            for name, orientation in ORIENTATIONS.items()
        )
        + " (default %(default)s; the JSON file has that of the bench)",
    )
    parser.add_argument(
        "--skip", type=float, default=0.0, metavar="SECONDS", help="leave out the start of every run (default: nothing)"
    )
    add_test_arguments(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for the page and the files")
    return parser.parse_args()


def _named_runs(entry: str) -> tuple[str, list[str]]:
    name, equals, paths = entry.partition("=")
    listed = [path for path in paths.split(",") if path]
    if not equals or not listed:
        raise InputError(f"--compare is {entry!r}, expected NAME=RUN[,RUN...]")
    return checked_serial(name, "--compare: the name"), listed


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",") if part.strip()]
    except ValueError:
        raise InputError(f"--speeds is {text!r}, expected numbers with commas between them, such as 50,100,200") from None


def _print(characterisation: Characterisation, view: View) -> None:
    print(view.restated(characterisation.sentence))
    _print_rows(force_table([characterisation], view))
    rows = [value_row(value, view) for name in PRINTED for value in characterisation.select(name)]
    _print_rows([list(HEAD), *map(list, rows)] if rows else [])
    for text in characterisation.limitations:
        print(f"note: {view.restated(text)}")


def _print_rows(rows: Sequence[Sequence[str]]) -> None:
    if rows:
        table = Table(*rows[0])
        for row in rows[1:]:
            table.add_row(*row)
        print_table(table, beneath={"conditions"})
