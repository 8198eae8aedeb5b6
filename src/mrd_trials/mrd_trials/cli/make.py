"""Make the plants of a blind trial."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mrd_base import InputError, run_tool
from mrd_trials.cli.options import add_answers, add_workers, checked_workers, default_answers, progress_bar
from mrd_trials.make import make_trial
from mrd_trials.trial_design import FAMILIES, SHARES, SIZES, STARTS, Recipe
from mrd_trials.trial_folder import read_trial

N = TypeVar("N", int, float)

STANDARD = {"rich@500": 200, "rich@25": 12, "sine@500": 24, "paper@25": 12, "replay": 24, "semireal": 40}
"""Number of plants by tier in the standard trial."""


def main() -> None:
    """Entry point of ``ros2 run mrd_trials make``."""
    run_tool(work)


def work() -> None:
    """Parse the arguments, make the trial, report."""
    parser = argparse.ArgumentParser(
        prog="make", description="Make dampers with withheld effects: recordings for the diagnosis, and sealed answers."
    )
    parser.add_argument("trial", type=Path, metavar="TRIAL", help="folder of the trial; an interrupted one is continued")
    parser.add_argument("--seed", type=int, required=True, help="the same seed gives the same plants")
    parser.add_argument(
        "--plants",
        default="",
        metavar="TIER=N,...",
        help=f"number of plants by tier (default: {','.join(f'{tier}={count}' for tier, count in STANDARD.items())})",
    )
    parser.add_argument(
        "--shares",
        default="",
        metavar="KIND=SHARE,...",
        help=f"share of each kind of plant (default: {','.join(f'{kind}={share:g}' for kind, share in SHARES.items())})",
    )
    parser.add_argument(
        "--recorded", default="", metavar="FOLDER", help="recordings of measured dampers, one folder for each damper"
    )
    parser.add_argument(
        "--family",
        choices=FAMILIES,
        default=FAMILIES[0],
        help="formulas and damper forms: those of development, or those that nothing may be tuned on (default %(default)s)",
    )
    parser.add_argument(
        "--sizes",
        choices=SIZES,
        default=SIZES[0],
        help="dampers from 5 N to 400 kN and from 1 mm to 0.5 m, or all of the size of the reference damper "
        "(default %(default)s)",
    )
    parser.add_argument(
        "--starts",
        choices=STARTS,
        default=STARTS[0],
        help="half of the dampers with recordings that begin in mid-motion, or none (default %(default)s)",
    )
    add_answers(parser)
    add_workers(parser)
    arguments = parser.parse_args()
    if arguments.seed < 0:
        raise InputError(f"--seed is {arguments.seed}, expected a whole number from 0")
    plants = _pairs(arguments.plants, "--plants", _count) or STANDARD
    shares = _pairs(arguments.shares, "--shares", float) or SHARES
    recipe = Recipe(
        arguments.seed, dict(plants), dict(shares), arguments.recorded, arguments.family, arguments.sizes, arguments.starts
    )
    answers = arguments.answers or default_answers(arguments.trial)
    with progress_bar("making") as show:
        left_out = make_trial(recipe, arguments.trial, answers, checked_workers(arguments), show)
    for text in left_out:
        print(f"left out: {text}")
    print(f"{len(read_trial(arguments.trial).plants)} plants in {arguments.trial}; sealed answers in {answers}")


def _count(text: str) -> int:
    if not text.isdecimal():
        raise ValueError
    return int(text)


def _pairs(text: str, option: str, number: Callable[[str], N]) -> dict[str, N]:
    pairs = {}
    for part in filter(None, text.split(",")):
        name, _, value = part.partition("=")
        try:
            pairs[name] = number(value)
        except ValueError:
            expected = "a whole number from 0" if number is _count else "a number"
            raise InputError(f"{option}: found {part!r}, expected NAME= and {expected}") from None
    return pairs
