"""Tables of other programs: named columns of numbers, and where a table begins among rows of cells."""

from array import array
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mrd_runs.importing.units import is_unit, looks_like_unit
from mrd_runs.importing.words import names_quantity, words_of
from mrd_runs.run import FEWEST_SAMPLES

Array = NDArray[np.float64]
Cell = str | float | None

LONGEST_HEAD = 1000
"""Rows in which the beginning of a table is looked for."""
MOST_VALUES = 5 * 10**7
"""Numbers that are read of a file: five columns of nearly three hours at 1 kHz, 400 MB."""

_HEADER = 5
"""Lines above the numbers in which the names and units of the columns are looked for."""
_USUAL = 0.9
"""Share of rows with a number in a column, from which the first row of the table has one there, too."""


@dataclass(frozen=True)
class Column:
    """A column of a file.

    Attributes
    ----------
    name : str
        As the file has it.
    unit : str
        "" where the file does not say.
    text : str
        What stands in the first row of a column that holds no numbers; "" for numbers.
    time : str
        Name of the column that holds its times, where the file says so.
    of_day : bool
        Whether it holds times of day, which begin again at midnight.
    problem : str
        What of it is not understood, so that its numbers cannot be taken as they are; "" where nothing is.
    """

    name: str
    unit: str = ""
    text: str = ""
    time: str = ""
    of_day: bool = False
    problem: str = ""


@dataclass(frozen=True)
class Table:
    """Columns of a file, which are read only when they are asked for.

    Attributes
    ----------
    columns : tuple of Column
    read : callable
        Takes names of columns and returns their values, ndarray (n,) each; raises InputError.
    layout : str
        How the file was understood, for a note; "" where there is nothing to say.
    place : callable
        Returns how an error message names the sample of an index.
    rate : float or None
        Sample rate in Hz that the file states.
    ragged : bool
        Whether columns of one table may end early, because the file is cut or its last rows are not complete.
    one_clock : bool
        Whether columns with the same times have them from one clock, as in one file; that of two files may be two.
    remarks : list of str
        What was noticed while columns were read; `read` appends to it.
    blocks : list of int
        Indices of the rows with which blocks of the file begin; `read` appends to it.
    """

    columns: tuple[Column, ...]
    read: Callable[[Sequence[str]], dict[str, Array]]
    layout: str = ""
    place: Callable[[int], str] = "sample {}".format
    rate: float | None = None
    ragged: bool = False
    one_clock: bool = True
    remarks: list[str] = field(default_factory=list)
    blocks: list[int] = field(default_factory=list)


def join_tables(tables: Mapping[str, Table]) -> Table | None:
    """Return the channels of several files as one table; None where a file is more than a channel over its time.

    Parameters
    ----------
    tables : mapping of str to Table
        By a name of the file, which stands before those of its columns.
    """
    columns: list[Column] = []
    for name, table in tables.items():
        numbers = [column for column in table.columns if column.name and not column.text]
        if len(numbers) != 2:
            return None
        time, values = (f"{name}: {column.name}" for column in numbers)
        columns += [replace(numbers[0], name=time), replace(numbers[1], name=values, time=time)]

    def read(names: Sequence[str]) -> dict[str, Array]:
        series: dict[str, Array] = {}
        for name, table in tables.items():
            of_file = {f"{name}: {column.name}": column.name for column in table.columns}
            if wanted := [of_file[each] for each in names if each in of_file]:
                series |= {f"{name}: {column}": values for column, values in table.read(wanted).items()}
        return series

    layout = f"{len(tables)} files of one channel each are one recording; expected that all times count from one instant"
    return Table(tuple(columns), read, layout, one_clock=False)


def begin_block(series: Mapping[str, "array[float]"]) -> int:
    """Cut columns, of which some have ended early, to the shortest, so that another block fits; return its index."""
    shortest = min(map(len, series.values()))
    for values in series.values():
        del values[shortest:]
    return shortest


@dataclass(frozen=True)
class Located:
    """Where a table stands among rows: its columns, the index of its first row of numbers, and the most such rows in a row.

    ``names`` and ``units`` are those of the rows above, of all columns.
    """

    columns: tuple[Column, ...]
    first: int
    rows: int
    names: list[str]
    units: list[str]


def locate_table(rows: Sequence[Sequence[Cell]], header: Callable[[int, int], Sequence[Cell]]) -> Located | None:
    """Find the longest run of rows with numbers in the same columns, at least two, and the names above it.

    Parameters
    ----------
    rows : sequence of rows
        Cells: numbers, texts, or None for a blank one.
    header : callable
        Takes the index of a row and a number of columns, and returns the cells of that row as those of a header.

    Returns
    -------
    Located or None
        None without such rows.
    """
    numbers = [{i for i, cell in enumerate(row) if isinstance(cell, float)} for row in rows]
    runs: list[list[int]] = []
    for index in (index for index, row in enumerate(rows) if any(cell is not None for cell in row)):
        before = numbers[runs[-1][-1]] if runs else set()
        together = len(numbers[index] & before) >= max(2, 0.5 * max(len(numbers[index]), len(before)))
        if together:
            runs[-1].append(index)
        else:
            runs.append([index])
    runs = [run for run in runs if len(numbers[run[-1]]) >= 2]
    longest = max(runs, key=len, default=[])
    counts = Counter(i for index in longest for i in numbers[index])
    core = {i for i, count in counts.items() if count >= _USUAL * len(longest)}
    # A file of several blocks begins with the first that may be a recording.
    least = min(FEWEST_SAMPLES, len(longest))
    run = next((run for run in runs if len(run) >= least and core <= numbers[run[len(run) // 2]]), longest)
    run = run[next((k for k, index in enumerate(run) if core <= numbers[index]), 0) :]
    counts = Counter(i for index in run for i in numbers[index])
    if not run:
        return None
    width = max(len(rows[index]) for index in run)
    above = [index for index in range(run[0]) if any(cell is not None for cell in rows[index])]
    names, units = header_of([header(index, width) for index in above[-_HEADER:]], width)
    columns = []
    for i in range(width):
        cells = [rows[index][i] for index in run if i < len(rows[index]) and rows[index][i] is not None]
        text = next((cell for cell in cells if isinstance(cell, str)), "") if 2 * counts[i] < len(cells) else ""
        columns.append(Column(names[i] if cells else "", units[i], text))
    return Located(tuple(columns), run[0], len(longest), names, units)


def header_of(above: Sequence[Sequence[Cell]], width: int) -> tuple[list[str], list[str]]:
    """Return names and units of columns from the rows above them that have as many cells.

    The names are those of the last row, or of one above it that names more quantities: channel numbers or types of numbers
    may stand below. The units are those of the row that is nearest to the names.
    """
    texts = [["" if cell is None else str(cell).strip() for cell in row] for row in above]
    fitting = [
        row[:width] for row in texts if len(row) >= width and any(map(words_of, row)) and not any(map(_is_number, row))
    ]
    of_units = [_are_units(row) for row in fitting]
    named = [index for index, is_unit_row in enumerate(of_units) if not is_unit_row] or [*range(len(fitting))][-1:]
    units = [""] * width
    names = [""] * width
    if named:
        known = {index: sum(map(names_quantity, fitting[index])) for index in named}
        enough = [index for index in named if 2 * known[index] >= width]
        place = max(enough or named[-1:], key=lambda index: (known[index], index))
        names = fitting[place]
        nearest = sorted((abs(index - place), -index) for index, is_unit_row in enumerate(of_units) if is_unit_row)
        if nearest and -nearest[0][1] != place:
            units = [cell.strip("[]()<>{} -") for cell in fitting[-nearest[0][1]]]
    names = [name or f"column {i + 1}" for i, name in enumerate(names)]
    seen: Counter[str] = Counter()
    for i, name in enumerate(names):
        seen[name] += 1
        names[i] = name if seen[name] == 1 else f"{name} ({seen[name]})"
    return names, units


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether most cells of a row name units."""
    texts = [text for cell in cells if (text := cell.strip("[]()<>{} -"))]
    known = sum(map(is_unit, texts))
    return known > 0 and 2 * sum(map(looks_like_unit, texts)) > len(texts)


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
