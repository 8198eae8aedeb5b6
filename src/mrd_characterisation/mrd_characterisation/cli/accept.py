"""The tool ``accept``: whether a damper passes, by limits or by a golden damper."""

import argparse
import sys

from rich.table import Table
from rich.text import Text

from mrd_base import run_tool
from mrd_base.console import print_table
from mrd_base.json_file import make_folder
from mrd_characterisation.acceptance import HEAD, accept, characterise_for, check_row
from mrd_characterisation.acceptance_file import cause_text, write_acceptance
from mrd_characterisation.cli.options import add_serial, add_test_arguments, errors_in, read_test, write_asked_sheet
from mrd_characterisation.reference import read_reference
from mrd_characterisation.units import UNITS, View
from mrd_runs import read_runs
from mrd_runs.read import RUN_HELP

NOT_PASSED = 1
"""Exit status where the damper fails or is not decided."""

_STYLES = {"fail": "bold red", "not_decided": "yellow", "not_measured": "yellow", "pass": "green"}


def main() -> None:
    """Entry point of ``ros2 run mrd_characterisation accept``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, judge the damper, write the files, print what did not pass."""
    arguments = _parser().parse_args()
    view = View(arguments.units)
    reference = read_reference(arguments.reference, 0.01 * arguments.tolerance, arguments.skip)
    runs = read_runs(arguments.runs, arguments.skip)
    test = read_test(arguments, runs)
    folder = make_folder(arguments.output)
    characterisation = characterise_for(runs, reference.limits, test.serial)
    with errors_in(view):
        acceptance = accept(
            characterisation, reference.limits, test, reference=reference.text, golden_sources=reference.golden_sources
        )
    overlaid = [characterisation, *([reference.golden] if reference.golden else [])]
    written = [write_acceptance(acceptance, folder), *write_asked_sheet(arguments, overlaid, test, folder, view, acceptance)]
    open_checks = [check for check in acceptance.by_outcome if check.outcome != "pass"]
    if open_checks:
        table = Table(*HEAD)
        for check in open_checks:
            outcome, *cells = check_row(check, view)
            table.add_row(Text(outcome, _STYLES[check.outcome]), *cells)
        print_table(table, beneath={"conditions", "why"})
    print(acceptance.sentence)
    for limitation in characterisation.limitations if acceptance.verdict == "not_decided" else ():
        print(f"note: {view.restated(limitation)}")
    print(*written, sep="\n")
    if acceptance.verdict == "not_decided" and any(check.outcome == "not_decided" for check in open_checks):
        print("To decide what is not decided: record more cycles, and judge these and the new recordings together.")
    if acceptance.verdict == "fail":
        print(cause_text(acceptance, folder))
    if acceptance.verdict != "pass":
        sys.exit(NOT_PASSED)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description="Judge a damper by limits or by a golden damper. A number passes where its whole 95 % interval lies "
        "within the limits. Writes acceptance.json. The exit status is "
        f"{NOT_PASSED} where a number fails, is not decided or was not measured."
    )
    parser.add_argument("runs", nargs="+", metavar="RUN", help=f"{RUN_HELP}; all of one damper")
    parser.add_argument(
        "--reference",
        nargs="+",
        required=True,
        metavar="LIMITS.yaml|CHARACTERISATION.json|RUN",
        help="limits, or a golden damper: its characterisation, or its runs",
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=10.0,
        metavar="PERCENT",
        help="of a golden damper's values (default %(default)g); at least their scatter",
    )
    add_serial(parser)
    parser.add_argument(
        "--units", choices=UNITS, default="si", help="of what is printed and of the sheet (default %(default)s)"
    )
    parser.add_argument(
        "--skip", type=float, default=0.0, metavar="SECONDS", help="leave out the start of every run (default: nothing)"
    )
    add_test_arguments(parser)
    parser.add_argument("--output", required=True, metavar="DIR", help="folder for acceptance.json and the sheet")
    return parser
