"""The sheet of a damper: one page for the file, with who tested what, plots, numbers and verdict."""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from mrd_base import InputError
from mrd_base.version import VERSION
from mrd_characterisation.acceptance import Acceptance, check_row
from mrd_characterisation.characterisation import QUANTITIES, SAME_CURRENT, Characterisation, Value
from mrd_characterisation.damper_test import DamperTest
from mrd_characterisation.sheet_figures import force_over_position, force_over_speed, force_over_velocity
from mrd_characterisation.units import BENCH, View
from mrd_characterisation.wording import conditions_text, number_text, range_text

if TYPE_CHECKING:
    import plotly.graph_objects as go

MOST_OVERLAID = 10
"""Dampers, or states of one, whose lines can still be told apart on a sheet."""

MOST_ROWS = 30
"""Rows of the table for which a page has room at most beside the plots."""

LARGEST_LOGO = 2**21
"""Bytes."""

_LOGOS = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".svg": "image/svg+xml"}

# What a sheet without limits shows, most telling first, and the most rows of each; the plots show the rest.
_SHOWN = {
    "gas_force": 1,
    "seal_drag": 1,
    "force_at_speed": 8,
    "dynamic_range": 1,
    "energy_per_cycle": 2,
    "response_time_63": 4,
}


@dataclass(frozen=True, eq=False)
class Sheet:
    """What stands on a sheet, in the units and words of the reader.

    Attributes
    ----------
    serial : str
    fields : tuple of (str, str)
        Names and texts at the head of the sheet.
    verdict : str
        "pass", "fail" or "not_decided"; empty where nothing was judged.
    sentence : str
    plots : tuple of plotly Figure
        Force over speed, over position, over velocity.
    head : tuple of str
    rows : tuple of tuple of str
        The table.
    left_out : int
        Numbers that the table leaves out.
    logo : str
        Data URI of a picture; empty for none.
    """

    serial: str
    fields: tuple[tuple[str, str], ...]
    verdict: str
    sentence: str
    plots: "tuple[go.Figure, ...]"
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left_out: int = 0
    logo: str = ""
    footer: str = field(default_factory=lambda: f"Written by mrd {VERSION} on {datetime.now():%Y-%m-%d %H:%M}")

    @property
    def more(self) -> str:
        """What the table leaves out, in words; empty where it is complete."""
        return f"{self.left_out} more numbers stand in the file beside this sheet." if self.left_out else ""

    def shortened(self, rows: int) -> "Sheet":
        """Return the sheet with the first rows of the table only."""
        return replace(self, rows=self.rows[:rows], left_out=self.left_out + max(0, len(self.rows) - rows))


def make_sheet(
    characterisations: Sequence[Characterisation],
    test: DamperTest,
    acceptance: Acceptance | None = None,
    *,
    view: View = BENCH,
    fields: Mapping[str, str] | None = None,
    logo: str | Path | None = None,
) -> Sheet:
    """Make the sheet of a damper.

    Parameters
    ----------
    characterisations : sequence of Characterisation
        The first is that of the damper, the others are drawn for comparison.
    test : DamperTest
    acceptance : Acceptance, optional
        Its checks are the table, those that did not pass first; else the numbers are.
    view : View
        Units, and signs of the plots.
    fields : mapping, optional
        More names and texts for the head of the sheet.
    logo : path, optional
        PNG, JPEG or SVG file.

    Raises
    ------
    InputError
        For more than `MOST_OVERLAID` characterisations, and for a logo that cannot be read.
    """
    if not 1 <= len(characterisations) <= MOST_OVERLAID:
        raise InputError(f"--sheet: {len(characterisations)} dampers or states, expected 1 to {MOST_OVERLAID} on a sheet")
    damper = characterisations[0]
    temperature = "not recorded"
    if test.temperature:
        low, high = (number_text(end, "K", view) for end in test.temperature)
        temperature = low if low == high else range_text(*test.temperature, "K", view)
    if acceptance:
        head: tuple[str, ...] = ("verdict", "number", "at", "value", "95 % interval", "limits", "why")
        rows = [check_row(check, view) for check in acceptance.by_outcome]
        if acceptance.verdict == "pass":  # there is no why, and the other columns need its room
            head, rows = head[:-1], [row[:-1] for row in rows]
        sentence = " ".join(filter(None, (acceptance.sentence, acceptance.worst_sentence(view))))
    else:
        head = ("number", "at", "value", "95 % interval", "cycles")
        rows = [_value_row(value, view) for name, most in _SHOWN.items() for value in _telling(damper.select(name), most)]
        sentence = view.restated(damper.sentence)
    left_out = (len(rows) if acceptance else len(damper.values)) - min(len(rows), MOST_ROWS)
    return Sheet(
        test.serial,
        (
            ("Serial number", test.serial),
            ("Date", test.day),
            ("Rig", test.rig or "not stated"),
            ("Operator", test.operator or "not stated"),
            ("Temperature", temperature),
            *(fields or {}).items(),
        ),
        acceptance.verdict if acceptance else "",
        sentence,
        (
            force_over_speed(characterisations, view),
            force_over_position(characterisations, view),
            force_over_velocity(characterisations, view),
        ),
        head,
        tuple(rows[:MOST_ROWS]),
        max(left_out, 0),
        _data_uri(Path(logo)) if logo else "",
    )


def _telling(values: Sequence[Value], most: int) -> list[Value]:
    """Return the values at the smallest and the largest current, at the highest speeds, in their order."""
    currents = [max(abs(value.current or 0.0), abs(value.current_before or 0.0)) for value in values]
    ends = [
        value
        for value, current in zip(values, currents, strict=True)
        if current >= (1.0 - SAME_CURRENT) * max(currents) or (value.current_before is None and current == min(currents))
    ]
    fastest = sorted(ends, key=lambda value: -(value.speed or 0.0))[:most]
    return [value for value in values if value in fastest]


def _value_row(value: Value, view: View) -> tuple[str, ...]:
    unit = QUANTITIES[value.quantity].unit
    interval = "–" if math.isnan(value.lower) else range_text(value.lower, value.upper, unit, view)
    title = QUANTITIES[value.quantity].title
    return title, conditions_text(value, view), number_text(value.value, unit, view), interval, str(value.cycles)


def _data_uri(path: Path) -> str:
    """Return a picture as a text that a page can hold, so that it needs no other file."""
    if path.suffix.lower() not in _LOGOS:
        raise InputError(f"--logo {path}: ends with {path.suffix or 'nothing'}, expected one of {', '.join(_LOGOS)}")
    try:
        if path.stat().st_size > LARGEST_LOGO:
            raise InputError(f"--logo {path}: has {path.stat().st_size} bytes, expected at most {LARGEST_LOGO}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"--logo {path}: cannot be read ({error.strerror})") from None
    return f"data:{_LOGOS[path.suffix.lower()]};base64,{base64.b64encode(content).decode()}"
