"""The simulator: damper models, effects, measuring chain, simulated motor and DAQ."""

import contextlib
from pathlib import Path


def forget_stale_kernels(folder: Path) -> None:
    """Delete the compiled functions in ``folder`` that are older than any source of compiled functions there.

    numba looks only at the file of a function itself, not at those whose functions it calls: after a change of the
    hysteresis, the models would go on with the old one.
    """
    sources = [path for path in folder.rglob("*.py") if "njit" in path.read_text(encoding="utf-8")]
    newest = max((path.stat().st_mtime for path in sources), default=0.0)
    for index in folder.rglob("__pycache__/*.nbi"):
        with contextlib.suppress(OSError):
            if index.stat().st_mtime < newest:
                index.unlink()


forget_stale_kernels(Path(__file__).parent)
