"""Faults of the machine: its processor, its disk, its clock."""

import errno
import os
import subprocess
import sys
from collections.abc import Callable

from faults.campaign import Bench, Ending, Fault


def _starve(bench: Bench) -> None:
    for _ in range(2 * (os.cpu_count() or 1)):
        bench.background.append(subprocess.Popen([sys.executable, "-c", "while True: pass"]))


def break_machine(**fault: int) -> Callable[[Bench], None]:
    return lambda bench: bench.machine.set(**fault)


def _step_clock(step: int) -> Callable[[Bench], None]:
    def inject(bench: Bench) -> None:
        bench.machine.set(clock_step=step)
        # A timer of ROS that follows the wall clock would be silent for an hour.
        bench.up.clear()
        silent = set(bench.processes.specs)
        bench.client.spin(lambda: silent <= bench.up, 20, watch=False)
        assert silent <= bench.up, f"no diagnostics of {', '.join(sorted(silent - bench.up))} after the step"

    return inject


def mend(bench: Bench) -> None:
    bench.machine.set()


def _disk_fails(name: str, error: int) -> Fault:
    # The recorder writes within 0.25 s, and the run ends as by `stop`.
    return Fault(
        f"disk: {name}",
        break_machine(disk_error=error),
        rf"bag\d+: cannot be written \({os.strerror(error)}; ",
        Ending.ENDED,
        rest=0.5,
        coil=0.5,
        repair=mend,
        recorded=False,
    )


FAULTS = (
    Fault("processor: twice as many busy processes as cores", _starve, "", Ending.COMPLETE, repair=lambda bench: None),
    _disk_fails("full", errno.ENOSPC),
    _disk_fails("read-only", errno.EROFS),
    _disk_fails("fails", errno.EIO),
    Fault("disk: each fsync takes a second", break_machine(fsync_time=1), "", Ending.COMPLETE, repair=mend),
    Fault("clock: stepped forward by an hour", _step_clock(3600), "", Ending.COMPLETE, repair=mend),
    Fault("clock: stepped back by an hour", _step_clock(-3600), "", Ending.COMPLETE, repair=mend),
)
