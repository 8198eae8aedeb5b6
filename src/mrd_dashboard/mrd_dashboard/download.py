"""A recording as one file for the browser."""

import shutil
import tempfile
from pathlib import Path

from mrd_runs.csv_export import export_csv


def pack(recording: Path, kind: str) -> Path:
    """Return a new file, in a folder of its own, with a recording as zipped bag or with its samples as CSV."""
    folder = Path(tempfile.mkdtemp(prefix="mrd_download_"))
    try:
        if kind == "bag":
            return Path(shutil.make_archive(str(folder / recording.name), "zip", recording.parent, recording.name))
        target = folder / f"{recording.name}.csv"
        export_csv(recording, target)
        return target
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
