"""Time to read and smooth a ten-minute recording at 1 kHz (required: under 1 s), and to write it."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mrd_runs import read_run
from mrd_runs.bag import BagWriter, read_bag
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.signals.motion import smooth_motion

RATE, DURATION, BLOCK = 1000, 600, 20


def shortest_time(work: Callable[[], object]) -> float:
    """Return the shortest of three times in s, after a first call that compiles."""
    work()
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def write(folder: Path) -> None:
    """Write a bag of quantised sensor signals like those of the DAQ."""
    rng, n = np.random.default_rng(0), RATE * DURATION
    t = np.arange(n) / RATE
    x = 0.01 * np.sin(9.4 * t) + 1e-3 * np.sin(40 * t)

    def read(signal: np.ndarray, noise: float, step: float) -> np.ndarray:
        return np.round((signal + rng.normal(0, noise, n)) / step) * step

    position = read(x, 5e-6, 1.6e-6)
    force = read(200 * np.tanh(100 * np.gradient(x, t)), 1.5, 0.03)
    current = read(np.full(n, 0.15), 4e-3, 1.7e-3)
    acceleration = read(np.gradient(np.gradient(x, t), t), 0.05, 2e-3)
    types = typestore().types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    with BagWriter(folder) as writer:
        writer.add_topic("/samples", SAMPLES_TYPE, depth=200)
        for first in range(0, n, BLOCK):
            part = slice(first, first + BLOCK)
            at = first * 10**9 // RATE
            series = (position[part], force[part], current[part], acceleration[part])
            block = types[SAMPLES_TYPE](header(stamp(at // 10**9, at % 10**9), ""), 1 / RATE, first, *series, np.empty(0))
            writer.write_message("/samples", at, block)


def main() -> None:
    """Print the times."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch, "run")
        start = time.perf_counter()
        write(folder)
        elapsed = time.perf_counter() - start
        size = sum(file.stat().st_size for file in folder.iterdir())
        print(f"write {DURATION} s at {RATE} Hz:        {elapsed:6.3f} s, {size / 1e6:.1f} MB")
        print(f"read_run (required: under 1 s): {shortest_time(lambda: read_run(folder)):6.3f} s")
        print(f"  of it read_bag:               {shortest_time(lambda: read_bag(folder)):6.3f} s")
        run = read_run(folder)
        for n in (60_000, len(run)):
            time_n, position = run.time[:n], run.position[:n]
            acceleration = None if run.acceleration is None else run.acceleration[:n]
            print(f"smooth {n:6d} positions:        {shortest_time(lambda: smooth_motion(time_n, position)):6.3f} s")  # noqa: B023
            both = shortest_time(lambda: smooth_motion(time_n, position, acceleration))  # noqa: B023
            print(f"  with accelerometer:           {both:6.3f} s")


if __name__ == "__main__":
    main()
