"""List the damper models with their parameters."""

import argparse

from rich.console import Console
from rich.table import Table

from mrd_base import run_tool
from mrd_sim.models import MODELS, DamperModel, find_model


def main() -> None:
    """Entry point of ``ros2 run mrd_sim models``."""
    run_tool(work)


def work() -> None:
    """Print the catalogue, or one model whole."""
    parser = argparse.ArgumentParser(prog="models", description="List the damper models, or one with its parameters.")
    parser.add_argument("model", nargs="?", help="id of a model")
    name = parser.parse_args().model
    console = Console()
    if name is None:
        table = Table("id", "model", "equation", "parameters", "source")
        for model in MODELS.values():
            table.add_row(model.id, model.title, model.equation, str(len(model.parameters)), model.source)
        console.print(table)
    else:
        console.print(parameter_table(find_model(name)))


def parameter_table(model: DamperModel) -> Table:
    """Table of a model's parameters."""
    table = Table(
        "parameter", "unit", "default", "bounds", "meaning", title=f"{model.title}: {model.equation}", caption=model.source
    )
    for parameter in model.parameters:
        bounds = f"{parameter.lower:g} … {parameter.upper:g}"
        table.add_row(
            parameter.name,
            parameter.unit,
            f"{parameter.default:g}",
            bounds if parameter.free else f"{bounds}, fixed unless set",
            parameter.meaning,
        )
    return table
