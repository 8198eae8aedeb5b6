"""A batch as files: batch.json, batch.csv with a row for each test, and batch.html."""

import csv
import io
import math
import os
from pathlib import Path
from typing import Any
from urllib.parse import quote

from mrd_base.figures import to_html
from mrd_base.json_file import finite_or_none, write_json
from mrd_base.page import render
from mrd_base.version import VERSION
from mrd_characterisation.batch import HEAD, Batch, Entry, Key, Statistic, statistic_row
from mrd_characterisation.batch_figure import run_chart
from mrd_characterisation.characterisation import QUANTITIES
from mrd_characterisation.wording import conditions_text

SCHEMA = "mrd-batch/1"

MOST_DRAWN = 4
"""Numbers of which the page has a plot, those with the least margin; more would take long and be looked at by nobody."""


def to_json(batch: Batch) -> dict[str, Any]:
    """Return the content of batch.json; numbers that are not finite become null."""
    return {
        "schema": SCHEMA,
        "sentence": batch.sentence,
        "folder": str(batch.folder),
        "tests": [
            {
                "serial": entry.serial,
                "date": entry.date.isoformat() if entry.date else None,
                "verdict": entry.verdict or None,
                "failed": entry.failed,
                "file": str(entry.file),
            }
            for entry in batch.entries
        ],
        "statistics": [_statistic(statistic) for statistic in batch.statistics],
        "notes": list(batch.notes),
        "version": VERSION,
    }


def _statistic(statistic: Statistic) -> dict[str, Any]:
    key, (cp, cpk), slope = statistic.key, statistic.capability, statistic.slope
    return {
        "quantity": key.quantity,
        "unit": statistic.unit,
        "current": key.current,
        "current_before": key.current_before,
        "direction": key.direction,
        "speed": key.speed,
        "stroke": key.stroke,
        "tests": len(statistic.values),
        "mean": statistic.mean,
        "std": finite_or_none(statistic.deviation),
        "least": float(statistic.values.min()),
        "largest": float(statistic.values.max()),
        "lower": finite_or_none(statistic.lower),
        "upper": finite_or_none(statistic.upper),
        "cp": finite_or_none(cp),
        "cpk": finite_or_none(cpk),
        "slope_per_day": None if slope is None else {"value": slope[0], "ci95": [slope[1], slope[2]]},
    }


def to_csv(batch: Batch) -> str:
    """Return a table with a row for each test and a column for each number in SI; a force as it resists the motion."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["serial", "date", "verdict", *(_column(statistic.key) for statistic in batch.statistics), "file"])
    columns = [dict(zip(map(id, s.entries), s.values.tolist(), strict=True)) for s in batch.statistics]
    for entry in batch.entries:
        numbers = [f"{column[id(entry)]:.9g}" if id(entry) in column else "" for column in columns]
        date = entry.date.isoformat() if entry.date else ""
        writer.writerow([_text(entry.serial), date, entry.verdict, *numbers, _text(str(entry.file))])
    return text.getvalue()


def _text(cell: str) -> str:
    """Return a text that a spreadsheet does not take for a formula, which a serial number from elsewhere may look like."""
    return f"'{cell}" if cell[:1] in ("=", "+", "-", "@") else cell


def _column(key: Key) -> str:
    unit = QUANTITIES[key.quantity].unit
    return ", ".join(filter(None, (f"{key.quantity}{f' [{unit}]' if unit else ''}", conditions_text(key))))


def write_batch(batch: Batch, folder: str | Path) -> list[Path]:
    """Write batch.json, batch.csv and batch.html into ``folder`` and return their paths."""
    folder = Path(folder)
    table = folder / "batch.csv"
    table.write_text(to_csv(batch), encoding="utf-8")
    drawn = sorted(batch.statistics, key=_margin)[:MOST_DRAWN]
    groups = [("failed", "fail"), ("not decided", "not_decided"), ("passed", "pass"), ("not judged", "")]
    page = render(
        "batch",
        folder / "batch.html",
        "mrd_characterisation",
        title=f"Batch {batch.folder.resolve().name}",
        sentence=batch.sentence,
        headline=[(word, batch.count(verdict)) for word, verdict in groups if batch.count(verdict)],
        head=HEAD,
        rows=[statistic_row(statistic) for statistic in batch.statistics],
        figures=[(statistic.title, to_html(run_chart(statistic))) for statistic in drawn],
        left_out=len(batch.statistics) - len(drawn),
        groups=[
            (word, [_test_row(entry, folder) for entry in batch.entries if entry.verdict == verdict])
            for word, verdict in groups
            if batch.count(verdict)
        ],
        notes=batch.notes,
    )
    return [write_json(to_json(batch), "mrd_characterisation", "batch", folder), table, page]


def _margin(statistic: Statistic) -> float:
    """Return what sorts numbers by how little they keep from their limits; without limits by how much they scatter."""
    cpk = statistic.capability[1]
    if math.isfinite(cpk):
        return cpk
    relative = statistic.deviation / abs(statistic.mean) if statistic.mean else math.nan
    return 1e6 - relative if math.isfinite(relative) else 1e9


def _test_row(entry: Entry, folder: Path) -> dict[str, Any]:
    sheet = entry.file.parent / "sheet.html"
    shown = sheet if sheet.exists() else entry.file
    return {
        "serial": entry.serial,
        "date": f"{entry.date:%Y-%m-%d %H:%M}" if entry.date else "–",
        "failed": entry.failed,
        "link": quote(os.path.relpath(shown, folder)),
        "file": shown.name,
    }
