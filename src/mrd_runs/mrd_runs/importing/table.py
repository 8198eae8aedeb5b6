"""Tables of other programs: named columns of numbers, and where a table begins among rows of cells."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from mrd_runs.importing.units import is_unit

Array = NDArray[np.float64]
Cell = str | float | None

LONGEST_HEAD = 1000
"""Rows in which the beginning of a table is looked for."""
MOST_VALUES = 5 * 10**7
"""Numbers that are read of a file: five columns of nearly three hours at 1 kHz, 400 MB."""


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
    """

    name: str
    unit: str = ""
    text: str = ""


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
    """

    columns: tuple[Column, ...]
    read: Callable[[Sequence[str]], dict[str, Array]]
    layout: str = ""
    place: Callable[[int], str] = "sample {}".format


@dataclass(frozen=True)
class Located:
    """Where a table stands among rows: its columns, the index of its first row of numbers, and the number of such rows."""

    columns: tuple[Column, ...]
    first: int
    rows: int


def locate_table(rows: Sequence[Sequence[Cell]], header: Callable[[int, int], Sequence[Cell]]) -> Located | None:
    """Find the longest run of rows that look alike and hold at least two numbers, and the names above it.

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
    filled = [index for index, row in enumerate(rows) if any(cell is not None for cell in row)]
    run: list[int] = []
    for _, group in groupby(filled, lambda index: _kind(rows[index])):
        members = list(group)
        numbers = sum(isinstance(cell, float) for cell in rows[members[0]])
        if numbers >= 2 and len(members) > len(run):
            run = members
    if not run:
        return None
    width = len(rows[run[0]])
    above = [index for index in filled if index < run[0]]
    names, units = _header([header(index, width) for index in above[-2:]], width)
    used = {i for index in run for i, cell in enumerate(rows[index]) if cell is not None}
    texts = [cell if isinstance(cell, str) else "" for cell in rows[run[0]]]
    columns = [Column(names[i] if i in used else "", units[i], texts[i]) for i in range(width)]
    return Located(tuple(columns), run[0], len(run))


def _kind(row: Sequence[Cell]) -> tuple[int, tuple[int, ...]]:
    """Return what rows of one table share: their width, and which of their cells are texts."""
    return len(row), tuple(i for i, cell in enumerate(row) if isinstance(cell, str))


def _header(above: Sequence[Sequence[Cell]], width: int) -> tuple[list[str], list[str]]:
    """Return names and units of columns from the last two rows above them, where these have as many cells."""
    texts = [["" if cell is None else str(cell).strip() for cell in row] for row in above]
    fitting = [row[:width] if len(row) >= width and any(row) and not any(map(_is_number, row)) else None for row in texts]
    units = [""] * width
    names = fitting[-1] if fitting else None
    if names and len(fitting) > 1 and fitting[-2] and all(not cell or is_unit(cell.strip("[]() ")) for cell in names):
        names, units = fitting[-2], [cell.strip("[]() ") for cell in names]
    names = [name or f"column {i + 1}" for i, name in enumerate(names or [""] * width)]
    seen: Counter[str] = Counter()
    for i, name in enumerate(names):
        seen[name] += 1
        names[i] = name if seen[name] == 1 else f"{name} ({seen[name]})"
    return names, units


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
