"""List the damper models with their parameters."""

import argparse

from rich.console import Console
from rich.table import Table

from mrd_base import run_tool
from mrd_base.console import print_table
from mrd_base.tool import command
from mrd_sim.cli.options import add_models_folder
from mrd_sim.current import LAWS
from mrd_sim.models import MODELS, DamperModel, find_model
from mrd_sim.models_page import bounds, clauses, integration, memory, page, section, slope


def main() -> None:
    """Entry point of ``ros2 run mrd_sim models``."""
    run_tool(work)


def work() -> None:
    """Print the catalogue, or one model with its parameters."""
    parser = argparse.ArgumentParser(description="List the damper models, or show one with its parameters.")
    parser.add_argument("model", nargs="?", help=f"one of {', '.join(MODELS)}")
    parser.add_argument(
        "--markdown", action="store_true", help="print the page of the documentation, or the model's section of it"
    )
    add_models_folder(parser)
    arguments = parser.parse_args()
    model = find_model(arguments.model) if arguments.model else None
    if arguments.markdown:
        print(section(model) if model else page(), end="")
        return
    console = Console()
    if model is None:
        print_table(catalogue())
        tool = command("mrd_sim", "models")
        console.print(f"One with its equation, source, parameters and current laws: {tool} MODEL")
        return
    console.print(f"{model.title} ({model.id})", highlight=False, style="bold")
    for clause in clauses(model.equation):
        console.print(f"    {clause}", highlight=False, markup=False)
    console.print(f"Source: {model.source}", highlight=False, markup=False)
    print_table(parameters(model), beneath={"meaning"})
    print_table(current_laws(model))


def catalogue() -> Table:
    """Return a table of all models."""
    table = Table("model", "title", "parameters", "memory", "integration")
    for model in MODELS.values():
        table.add_row(model.id, model.title, str(len(model.parameters)), memory(model), integration(model))
    return table


def parameters(model: DamperModel) -> Table:
    """Return a table of a model's parameters by the names that the tools take."""
    table = Table("parameter", "unit", "default", "bounds", "grow with", "meaning")
    for parameter in model.parameters:
        interval = f"{parameter.lower:g} … {parameter.upper:g}"
        table.add_row(
            parameter.name,
            parameter.unit,
            f"{parameter.default:g}",
            interval if parameter.free else f"{interval}, fixed unless set",
            parameter.rule or "–",
            parameter.meaning,
        )
    return table


def current_laws(model: DamperModel) -> Table:
    """Return a table of a model's coefficients over current."""
    known = ", ".join(LAWS)
    table = Table("coefficient", "at 0 A", "current law: slope at 0 A", caption=f"Laws to choose from: {known}")
    for coefficient in model.coefficients:
        if coefficient.per_ampere:
            unit = coefficient.unit or "1"
            table.add_row(f"{coefficient.name} in {unit}", bounds(coefficient), slope(coefficient))
    return table
