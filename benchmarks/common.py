"""What the benchmarks share: a motion, timing side by side, and how the figures are shown."""

import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray
from rich.console import Console

Array = NDArray[np.float64]

RATE = 1000.0
AMPLITUDES = np.array([8e-3, 4e-3, 2e-3])  # m
FREQUENCIES = 2 * np.pi * np.array([0.7, 2.1, 3.7])  # rad/s

console = Console(width=None if os.isatty(1) else 120, highlight=False)


@njit(cache=True)
def position(t: float) -> float:
    """Position of the rod in m: reversals of many sizes, up to 0.13 m/s."""
    return (
        AMPLITUDES[0] * np.sin(FREQUENCIES[0] * t)
        + AMPLITUDES[1] * np.sin(FREQUENCIES[1] * t + 1.0)
        + (AMPLITUDES[2] * np.sin(FREQUENCIES[2] * t + 2.0))
    )


@njit(cache=True)
def velocity(t: float) -> float:
    """Its velocity in m/s."""
    return AMPLITUDES[0] * FREQUENCIES[0] * np.cos(FREQUENCIES[0] * t) + (
        AMPLITUDES[1] * FREQUENCIES[1] * np.cos(FREQUENCIES[1] * t + 1.0)
        + AMPLITUDES[2] * FREQUENCIES[2] * np.cos(FREQUENCIES[2] * t + 2.0)
    )


@njit(cache=True)
def current(t: float) -> float:
    """Coil current in A."""
    return 0.2 + 0.15 * np.sin(5.0 * t)


@njit(cache=True)
def _sampled(time_s: Array) -> tuple[Array, Array, Array]:
    x, v, i = np.empty_like(time_s), np.empty_like(time_s), np.empty_like(time_s)
    for k in range(len(time_s)):
        x[k], v[k], i[k] = position(time_s[k]), velocity(time_s[k]), current(time_s[k])
    return x, v, i


def sampled(samples: int) -> tuple[Array, Array, Array, Array]:
    """The motion at `RATE`: instants in s, position in m, velocity in m/s, current in A."""
    time_s = np.arange(samples) / RATE
    return time_s, *_sampled(time_s)


def timed(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Time in s of ``work``."""
    began = clock()
    work()
    return clock() - began


def side_by_side(works: Mapping[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Median processor time in s of each work on one thread, taken in turns.

    Whatever else the machine does slows all of them or, as far as it only makes them wait, none.

    Parameters
    ----------
    works : mapping
        By name: the work, and how many times it is done in its turn.
    rounds : int
    """
    measured: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, times) in works.items():
            measured[name] += [timed(work, time.process_time) for _ in range(times)]
    return {name: statistics.median(times) for name, times in measured.items()}


def duration(seconds: float) -> str:
    """A time with three digits in the unit that suits it."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def machine() -> str:
    """What the figures were measured on."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo") as info:
            name = next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    load, blas = os.getloadavg()[0], os.environ.get("OPENBLAS_NUM_THREADS", "all")
    python = f"Python {platform.python_version()}, NumPy {np.__version__}"
    return f"{name}, {os.cpu_count()} cores, load {load:.1f}, {python}, BLAS threads: {blas}"
