"""Tables in Excel workbooks."""

import datetime
import io
import zipfile
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.extras import load_extra
from mrd_runs.importing.rates import stated_rate
from mrd_runs.importing.table import LONGEST_HEAD, Cell, Located, Table, begin_block, locate_table
from mrd_runs.importing.time_of_day import clock_seconds, has_date
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_MOST_COLUMNS = 256
_LARGEST_PART = 2**30  # bytes of a part of the workbook when unpacked


class _Sheet(NamedTuple):
    """A sheet with the beginning of the places of its rows, and the index of its first row of numbers."""

    label: str
    sheet: Any
    first: int


def read_sheet_table(path: Path) -> Table:
    """Find the sheets of a workbook that hold the longest table of numbers, or others with the same columns.

    Sheets with the same columns are read one after another, as blocks: they are runs, or parts of one.

    Raises
    ------
    InputError
        When openpyxl is not installed, or the file is no workbook, or holds no rows of numbers.
    """
    openpyxl = load_extra("openpyxl", "openpyxl", "xlsx", path)
    try:
        # In memory, because openpyxl never closes a file of a workbook that it refuses or that is read row by row.
        content = io.BytesIO(path.read_bytes())
        with zipfile.ZipFile(content) as parts:
            largest = max((part.file_size for part in parts.infolist()), default=0)
        if largest > _LARGEST_PART:
            raise InputError(f"{path}: unpacks to more than {_LARGEST_PART >> 20} MiB; export it as text")
        workbook = openpyxl.load_workbook(content, read_only=True, data_only=True)
        tables = {name: _locate(workbook[name]) for name in (sheet.title for sheet in workbook.worksheets)}
    except InputError:
        raise
    except Exception as error:  # openpyxl and the parsers below it raise many kinds
        raise InputError(f"{path}: cannot be read as an Excel workbook ({one_line(error)})") from None
    found = {name: table for name, table in tables.items() if table}
    if not found:
        raise InputError(f"{path}: none of its sheets holds rows of at least two numbers; expected a table of samples")
    table = max(found.values(), key=lambda each: each.rows)
    used = {name: each for name, each in found.items() if (each.names, each.units) == (table.names, table.units)}
    others = [one_line(name) for name in found if name not in used]
    sheets = [
        _Sheet(f"sheet {one_line(name)}, " if len(used) > 1 else "", workbook[name], each.first)
        for name, each in used.items()
    ]
    rows = [f"{one_line(name)}, numbers from row {each.first + 1}" for name, each in used.items()]
    remarks = [f"not read, because of other columns: {', '.join(others)}"] if others else []
    blocks: list[int] = []
    return Table(
        table.columns,
        lambda names: _read_columns(sheets, table, names, path, blocks),
        f"{'sheet' if len(rows) == 1 else 'sheets'} {'; '.join(rows)}",
        lambda index: next(islice(_numbered(sheets), index, None))[0],
        stated_rate(fact for _, sheet, first in sheets for fact in _facts(sheet, first)),
        ragged=True,
        remarks=remarks,
        blocks=blocks,
    )


def _rows(sheet: Any) -> Iterator[list[Cell]]:
    sheet.reset_dimensions()  # some writers state too small a size
    for row in sheet.iter_rows(max_col=_MOST_COLUMNS, values_only=True):
        yield [_cell(value) for value in row]


def _locate(sheet: Any) -> Located | None:
    sheet.reset_dimensions()
    raw = [list(row) for row in islice(sheet.iter_rows(max_col=_MOST_COLUMNS, values_only=True), LONGEST_HEAD)]
    rows = [[_cell(value) for value in row] for row in raw]
    width = max((len(row) for row in rows), default=0)
    rows = [row + [None] * (width - len(row)) for row in rows]
    found = locate_table(rows, lambda index, _: rows[index])
    if found is None:
        return None
    first = raw[found.first]
    columns = [
        replace(column, unit="s", of_day=not _has_date(value)) if _is_clock(value) else column
        for column, value in zip(found.columns, [*first, *[None] * len(found.columns)], strict=False)
    ]
    return replace(found, columns=tuple(columns))


def _is_clock(value: object) -> bool:
    """Return whether a cell holds a time of day, a date or a duration."""
    kinds = (datetime.datetime, datetime.time, datetime.timedelta)
    return isinstance(value, kinds) or (isinstance(value, str) and clock_seconds(value.strip()) is not None)


def _has_date(value: object) -> bool:
    return isinstance(value, datetime.datetime | datetime.timedelta) or (isinstance(value, str) and has_date(value.strip()))


def _facts(sheet: Any, first: int) -> Iterator[tuple[str, str | float]]:
    """Yield each text above the table with what stands right of it."""
    for row in islice(_rows(sheet), first):
        for left, right in pairwise(cell for cell in row if cell is not None):
            if isinstance(left, str):
                yield left, right


def _numbered(sheets: Sequence[_Sheet]) -> Iterator[tuple[str, list[Cell]]]:
    """Yield place and cells of each row of the tables that is not blank."""
    for label, sheet, first in sheets:
        for number, row in enumerate(_rows(sheet), 1):
            if number > first and any(cell is not None for cell in row):
                yield f"{label}row {number}", row


def _read_columns(
    sheets: Sequence[_Sheet], table: Located, names: Sequence[str], path: Path, blocks: list[int]
) -> dict[str, Array]:
    indices = [[column.name for column in table.columns].index(name) for name in names]
    series = {name: array("d") for name in names}
    for each in sheets:
        blocks.append(begin_block(series))
        ended: dict[str, str] = {}
        for place, row in _numbered([each]):
            for name, index in zip(names, indices, strict=True):
                cell = row[index] if index < len(row) else None
                if cell is None:
                    ended.setdefault(name, place)
                elif isinstance(cell, float) and name not in ended:
                    series[name].append(cell)
                else:
                    at, found = (ended[name], "nothing") if name in ended else (place, one_line(repr(cell)))
                    raise InputError(f"{path}: {at}: {one_line(name)} is {found}, expected a number")
    return {name: np.array(values) for name, values in series.items()}


def _cell(value: object) -> Cell:
    """Return a cell as a number, a text, or None; times as seconds."""
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, datetime.timedelta):
        return value.total_seconds()
    if isinstance(value, datetime.datetime):
        return value.replace(tzinfo=datetime.UTC).timestamp()
    if isinstance(value, datetime.time):
        return value.hour * 3600 + value.minute * 60 + value.second + 1e-6 * value.microsecond
    text = str(value).strip()
    seconds = clock_seconds(text)
    return (text or None) if seconds is None else seconds
