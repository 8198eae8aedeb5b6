"""Columns of numbers with a time column: reading them from CSV files and checking them."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base.errors import InputError
from mrd_base.text_file import read_text_file

Array = NDArray[np.float64]


class CsvTable(NamedTuple):
    """Columns read from a CSV file.

    Attributes
    ----------
    columns : dict of str to ndarray (n,)
        The columns that were asked for.
    ignored : list of str
        Names of the other columns.
    lines : list of int
        Line number of each sample in the file.
    """

    columns: dict[str, Array]
    ignored: list[str]
    lines: list[int]

    def place(self, index: int) -> str:
        """Return how a message names the sample of an index."""
        return f"line {self.lines[index]}"


def read_csv(path: str | Path, required: Sequence[str], optional: Sequence[str] = ()) -> CsvTable:
    """Read columns of a CSV file.

    Parameters
    ----------
    path : path
        A file whose first line that is not blank is a header.
    required, optional : sequence of str
        Names of columns, which may stand in any order.

    Raises
    ------
    InputError
        When the file cannot be read, is not text, lacks a required column, or a cell holds no number.
    """
    text = read_text_file(Path(path), f"a CSV file with the header {','.join(required)}")
    return parse_csv(text, path, required, optional)


def parse_csv(text: str, path: str | Path, required: Sequence[str], optional: Sequence[str] = ()) -> CsvTable:
    """Read columns of CSV text as `read_csv` reads those of a file; ``path`` names it in error messages."""
    if "\0" in text:
        raise InputError(f"{path}: is not text; expected a CSV file with the header {','.join(required)}")
    lines = text.splitlines()
    filled = [number for number, line in enumerate(lines) if line.strip()]
    if not filled:
        raise InputError(f"{path}: is empty; expected the header {','.join(required)} and samples")
    header = [name.strip() for name in next(csv.reader([lines[filled[0]]]))]
    _check_header(header, required, optional, path)
    names = [name for name in header if name in (*required, *optional)]
    rows = filled[1:]
    table = np.empty((0, len(names)))
    if rows:
        body = io.StringIO("\n".join(lines[number] for number in rows))
        indices = [header.index(name) for name in names]
        try:
            table = np.loadtxt(body, delimiter=",", usecols=indices, ndmin=2, comments=None, quotechar='"', dtype=np.float64)
        except ValueError as error:
            raise _first_bad_cell(lines, rows, header, names, path) or InputError(
                f"{path}: cannot be read ({' '.join(str(error).split())})"
            ) from None
    columns = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}
    return CsvTable(columns, [name for name in header if name not in names], [number + 1 for number in rows])


def _check_header(header: list[str], required: Sequence[str], optional: Sequence[str], path: str | Path) -> None:
    missing = [name for name in required if name not in header]
    if missing:
        shown = ", ".join(name[:40] for name in header[:20])
        hint = "; columns are separated by commas" if len(header) == 1 and any(c in header[0] for c in ";\t") else ""
        raise InputError(
            f"{path}: column {', '.join(missing)} is missing (found: {shown}{hint}); expected {','.join(required)}"
        )
    for name in (*required, *optional):
        if header.count(name) > 1:
            raise InputError(f"{path}: column {name} appears {header.count(name)} times in the header, expected once")


def _first_bad_cell(
    lines: list[str], rows: list[int], header: list[str], names: list[str], path: str | Path
) -> InputError | None:
    """Return the error about the first cell that holds no number; slow, for use after the fast parser has failed."""
    for number in rows:
        cells = next(csv.reader([lines[number]]))
        for name in names:
            index = header.index(name)
            if index >= len(cells):
                return InputError(f"{path}: line {number + 1}: has {len(cells)} cells, expected {len(header)}")
            try:
                float(cells[index])
            except ValueError:
                found = repr(cells[index].strip()[:40]) if cells[index].strip() else "nothing"
                return InputError(f"{path}: line {number + 1}: {name} is {found}, expected a number")
    return None


def check_columns(columns: Mapping[str, Array], fewest: int, where: str, place: Callable[[int], str]) -> None:
    """Check that columns are long enough and finite, and that ``time_s`` increases.

    Parameters
    ----------
    columns : mapping of str to ndarray (n,)
        Equally long columns, among them ``time_s``.
    fewest : int
        Smallest number of samples.
    where : str
        Prefix of error messages.
    place : callable
        Returns how an error message names the sample of an index.

    Raises
    ------
    InputError
        For the first sample that fails.
    """
    time = columns["time_s"]
    if len(time) < fewest:
        raise InputError(f"{where}: holds {len(time)} samples, expected at least {fewest}")
    for name, values in columns.items():
        finite = np.isfinite(values)
        if not finite.all():
            index = int(np.argmin(finite))
            raise InputError(f"{where}: {place(index)}: {name} is {values[index]}, expected a finite number")
    backwards = np.diff(time) <= 0
    if backwards.any():
        index = int(np.argmax(backwards)) + 1
        raise InputError(
            f"{where}: {place(index)}: time_s is {time[index]:.9g} after {time[index - 1]:.9g}, expected increasing time"
        )
