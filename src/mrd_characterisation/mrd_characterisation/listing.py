"""Values as rows of tables: for texts, pages and spreadsheets."""

import math
from collections.abc import Sequence

from mrd_base.quantities import four_figures, range_figures
from mrd_characterisation.characterisation import QUANTITIES, Value
from mrd_characterisation.units import BENCH, ORIENTATIONS, View

HEAD = ("quantity", "conditions", "value", "95 % interval", "scatter", "cycles", "runs")

COLUMNS = (
    "quantity",
    "direction",
    "current_A",
    "current_before_A",
    "speed",
    "speed_unit",
    "stroke",
    "position",
    "length_unit",
    "value",
    "lower",
    "upper",
    "scatter",
    "unit",
    "cycles",
    "runs",
    "definition",
)
"""Columns of a spreadsheet; an empty cell is a condition that does not apply, or a number that does not exist."""


def shown(value: Value, view: View) -> tuple[float, float, float, float]:
    """Return value, ends of its interval and scatter in the units and signs of a view."""
    unit, quantity = view.unit(value.unit), QUANTITIES[value.quantity]
    sign = ORIENTATIONS[view.orientation].force if quantity.force else 1.0
    ends = sorted((sign * unit.shown(value.lower), sign * unit.shown(value.upper)))
    return sign * unit.shown(value.value), ends[0], ends[1], unit.difference(value.scatter)


def conditions(value: Value, view: View = BENCH) -> str:
    """Return under which conditions a value holds, such as ``rebound, 0.4 A, 100 mm/s``."""
    parts = [str(value.direction)] if value.direction else []
    if value.current_before is not None:
        parts.append(f"{value.current_before:.4g} to {value.current:.4g} A")
    elif value.current is not None:
        parts.append(f"{value.current:.4g} A")
    for name, number, si in (("", value.speed, "m/s"), ("stroke ", value.stroke, "m")):
        if number is not None:
            unit = view.unit(si)
            parts.append(f"{name}{unit.shown(number):.3g} {unit.symbol}")
    if value.position is not None:
        parts.append(f"x = {view.position * value.position + 0.0:.3g} {view.unit('m').symbol}")
    return ", ".join(parts)


def value_row(value: Value, view: View = BENCH) -> Sequence[str]:
    """Return the row of a value, below `HEAD`."""
    number, lower, upper, scatter = shown(value, view)
    unit = view.unit(value.unit).symbol
    interval = "none" if math.isnan(lower) else range_figures(lower, upper)
    return (
        QUANTITIES[value.quantity].title,
        conditions(value, view),
        f"{four_figures(number)} {unit}".rstrip(),
        interval,
        "none" if math.isnan(scatter) else f"{scatter:.2g}",
        str(value.cycles or "all"),
        str(value.runs),
    )


def spreadsheet_row(value: Value, view: View) -> list[str | float | int | None]:
    """Return the cells of a value, below `COLUMNS`."""
    length, speed = view.unit("m"), view.unit("m/s")
    numbers = [None if math.isnan(number) else number for number in shown(value, view)]
    return [
        value.quantity,
        value.direction,
        value.current,
        value.current_before,
        None if value.speed is None else speed.shown(value.speed),
        speed.symbol,
        None if value.stroke is None else length.shown(value.stroke),
        None if value.position is None else view.position * value.position,
        length.symbol,
        *numbers,
        view.unit(value.unit).symbol,
        value.cycles,
        value.runs,
        view.restated(value.definition),
    ]
