"""Faults of the machine: its processor, its disk, its clock."""

import os
import resource
import subprocess
import sys
from collections.abc import Callable

from faults.campaign import Bench, Ending, Fault


def _starve(bench: Bench) -> None:
    for _ in range(2 * (os.cpu_count() or 1)):
        bench.background.append(subprocess.Popen([sys.executable, "-c", "while True: pass"]))


def _fill_disk(bench: Bench) -> None:
    """A limit of the size of its files is to the recorder what a full disk is."""
    size = max(file.stat().st_size for file in bench.bag.glob("*.mcap"))
    resource.prlimit(bench.processes.running["recorder"].pid, resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def _empty_disk(bench: Bench) -> None:
    unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    resource.prlimit(bench.processes.running["recorder"].pid, resource.RLIMIT_FSIZE, unlimited)


def _slow_disk(bench: Bench) -> None:
    bench.slow_disk.touch()


def _fast_disk(bench: Bench) -> None:
    bench.slow_disk.unlink()


def _step_clock(seconds: float) -> Callable[[Bench], None]:
    def inject(bench: Bench) -> None:
        bench.step_clock(seconds)

    return inject


FAULTS = (
    Fault("processor: twice as many busy processes as cores", _starve, "", Ending.COMPLETE, repair=lambda bench: None),
    Fault(
        "disk: full",
        _fill_disk,
        "cannot be written",
        Ending.ENDED,
        # The recorder writes within 0.25 s, and the run ends as by `stop`.
        rest=0.5,
        coil=0.5,
        repair=_empty_disk,
        recorded=False,
    ),
    Fault("disk: each fsync takes a second", _slow_disk, "", Ending.COMPLETE, repair=_fast_disk),
)
