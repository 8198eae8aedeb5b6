"""Shared by the benchmarks: a motion of the rod, the timing of alternatives, and the format of the figures."""

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
    """Return the position of the rod in m: strokes of many lengths, up to 0.13 m/s."""
    return (
        AMPLITUDES[0] * np.sin(FREQUENCIES[0] * t)
        + AMPLITUDES[1] * np.sin(FREQUENCIES[1] * t + 1.0)
        + (AMPLITUDES[2] * np.sin(FREQUENCIES[2] * t + 2.0))
    )


@njit(cache=True)
def velocity(t: float) -> float:
    """Return the velocity of the rod in m/s."""
    return AMPLITUDES[0] * FREQUENCIES[0] * np.cos(FREQUENCIES[0] * t) + (
        AMPLITUDES[1] * FREQUENCIES[1] * np.cos(FREQUENCIES[1] * t + 1.0)
        + AMPLITUDES[2] * FREQUENCIES[2] * np.cos(FREQUENCIES[2] * t + 2.0)
    )


@njit(cache=True)
def current(t: float) -> float:
    """Return the coil current in A."""
    return 0.2 + 0.15 * np.sin(5.0 * t)


@njit(cache=True)
def _sampled(time_s: Array) -> tuple[Array, Array, Array]:
    x, v, i = np.empty_like(time_s), np.empty_like(time_s), np.empty_like(time_s)
    for k in range(len(time_s)):
        x[k], v[k], i[k] = position(time_s[k]), velocity(time_s[k]), current(time_s[k])
    return x, v, i


def sampled(samples: int) -> tuple[Array, Array, Array, Array]:
    """Sample the motion at `RATE`: time in s, position in m, velocity in m/s, current in A."""
    time_s = np.arange(samples) / RATE
    return time_s, *_sampled(time_s)


def measure_time(work: Callable[[], object], clock: Callable[[], float] = time.perf_counter) -> float:
    """Return the time in s that ``work`` takes."""
    began = clock()
    work()
    return clock() - began


def measure_alternately(works: Mapping[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Return the median processor time in s of each work on one thread, measured in turns.

    Other load of the machine then slows all of them equally; time in which they only wait does not count.

    Parameters
    ----------
    works : mapping
        By name: the work, and how often it is repeated in its turn.
    rounds : int
    """
    measured: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, (work, times) in works.items():
            measured[name] += [measure_time(work, time.process_time) for _ in range(times)]
    return {name: statistics.median(times) for name, times in measured.items()}


def format_duration(seconds: float) -> str:
    """Format a time with three digits, in s, ms or µs."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} µs"


def describe_machine() -> str:
    """Describe the machine and the versions with which the figures were measured."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo") as info:
            name = next(line.split(":")[1].strip() for line in info if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    load, blas = os.getloadavg()[0], os.environ.get("OPENBLAS_NUM_THREADS", "all")
    python = f"Python {platform.python_version()}, NumPy {np.__version__}"
    return f"{name}, {os.cpu_count()} cores, load {load:.1f}, {python}, BLAS threads: {blas}"
