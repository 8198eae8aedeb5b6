"""Tables in text files of any dialect: delimiter, decimal sign, encoding, and what stands above the numbers."""

import csv
import itertools
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.formats.csv_file import LONGEST_LINE, check_bounds
from mrd_runs.importing.rates import facts_of_lines, stated_rate
from mrd_runs.importing.table import LONGEST_HEAD, Cell, Located, Table, begin_block, header_of, locate_table
from mrd_runs.importing.time_of_day import clock_seconds, has_date
from mrd_runs.importing.words import names_quantity
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", "|": "bars", "": "spaces"}
# A decimal comma needs digits on both sides: elsewhere a comma separates. Fortran writes exponents with D. Thousands are
# grouped by marks that cannot be decimal signs, or by the other one where a decimal sign follows: 1,234 may be 1.234.
_NUMBERS = {
    decimal: re.compile(
        rf"[+-]?({plain}|[1-9]\d{{0,2}}(['’\u00a0\u202f]\d{{3}})+({sign}\d+)?|[1-9]\d{{0,2}}([ {group}]\d{{3}})+{sign}\d+)"
        r"([ed][+-]?\d+)?|[+-]?(nan|inf)",
        re.IGNORECASE | re.ASCII,
    )
    for decimal, plain, sign, group in ((".", r"\d+\.?\d*|\.\d+", r"\.", ","), (",", r"\d+(,\d+)?", ",", r"\."))
}
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
            clocks = tuple(index for index, cell in enumerate(cells) if clock_seconds(cell) is not None)
            columns = tuple(
                replace(column, unit="s", of_day=not has_date(cells[index])) if index in clocks else column
                for index, column in enumerate(located.columns)
            )
            best = Dialect(delimiter, decimal, replace(located, columns=columns), clocks)
            most = (located.rows, whole)
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
    remarks: list[str] = []
    blocks: list[int] = []
    return Table(
        found.columns,
        lambda names: _read_columns(path, encoding, dialect, names, remarks, blocks),
        f"{layout}, numbers from line {found.first + 1} ({above} lines above)" if above != 1 else layout,
        lambda index: f"line {next(islice(_rows(path, encoding, dialect), index, None))[0]}",
        stated_rate(facts_of_lines(_COMMENT.sub("", line) for line in lines[: found.first])),
        ragged=True,
        remarks=remarks,
        blocks=blocks,
    )


def _encoding(path: Path) -> str:
    """Return the encoding of a text: that of its byte order mark, UTF-8, or that of Windows in Western Europe."""
    with path.open("rb") as stream:
        content = stream.read(LONGEST_LINE)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in content:
        raise InputError(
            f"{path}: is not text, and its ending names no format that is read; expected text, a bag, .xlsx, .mat, .h5 or "
            ".tdms: export it as one of these"
        )
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


def _read_columns(
    path: Path, encoding: str, dialect: Dialect, names: Sequence[str], remarks: list[str], blocks: list[int]
) -> dict[str, Array]:
    indices = [[column.name for column in dialect.located.columns].index(name) for name in names]
    rows = (line for _, line in _rows(path, encoding, dialect))
    delimiter: str | None = dialect.delimiter or None
    if dialect.decimal == ",":
        rows = (_with_points(line, dialect, indices) for line in rows)
        delimiter = "\t" if delimiter == "," else delimiter
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
    except ValueError:
        return _read_cells(path, encoding, dialect, names, indices, remarks, blocks)
    return {name: np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}


def _with_points(line: str, dialect: Dialect, indices: Sequence[int]) -> str:
    """Return a line with points in place of decimal commas; raise ValueError where a number has a point already."""
    if "." in line:
        cells = dict(enumerate(split_line(line, dialect.delimiter)))
        if any("." in cells.get(index, "") for index in indices if index not in dialect.clocks):
            raise ValueError(line)
    return ("\t".join(split_line(line, ",")) if dialect.delimiter == "," else line).replace(",", ".")


def _read_cells(
    path: Path,
    encoding: str,
    dialect: Dialect,
    names: Sequence[str],
    indices: Sequence[int],
    remarks: list[str],
    blocks: list[int],
) -> dict[str, Array]:
    """Read columns cell by cell: they may end early, and lines without numbers may stand between blocks of rows."""
    series = {name: array("d") for name in names}
    ended: dict[str, int] = {}
    between = 0
    above: list[tuple[int, str]] = []
    for number, line in _rows(path, encoding, dialect):
        cells = dialect.cells(line)
        if sum(isinstance(cell, float) for cell in cells) < 2:
            above.append((number, line.rstrip("\n")))
            ended.clear()
            continue
        if above:
            _check_header(path, above, dialect)
            between += len(above)
            blocks.append(begin_block(series))
            above.clear()
        for name, index in zip(names, indices, strict=True):
            cell = cells[index] if index < len(cells) else None
            if cell is None:
                ended.setdefault(name, number)
            elif isinstance(cell, float) and name not in ended:
                series[name].append(cell)
            else:
                line_of, found = (ended[name], "nothing") if name in ended else (number, one_line(repr(cell)))
                raise InputError(f"{path}: line {line_of}: {one_line(name)} is {found}, expected a number")
    if between or above:
        count = between + len(above)
        remarks.append(f"{count} {'line' if count == 1 else 'lines'} of text between or below the rows skipped")
    if ended:
        remarks.append(f"{' and '.join(map(one_line, ended))} {'ends' if len(ended) == 1 else 'end'} early")
    return {name: np.array(values) for name, values in series.items()}


def _check_header(path: Path, above: Sequence[tuple[int, str]], dialect: Dialect) -> None:
    """Refuse lines above a further block of rows that name its columns or units otherwise than those above the first."""
    first = dialect.located
    width = len(first.columns)
    names, units = header_of([split_header(line, dialect.delimiter, width) for _, line in above], width)
    is_header = any(name in first.names for name in names) or 2 * sum(map(names_quantity, names)) >= width
    is_same = names == first.names and (units == first.units or not any(units))
    if is_header and not is_same:
        shown = ", ".join(map(one_line, names))
        raise InputError(
            f"{path}: line {above[0][0]}: begins a table with other columns or units ({shown}); split the file there"
        )


def _cell(text: str, decimal: str) -> Cell:
    if not text:
        return None
    if _NUMBERS[decimal].fullmatch(text):
        return float(re.sub(rf"[^\w+\-{decimal}]", "", text).replace(",", ".").lower().replace("d", "e"))
    seconds = clock_seconds(text)
    return text if seconds is None else seconds


def _number(text: str) -> float:
    """Return the number of a cell of a line in which points stand for decimal commas."""
    seconds = clock_seconds(text.strip().strip('"'))
    return float(text) if seconds is None else seconds
