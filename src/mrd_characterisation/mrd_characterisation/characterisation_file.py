"""A characterisation as files: characterisation.json in SI, and the same values as CSV and xlsx in the units shown."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_base.json_file import finite_or_none, read_json, write_json
from mrd_base.version import VERSION
from mrd_characterisation.characterisation import Characterisation, Curve, GasCurve, Response, Value
from mrd_characterisation.damper_test import recorded_date
from mrd_characterisation.listing import COLUMNS, spreadsheet_row
from mrd_characterisation.units import BENCH, View
from mrd_runs import Run, read_runs
from mrd_runs.summary import run_json

SCHEMA = "mrd-characterisation/1"


def to_json(characterisation: Characterisation) -> dict[str, Any]:
    """Return the content of characterisation.json, in SI and the signs of the bench; what is not finite becomes null."""
    return {
        "schema": SCHEMA,
        "name": characterisation.name,
        "sentence": characterisation.sentence,
        "date": _date(characterisation.runs),
        "runs": [run_json(run) for run in characterisation.runs],
        "values": [_plain({**asdict(value), "unit": value.unit}) for value in characterisation.values],
        "curves": [_plain(vars(curve)) for curve in characterisation.curves],
        "responses": [_plain(vars(response)) for response in characterisation.responses],
        "gas_curve": _plain(vars(characterisation.gas_curve)) if characterisation.gas_curve else None,
        "limitations": list(characterisation.limitations),
        "version": VERSION,
    }


def _date(runs: Sequence[Run]) -> str | None:
    try:
        date = recorded_date(runs)
    except InputError:
        return None  # a date as another program writes it does not keep the values from being told
    return date.isoformat() if date else None


def _plain(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: _plain_value(value) for name, value in fields.items()}


def _plain_value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [finite_or_none(float(f"{number:.7g}")) for number in value]
    if isinstance(value, tuple):
        return list(value)
    return finite_or_none(value) if isinstance(value, float) else value


def write_characterisation(characterisation: Characterisation, folder: str | Path, view: View = BENCH) -> list[Path]:
    """Write characterisation.json, .csv and, where openpyxl is installed, .xlsx into ``folder``; return their paths."""
    folder = Path(folder)
    rows = [spreadsheet_row(value, view) for value in characterisation.values]
    paths = [write_json(to_json(characterisation), "mrd_characterisation", "characterisation", folder)]
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerows([COLUMNS, *rows])
    path = folder / "characterisation.csv"
    path.write_text(table.getvalue(), encoding="utf-8")
    paths.append(path)
    workbook = _write_workbook(rows, folder / "characterisation.xlsx")
    return [*paths, workbook] if workbook else paths


def _write_workbook(rows: Sequence[Sequence[Any]], path: Path) -> Path | None:
    try:
        from openpyxl import Workbook
        from openpyxl.styles import Font
    except ImportError:
        return None
    workbook = Workbook()
    sheet = workbook.active
    sheet.title = "values"
    for row in (COLUMNS, *rows):
        sheet.append(list(row))
    for cell in sheet[1]:
        cell.font = Font(bold=True)
    sheet.freeze_panes = "A2"
    sheet.auto_filter.ref = sheet.dimensions
    workbook.save(path)
    return path


def read_characterisation(path: str | Path) -> Characterisation:
    """Read a characterisation.json; the runs and the loops, which it does not hold, are empty.

    Raises
    ------
    InputError
        When the file cannot be read, or is not a characterisation.json of this version.
    """
    content = read_json(path, "mrd_characterisation", "characterisation", SCHEMA)
    try:
        values = [Value(**_read(fields, without=("unit",))) for fields in content["values"]]
    except TypeError as error:
        raise InputError(f"{path}: values: {error}; expected a characterisation.json of {SCHEMA}") from None
    gas = content["gas_curve"]
    return Characterisation(
        content["name"],
        (),
        tuple(values),
        tuple(Curve(**_read(fields)) for fields in content["curves"]),
        (),
        tuple(Response(**_read(fields)) for fields in content["responses"]),
        GasCurve(**{**_read(gas, without=("runs",)), "runs": tuple(gas["runs"])}) if gas else None,
        tuple(content["limitations"]),
    )


def read_slow_runs(path: str | Path) -> list[Run]:
    """Read the recordings with slow strokes from which a characterisation.json has gas force and seal drag.

    A fit or a diagnosis of the same damper that has them too knows gas force and seal drag, which faster runs hardly show.

    Raises
    ------
    InputError
        When the characterisation has no gas force, or when a recording is not where it was.
    """
    content = read_json(path, "mrd_characterisation", "characterisation", SCHEMA)
    if content["gas_curve"] is None:
        raise InputError(
            f"{path}: has no gas force and no seal drag, which --characterisation is about; record slow strokes at the "
            "smallest current and characterise them"
        )
    sources = {run["name"]: run["source"] for run in content["runs"]}
    missing = [name for name in content["gas_curve"]["runs"] if not Path(sources.get(name) or "nowhere").exists()]
    if missing:
        raise InputError(
            f"{path}: the recording {missing[0]} is not at {sources.get(missing[0]) or 'any path'} any more; characterise "
            "the runs once more where they are now"
        )
    return read_runs([sources[name] for name in content["gas_curve"]["runs"]])


_MAY_BE_NAN = ("lower", "upper", "scatter")


def _read(fields: dict[str, Any], without: Sequence[str] = ()) -> dict[str, Any]:
    def number(name: str, value: Any) -> Any:
        if isinstance(value, list):
            return np.array([math.nan if entry is None else entry for entry in value])
        return math.nan if value is None and name in _MAY_BE_NAN else value

    return {name: number(name, value) for name, value in fields.items() if name not in without}
