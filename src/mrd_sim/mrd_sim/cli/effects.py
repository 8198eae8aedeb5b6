"""List the effects with their parameters."""

import argparse

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mrd_base import run_tool
from mrd_base.console import print_table
from mrd_base.tool import command
from mrd_sim.cli.options import add_effects_folder
from mrd_sim.effects import EFFECTS, Effect, find_effects
from mrd_sim.effects_page import catalogue, interval, page, section, where
from mrd_sim.models_page import clauses


def main() -> None:
    """Entry point of ``ros2 run mrd_sim effects``."""
    run_tool(work)


def work() -> None:
    """Print the catalogue, or one effect with its parameters."""
    parser = argparse.ArgumentParser(
        description="List the effects that may act with a damper model, or show one with its parameters."
    )
    parser.add_argument("effect", nargs="?", help=f"one of {', '.join(EFFECTS)}")
    add_effects_folder(parser)
    parser.add_argument(
        "--markdown", action="store_true", help="print the page of the documentation, or the effect's section of it"
    )
    arguments = parser.parse_args()
    chosen = find_effects([arguments.effect])[0] if arguments.effect else None
    if arguments.markdown:
        print(section(chosen) if chosen else page(), end="")
        return
    console = Console()
    if chosen is None:
        print_table(table(), beneath={"parameters"})
        console.print(f"One with its equation, parameters and what it looks like: {command('mrd_sim', 'effects')} EFFECT")
        return
    console.print(f"{chosen.title} ({chosen.id}), {chosen.stage}", highlight=False, style="bold")
    for clause in clauses(chosen.equation):
        console.print(f"    {clause}", highlight=False, markup=False)
    print_table(parameters(chosen), beneath={"meaning"})
    for name, text in (
        ("Shows as", chosen.signature),
        ("Where", where(chosen)),
        ("Looks like", ", ".join(chosen.confused_with)),
        ("Told apart by", chosen.separated_by),
        ("Source", chosen.source),
    ):
        console.print(f"{name}: {text}", highlight=False, markup=False)


def table() -> Table:
    """Return a table of all effects."""
    table = Table("effect", "title", "stage", "parameters")
    for effect in catalogue():
        table.add_row(effect.id, effect.title, effect.stage, ", ".join(p.name for p in effect.parameters))
    return table


def parameters(effect: Effect) -> Table:
    """Return a table of an effect's parameters."""
    table = Table("parameter", "unit", "neutral", "bounds", "grow with", "clearly visible", "meaning")
    for p in effect.parameters:
        typical = effect.typical.get(p.name, p.default)
        numbers = (p.unit, f"{p.default:g}", interval(p), p.rule or "–", f"{typical:g}")
        table.add_row(f"{effect.id}.{p.name}", *numbers, escape(p.meaning))
    return table
