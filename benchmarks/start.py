"""Time of a new process to its first results, with compilation or with a warm cache (goal: 2 s)."""

import os
import statistics
import subprocess
import sys
import tempfile
import time

from common import console, describe_machine, format_duration
from rich.table import Table

from mrd_base.workers import ending_with_parent

STARTS = 5
FIRST_USE = """
import time; began = time.perf_counter()
import mrd_identification
import numpy as np
from mrd_identification.problem import make_problem
from mrd_identification.recording import prepare_recording
from mrd_runs import Run
from mrd_sim.models import MODELS
imported = time.perf_counter()
t = np.arange(10_000) / 1000.0
x = 0.01 * np.sin(9.0 * t)
run = Run("start", t, x, np.gradient(x, t), 0.2 + 0.1 * np.sin(5.0 * t), 2000.0 * np.gradient(x, t))
problem, _ = make_problem(MODELS["bouc_wen"], [prepare_recording(run)])
problem.residuals(problem.base)
evaluated = time.perf_counter()
problem.jacobian(np.full(len(problem.free), 0.5))
print(imported - began, evaluated - imported, time.perf_counter() - evaluated)
"""


def start(cache: str) -> list[float]:
    """Measure a new process, in s: import, first candidate, first Jacobian, whole process, processor time."""
    began, used = time.perf_counter(), os.times()
    environment = os.environ | {"NUMBA_CACHE_DIR": cache}
    process = subprocess.run(
        ending_with_parent([sys.executable, "-c", FIRST_USE]), env=environment, check=True, capture_output=True, text=True
    )
    now = os.times()
    processor = now.children_user + now.children_system - used.children_user - used.children_system
    return [*map(float, process.stdout.split()), time.perf_counter() - began, processor]


def main() -> None:
    """Print the table."""
    table = Table(title="A process's first Bouc-Wen candidate and Jacobian, 10 s at 1 kHz", caption=describe_machine())
    for column in ("cache", "import mrd_identification", "one candidate", "one Jacobian", "whole process", "processor time"):
        table.add_column(column, justify="left" if column == "cache" else "right")
    with tempfile.TemporaryDirectory() as cache:
        cold = start(cache)
        warm = [statistics.median(times) for times in zip(*(start(cache) for _ in range(STARTS)), strict=True)]
    table.add_row("empty: compiles", *map(format_duration, cold))
    table.add_row("warm", *map(format_duration, warm))
    console.print(table)


if __name__ == "__main__":
    main()
