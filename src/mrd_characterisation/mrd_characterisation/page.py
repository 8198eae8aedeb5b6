"""The page characterisation.html: one damper, or several laid over each other."""

from collections.abc import Sequence
from pathlib import Path

from mrd_base import page
from mrd_base.figures import to_html
from mrd_base.quantities import four_figures
from mrd_characterisation import figures
from mrd_characterisation.characterisation import QUANTITIES, Characterisation, Value
from mrd_characterisation.listing import HEAD, conditions, shown, value_row
from mrd_characterisation.units import BENCH, View

HEADLINES = ("gas_force", "gas_stiffness", "seal_drag", "stroke_used", "temperature_least", "temperature_largest")
"""Quantities with few values, which stand at the top of the page."""


def write_page(characterisations: Sequence[Characterisation], folder: str | Path, view: View = BENCH) -> Path:
    """Write characterisation.html, a page that needs no network, into ``folder`` and return its path.

    Parameters
    ----------
    characterisations : sequence of Characterisation
        The first one is described in full; the others are laid over it.
    folder : path
    view : View
    """
    first = characterisations[0]
    drawings = []
    if any(one.select("peak_force") for one in characterisations):
        drawings.append(("Peak and mean force over peak speed (PVP)", figures.peak_over_speed(characterisations, view)))
    if any(one.curves for one in characterisations):
        title = "Force over speed (CVP): both branches (thin) and their mean"
        drawings.append((title, figures.force_over_speed(characterisations, view)))
    if first.loops:
        drawings.append((f"Measured cycles of {first.name}", figures.loops(first, view)))
    if any(one.select("energy_per_cycle") for one in characterisations):
        drawings.append(("Energy", figures.energy_over_speed(characterisations, view)))
    if any(one.responses for one in characterisations):
        drawings.append(("Response to current steps at constant speed", figures.responses(characterisations)))
    if any(one.gas_curve for one in characterisations):
        drawings.append(("Gas force over the stroke", figures.gas_over_position(characterisations, view)))
    sources = [str(run.info["source"]) for one in characterisations for run in one.runs if run.info.get("source")]
    return page.render(
        "characterisation",
        Path(folder) / "characterisation.html",
        "mrd_characterisation",
        files=sources,
        title=f"Characterisation of {' and '.join(one.name for one in characterisations)}",
        sentence=view.restated(first.sentence),
        signs=view.sentence,
        headline=[
            (value_row(value, view)[2], QUANTITIES[value.quantity].title)
            for name in HEADLINES
            for value in first.select(name)
        ],
        limitations=[(one.name, view.restated(text)) for one in characterisations for text in one.limitations],
        drawings=[(title, to_html(figure)) for title, figure in drawings],
        forces=force_table(characterisations, view),
        tables=[
            (
                QUANTITIES[name].title,
                list(dict.fromkeys(view.restated(value.definition) for value in values)),
                [value_row(value, view)[1:] for value in values],
            )
            for name in QUANTITIES
            if (values := first.select(name))
        ],
        head=HEAD[1:],
        others=[other_table(first, other, view) for other in characterisations[1:]],
    )


def force_table(characterisations: Sequence[Characterisation], view: View) -> list[list[str]]:
    """Return the table of force at chosen speeds: a row for each speed, a column for each current and direction."""
    columns: dict[tuple[str, float, str], dict[float, str]] = {}
    for one in characterisations:
        for value in one.select("force_at_speed"):
            key = (one.name, value.current or 0.0, str(value.direction))
            columns.setdefault(key, {})[value.speed or 0.0] = four_figures(shown(value, view)[0])
    if not columns:
        return []
    speed, force = view.unit("m/s"), view.unit("N")
    names = [
        f"{f'{name}, ' if len(characterisations) > 1 else ''}{current:.3g} A, {direction}, {force.symbol}"
        for name, current, direction in columns
    ]
    speeds = sorted({at for column in columns.values() for at in column})
    rows = [[f"{speed.shown(at):.4g}", *(column.get(at, "") for column in columns.values())] for at in speeds]
    return [[f"speed, {speed.symbol}", *names], *rows]


def other_table(first: Characterisation, other: Characterisation, view: View) -> tuple[str, list[list[str]]]:
    """Return what differs between two characterisations where both have a value under the same conditions."""
    rows = []
    for value in first.values:
        pair = _same(value, other)
        if pair is not None:
            one, two = shown(value, view)[0], shown(pair, view)[0]
            change = f"{100 * (two / one - 1):+.1f} %" if one else ""
            unit = view.unit(value.unit).symbol
            title = QUANTITIES[value.quantity].title
            rows.append(
                [title, conditions(value, view), f"{four_figures(one)} {unit}", f"{four_figures(two)} {unit}", change]
            )
    return f"{other.name} against {first.name}", [["quantity", "conditions", first.name, other.name, "change"], *rows]


def _same(value: Value, other: Characterisation) -> Value | None:
    """Return the value of another characterisation under the same conditions; None where there is none."""
    found = other.alike(value)
    return found[0] if found else None
