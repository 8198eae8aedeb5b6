"""A machine whose wall clock steps and whose disk fails, for the processes that it is given to and for nobody else."""

import struct
import subprocess
from pathlib import Path

_LAYOUT = struct.Struct("=3q")


class BrokenMachine:
    """A library that is preloaded into processes, and the file that tells it what is wrong (``broken_machine.c``).

    Parameters
    ----------
    folder : Path
        Where both are made; it needs the C compiler with which the messages were built.
    """

    def __init__(self, folder: Path) -> None:
        library, self._file = folder / "broken_machine.so", folder / "machine"
        self._file.write_bytes(_LAYOUT.pack(0, 0, 0))
        source = Path(__file__).with_suffix(".c")
        subprocess.run(["cc", "-shared", "-fPIC", "-O2", "-o", library, source, "-ldl"], check=True)
        self.environment = {"LD_PRELOAD": str(library), "MRD_MACHINE": str(self._file)}

    def set(self, clock_step: int = 0, fsync_time: int = 0, disk_error: int = 0) -> None:
        """Step the wall clock by whole s, let each fsync take whole s, and let writes fail with an ``errno``."""
        # The processes map the file, so that it must never be shorter.
        with self._file.open("r+b") as file:
            file.write(_LAYOUT.pack(clock_step, fsync_time, disk_error))
