"""Runs in CSV files."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

Array = NDArray[np.float64]

REQUIRED = ("time_s", "position_m", "current_A", "force_N")
OPTIONAL = ("velocity_mps", "acceleration_mps2", "temperature_C")


def read_csv(path: str | Path) -> tuple[dict[str, Array], list[str], list[int]]:
    """Read the columns of a CSV file.

    Parameters
    ----------
    path : path
        A file with one header line that holds at least ``time_s, position_m, current_A, force_N``, in any order.

    Returns
    -------
    columns : dict of str to ndarray (n,)
        The known columns.
    notes : list of str
        Which other columns were ignored.
    lines : list of int
        Line of the file of each sample, for messages.

    Raises
    ------
    InputError
        When the file is missing, empty, no text, lacks a column, or a cell holds no number.
    """
    path = Path(path)
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise InputError(f"{path}: is no text; expected a CSV file with the header {','.join(REQUIRED)}")
    lines = text.splitlines()
    filled = [number for number, line in enumerate(lines) if line.strip()]
    if not filled:
        raise InputError(f"{path}: is empty; expected the header {','.join(REQUIRED)} and samples")
    header = [name.strip() for name in next(csv.reader([lines[filled[0]]]))]
    _check_header(header, path)
    known = [name for name in header if name in REQUIRED + OPTIONAL]
    rows = filled[1:]
    body = "\n".join(lines[number] for number in rows)
    indices = [header.index(name) for name in known]
    try:
        table = (
            np.loadtxt(
                io.StringIO(body), delimiter=",", usecols=indices, ndmin=2, comments=None, quotechar='"', dtype=np.float64
            )
            if rows
            else np.empty((0, len(known)))
        )
    except ValueError as error:
        raise _bad_cell(lines, rows, header, known, path) or InputError(
            f"{path}: cannot be read ({' '.join(str(error).split())})"
        ) from None
    ignored = [name for name in header if name not in known]
    notes = [f"columns ignored: {', '.join(ignored)}"] if ignored else []
    columns: Mapping[str, Array] = {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(known)}
    return dict(columns), notes, [number + 1 for number in rows]


def _check_header(header: list[str], path: Path) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        shown = ", ".join(name[:40] for name in header[:20])
        hint = "; columns are separated by commas" if len(header) == 1 and any(c in header[0] for c in ";\t") else ""
        raise InputError(
            f"{path}: column {', '.join(missing)} is missing (found: {shown!s}{hint}); expected {','.join(REQUIRED)}"
        )
    for name in REQUIRED + OPTIONAL:
        if header.count(name) > 1:
            raise InputError(f"{path}: column {name} stands {header.count(name)} times in the header, expected once")


def _bad_cell(lines: list[str], rows: list[int], header: list[str], known: list[str], path: Path) -> InputError | None:
    """The first cell that is no number; found slowly, after the fast parser has failed."""
    for number in rows:
        cells = next(csv.reader([lines[number]]))
        for name in known:
            index = header.index(name)
            if index >= len(cells):
                return InputError(f"{path}: line {number + 1}: has {len(cells)} cells, expected {len(header)}")
            try:
                float(cells[index])
            except ValueError:
                found = repr(cells[index].strip()[:40]) if cells[index].strip() else "nothing"
                return InputError(f"{path}: line {number + 1}: {name} is {found}, expected a number")
    return None
