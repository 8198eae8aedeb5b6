"""Tables in text files of any dialect: delimiter, decimal sign, encoding, and what stands above the numbers."""

import csv
import datetime
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.formats.csv_file import LONGEST_LINE, check_bounds
from mrd_runs.importing.table import LONGEST_HEAD, Cell, Located, Table, locate_table
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", "": "spaces"}
# A decimal comma needs digits on both sides: elsewhere a comma separates.
_NUMBERS = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE | re.ASCII),
    ",": re.compile(r"[+-]?\d+(,\d+)?([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE | re.ASCII),
}
# A time of day, maybe with a date; its seconds are a number.
_CLOCK = re.compile(
    r"(?:(\d{4})-(\d\d)-(\d\d)[T ]\s*|(\d\d)\.(\d\d)\.(\d{4})\s+)?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)Z?", re.ASCII
)
_FIRST_DAY = datetime.date(2000, 1, 1).toordinal()  # the nearer to now, the more digits are left for the seconds
_COMMENT = re.compile(r"^\s*(#|%|//)+\s?")


@dataclass(frozen=True)
class Dialect:
    """How a text file writes a table.

    Attributes
    ----------
    delimiter : str
        Between cells; "" for any white space.
    decimal : str
        Sign before the decimals, ``.`` or ``,``.
    located : Located
        Columns, and the index of the first line of numbers.
    clocks : tuple of int
        Indices of the columns that hold times of day.
    """

    delimiter: str
    decimal: str
    located: Located
    clocks: tuple[int, ...] = ()

    def cells(self, line: str) -> list[Cell]:
        """Return the cells of a line; those that are numbers as such."""
        return [_cell(cell, self.decimal) for cell in split_line(line, self.delimiter)]


def guess_dialect(lines: Sequence[str]) -> Dialect | None:
    """Return the dialect in which the most lines are rows of numbers; None where none are.

    Parameters
    ----------
    lines : sequence of str
        The first lines of a file.
    """
    best, most = None, (0, 0)
    for delimiter, decimal in itertools.product(_DELIMITERS, _NUMBERS):
        rows = [[_cell(cell, decimal) for cell in split_line(line, delimiter)] for line in lines]
        located = locate_table(rows, partial(_header_at, lines, delimiter))
        if located is None:
            continue
        # A wrong dialect cuts numbers into pieces, some of which are no numbers.
        first = rows[located.first]
        whole = sum(isinstance(cell, float) for cell in first) - sum(isinstance(cell, str) for cell in first)
        if (located.rows, whole) > most:
            cells = split_line(lines[located.first], delimiter)
            clocks = tuple(index for index, cell in enumerate(cells) if _clock_seconds(cell) is not None)
            best, most = Dialect(delimiter, decimal, located, clocks), (located.rows, whole)
    return best


def _header_at(lines: Sequence[str], delimiter: str, index: int, width: int) -> Sequence[Cell]:
    return split_header(lines[index], delimiter, width)


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line, without the blanks around them."""
    if not delimiter:
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    return [cell.strip() for cell in line.split(delimiter)]


def split_header(line: str, delimiter: str, width: int) -> Sequence[Cell]:
    """Return the cells of a line of names: they may hold single blanks, or be separated as the numbers are not."""
    line = _COMMENT.sub("", line)
    ways = [split_line(line, delimiter)] if delimiter else []
    ways += [re.split(r"\t|\s{2,}", line.strip()), re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", line)]
    ways += [split_line(line, other) for other in _DELIMITERS if other != delimiter]
    # A row of numbers may end with a delimiter where the names do not, or lack a last column of remarks.
    fitting = [cells for near in (0, -1, 1) for cells in ways if len(cells) == width + near]
    return [*fitting[0], ""] if fitting and len(fitting[0]) < width else fitting[0] if fitting else []


def read_text_table(path: Path) -> Table:
    """Read the head of a text file; its columns are read when they are asked for.

    Raises
    ------
    InputError
        When it is larger than any recording, is no text, or holds no rows of numbers.
    """
    check_bounds(path)
    encoding = _encoding(path)
    with path.open(encoding=encoding, newline=None, errors="replace") as stream:
        lines = [line.rstrip("\n") for line in islice(stream, LONGEST_HEAD)]
    dialect = guess_dialect(lines)
    if dialect is None:
        raise InputError(f"{path}: holds no rows of at least two numbers; expected a table of samples")
    found = dialect.located
    layout = (
        f"{_DELIMITERS[dialect.delimiter]} between the columns, decimal {'comma' if dialect.decimal == ',' else 'point'}"
    )
    above = sum(bool(line.strip()) for line in lines[: found.first])
    return Table(
        found.columns,
        lambda names: _read_columns(path, encoding, dialect, names),
        f"{layout}, numbers from line {found.first + 1} ({above} lines above)" if above != 1 else layout,
        lambda index: f"line {next(islice(_rows(path, encoding, dialect), index, None))[0]}",
    )


def _encoding(path: Path) -> str:
    """Return the encoding of a text: that of its byte order mark, UTF-8, or that of Windows in Western Europe."""
    with path.open("rb") as stream:
        content = stream.read(LONGEST_LINE)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in content:
        raise InputError(f"{path}: is not text; expected a table of samples")
    try:
        content[:-4].decode("utf-8")  # the last character may be cut
        return "utf-8-sig"
    except UnicodeDecodeError:
        return "cp1252"


def _rows(path: Path, encoding: str, dialect: Dialect) -> Iterator[tuple[int, str]]:
    """Yield number and text of each line of numbers."""
    with path.open(encoding=encoding, newline=None, errors="replace") as stream:
        for number, line in enumerate(stream, 1):
            if number > dialect.located.first and line.strip():
                yield number, line


def _read_columns(path: Path, encoding: str, dialect: Dialect, names: Sequence[str]) -> dict[str, Array]:
    indices = [[column.name for column in dialect.located.columns].index(name) for name in names]
    rows = (line for _, line in _rows(path, encoding, dialect))
    delimiter: str | None = dialect.delimiter or None
    if dialect.decimal == "," and delimiter == ",":
        rows, delimiter = ("\t".join(split_line(line, ",")).replace(",", ".") for line in rows), "\t"
    elif dialect.decimal == ",":
        rows = (line.replace(",", ".") for line in rows)
    try:
        values = np.loadtxt(
            rows,
            np.float64,
            comments=None,
            delimiter=delimiter,
            converters=dict.fromkeys(dialect.clocks, _number),
            encoding=None,
            usecols=indices,
            ndmin=2,
            quotechar='"',
        )
    except ValueError as error:
        raise _first_bad_cell(path, encoding, dialect, indices) or InputError(
            f"{path}: cannot be read ({one_line(error)})"
        ) from None
    return {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}


def _first_bad_cell(path: Path, encoding: str, dialect: Dialect, indices: Sequence[int]) -> InputError | None:
    for number, line in _rows(path, encoding, dialect):
        cells = dialect.cells(line)
        for index in indices:
            if index >= len(cells) or not isinstance(cells[index], float):
                name = dialect.located.columns[index].name
                found = repr(cells[index]) if index < len(cells) and cells[index] is not None else "nothing"
                return InputError(f"{path}: line {number}: {one_line(name)} is {one_line(found)}, expected a number")
    return None


def _cell(text: str, decimal: str) -> Cell:
    if not text:
        return None
    if _NUMBERS[decimal].fullmatch(text):
        return float(text.replace(",", "."))
    seconds = _clock_seconds(text)
    return text if seconds is None else seconds


def _clock_seconds(text: str) -> float | None:
    """Return the seconds of a time of day, counted from the year 2000 where it has a date; None for another text."""
    match = _CLOCK.fullmatch(text)
    if match is None:
        return None
    year, month, day, other_day, other_month, other_year, hour, minute, second = match.groups()
    day_seconds = 3600 * int(hour) + 60 * int(minute) + float(second.replace(",", "."))
    if not (year or other_year):
        return day_seconds
    try:
        date = datetime.date(int(year or other_year), int(month or other_month), int(day or other_day))
    except ValueError:
        return None
    return 86400.0 * (date.toordinal() - _FIRST_DAY) + day_seconds


def _number(text: str) -> float:
    """Return the number of a cell of a line in which points stand for decimal commas."""
    seconds = _clock_seconds(text.strip().strip('"'))
    return float(text) if seconds is None else seconds
