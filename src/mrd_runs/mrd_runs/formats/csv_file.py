"""Recordings in CSV files."""

from pathlib import Path

from mrd_base.table import read_csv
from mrd_runs.formats.recording import FileFormat, Recording

REQUIRED = ("time_s", "position_m", "current_A", "force_N")
OPTIONAL = ("velocity_mps", "acceleration_mps2", "temperature_C")


def read_csv_file(path: Path) -> Recording:
    """Read a CSV file with the columns `REQUIRED` and any of `OPTIONAL`."""
    table = read_csv(path, REQUIRED, OPTIONAL)
    notes = [f"columns ignored: {', '.join(table.ignored)}"] if table.ignored else []
    return Recording(table.columns, {"format": "csv", "notes": notes, "lost": 0, "recovered": False}, table.place)


CSV = FileFormat((".csv", ".txt", ""), "a CSV file", read_csv_file)
