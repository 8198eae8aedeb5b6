"""Arguments that the tools for testing dampers share: which damper was tested, and its sheet."""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mrd_base import InputError
from mrd_characterisation.acceptance import Acceptance
from mrd_characterisation.characterisation import Characterisation
from mrd_characterisation.damper_test import DamperTest, damper_test
from mrd_characterisation.sheet import make_sheet
from mrd_characterisation.sheet_file import PAPERS, write_sheet
from mrd_characterisation.units import View
from mrd_runs import Run


@contextmanager
def errors_in(view: View) -> Iterator[None]:
    """State the numbers of an error in the units that were asked for, in which the arguments were given as well."""
    try:
        yield
    except InputError as error:
        raise InputError(view.restated(str(error))) from None


def add_serial(parser: argparse.ArgumentParser) -> None:
    """Add the serial number of the damper."""
    parser.add_argument(
        "--serial",
        metavar="NAME",
        help="serial number of the damper; default: the recorded one, else the name of the folder of the runs",
    )


def add_test_arguments(parser: argparse.ArgumentParser) -> None:
    """Add when, where and by whom the damper was tested, and the options of the sheet."""
    parser.add_argument("--date", metavar="DATE", help="of the test, such as 2024-05-31; default: the recorded one")
    parser.add_argument("--rig", metavar="NAME", help="name of the bench; default: the recorded one")
    parser.add_argument("--operator", metavar="NAME", help="who tested; default: the recorded one")
    sheet = parser.add_argument_group("sheet")
    sheet.add_argument("--sheet", action="store_true", help="write sheet.html and sheet.pdf, one page for the file")
    sheet.add_argument("--paper", choices=PAPERS, default="a4", help="of the sheet (default %(default)s)")
    sheet.add_argument("--template", metavar="FILE.html", help="Jinja2 template of the sheet; it may extend sheet.html.j2")
    sheet.add_argument("--logo", metavar="FILE", help="picture at the head of the sheet: PNG, JPEG or SVG")
    sheet.add_argument(
        "--field", action="append", default=[], metavar="NAME=TEXT", help="text at the head of the sheet; may be repeated"
    )


def read_test(arguments: argparse.Namespace, runs: Sequence[Run]) -> DamperTest:
    """Return which test the runs are of, by the arguments that were added above."""
    return damper_test(runs, serial=arguments.serial, date=arguments.date, rig=arguments.rig, operator=arguments.operator)


def write_asked_sheet(
    arguments: argparse.Namespace,
    characterisations: Sequence[Characterisation],
    test: DamperTest,
    folder: Path,
    view: View,
    acceptance: Acceptance | None = None,
) -> list[Path]:
    """Write the sheet where --sheet asks for it, and return the paths of its files."""
    if not arguments.sheet:
        return []
    fields = {}
    for text in arguments.field:
        name, equals, value = text.partition("=")
        if not (equals and name.strip()):
            raise InputError(f"--field: {text} is not a name with its text, expected NAME=TEXT")
        fields[name.strip()] = value.strip()
    sheet = make_sheet(characterisations, test, acceptance, view=view, fields=fields, logo=arguments.logo)
    return write_sheet(sheet, folder, paper=arguments.paper, template=arguments.template)
