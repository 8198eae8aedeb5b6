"""Deletion of compiled functions that a change of the sources has made stale.

numba looks only at the file of a function itself, not at those of the functions that it calls. After a change of the
hysteresis, the models would go on with the old one. ``setup/build`` runs this file, and pytest's ``conftest.py`` calls it.
"""

import contextlib
import sys
from pathlib import Path


def delete_stale_kernels(folder: Path) -> None:
    """Delete the indices of compiled functions in ``folder`` that are older than any source of compiled functions there."""
    sources = [path for path in folder.rglob("*.py") if "numba" in path.read_text(encoding="utf-8")]
    newest = max((path.stat().st_mtime for path in sources), default=0.0)
    for index in folder.rglob("__pycache__/*.nbi"):
        with contextlib.suppress(OSError):
            if index.stat().st_mtime < newest:
                index.unlink()


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        delete_stale_kernels(Path(argument))
