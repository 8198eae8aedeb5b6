"""Recordings of other programs and benches, made into bags by the tool ``import``."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from mrd_base import InputError


def import_files(files: Sequence[Path], folder: Path) -> list[str]:
    """Make bags of files, which stand in one folder; return the names of these bags.

    Raises
    ------
    InputError
        With what the tool says, where it cannot read one of the files. Then there is no new bag.
    """
    command = [sys.executable, "-m", "mrd_runs.cli.import_", *map(str, files), "--output", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        said = done.stderr.strip().splitlines() or ["the tool import has failed"]
        raise InputError("; ".join(said).replace(f"{files[0].parent}/", "").removeprefix("error: "))
    return [Path(line.partition(": ")[0]).name for line in done.stdout.splitlines() if not line.startswith(" ")]
