"""Recordings in CSV files."""

from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_base.table import read_csv
from mrd_base.tool import command
from mrd_runs.formats.recording import FileFormat, Recording
from mrd_runs.text import printable
from mrd_runs.validation import REQUIRED

OPTIONAL = ("velocity_mps", "acceleration_mps2", "temperature_C")

# Bounds of what is read into memory: bytes of a line and of a file, and lines; the last are nearly three hours at 1 kHz.
LONGEST_LINE, LARGEST_FILE, MOST_LINES = 2**16, 2**29, 10**7
_PIECE = 2**20  # bytes read at once
# Whether a byte ends a line, or may end one, for Python.
_ENDS_LINE = np.isin(np.arange(256), list(b"\n\r"))
_MAY_END_LINE = _ENDS_LINE | np.isin(np.arange(256), list(b"\v\f\x1c\x1d\x1e\x85\xa8\xa9"))


def read_csv_file(path: Path) -> Recording:
    """Read a CSV file with the columns `REQUIRED` and any of `OPTIONAL`."""
    check_bounds(path)
    try:
        table = read_csv(path, REQUIRED, OPTIONAL)
    except InputError as error:  # it may quote the file, which may hold anything
        hint = "" if has_own_header(path) else f" (`{command('mrd_runs', 'import')}` reads tables of other programs)"
        raise InputError(f"{printable(str(error))}{hint}") from None
    notes = [f"columns ignored: {', '.join(table.ignored)}"] if table.ignored else []
    return Recording(table.columns, {"format": "csv", "notes": notes, "lost": 0, "recovered": False}, table.place)


def has_own_header(path: Path) -> bool:
    """Whether the first line of a file names the columns of a run."""
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        header = next((line for line in stream if line.strip()), "")
    return set(REQUIRED) <= {name.strip(' \t\r\n"') for name in header.split(",")}


def check_bounds(path: Path) -> None:
    """Refuse a file that would take much more memory than any recording."""
    size = lines = unfinished = 0  # bytes, lines, and bytes of the line that has not ended yet
    try:
        with path.open("rb") as stream:
            while piece := stream.read(_PIECE):
                content = np.frombuffer(piece, np.uint8)
                ends = np.flatnonzero(_ENDS_LINE[content])
                lengths = np.diff(ends, prepend=-1 - unfinished, append=len(content))
                size += len(content)
                lines += int(np.count_nonzero(_MAY_END_LINE[content]))
                unfinished = int(lengths[-1]) - 1
                if lengths.max() > LONGEST_LINE:
                    raise InputError(f"{path}: has a line of more than {LONGEST_LINE} characters; expected a CSV file")
                if size > LARGEST_FILE or lines > MOST_LINES:
                    most = f"{LARGEST_FILE >> 20} MiB and {MOST_LINES} lines"
                    raise InputError(f"{path}: is larger than {most}; split it, or record into bags")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


CSV = FileFormat((".csv", ".txt", ""), "a CSV file", read_csv_file)
