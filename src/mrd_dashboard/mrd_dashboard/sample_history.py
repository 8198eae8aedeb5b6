"""The latest samples of the bench, at the full sampling rate."""

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive samples (n,) in SI units.

    Attributes
    ----------
    number : ndarray (n,) of int64
        Number of each sample, counted from the start of sampling.
    time, position, force, current : ndarray (n,)
        Bench time in s, position in m, force in N, coil current in A.
    """

    number: NDArray[np.int64]
    time: Array
    position: Array
    force: Array
    current: Array

    def __len__(self) -> int:
        return len(self.time)


class SampleHistory:
    """Keeps the latest samples, all of one rate; one thread adds, any thread reads.

    It begins anew when the bench was started again and when the sampling rate changes: velocities are computed of samples at
    equal distances.

    Parameters
    ----------
    capacity : int
        Number of samples kept; by default, half a minute at 2 kHz.
    """

    def __init__(self, capacity: int = 60_000) -> None:
        self._lock = threading.Lock()
        self._capacity = capacity
        # Twice as long as what is kept: samples follow each other in memory, and move to the front when the end is reached.
        self._series = np.zeros((4, 2 * capacity))
        self._numbers = np.zeros(2 * capacity, dtype=np.int64)
        self._end = 0
        self._period = 0.0

    def add(self, number: int, time: float, period: float, position: Array, force: Array, current: Array) -> None:
        """Add a block of samples, at most as many as are kept.

        Parameters
        ----------
        number : int
            Number of its first sample.
        time, period : float
            Bench time of its first sample, and time between two samples, in s.
        position, force, current : ndarray (n,)
            In m, N, A.
        """
        count = len(position)
        with self._lock:
            if count and (period != self._period or (self._end and time <= self._series[0, self._end - 1])):
                self._end, self._period = 0, period
            if self._end + count > 2 * self._capacity:
                kept = slice(self._end - self._capacity + count, self._end)
                self._end = self._capacity - count
                self._series[:, : self._end], self._numbers[: self._end] = self._series[:, kept], self._numbers[kept]
            new = slice(self._end, self._end + count)
            self._series[:, new] = time + period * np.arange(count), position, force, current
            self._numbers[new] = number + np.arange(count)
            self._end += count

    def latest(self, duration: float) -> Samples:
        """Return the samples of the last ``duration`` s; none before the first block came."""
        with self._lock:
            first = max(self._end - self._capacity, 0)
            times = self._series[0, first : self._end]
            if len(times):
                first += int(np.searchsorted(times, times[-1] - duration))
            shown = slice(first, self._end)
            return Samples(self._numbers[shown].copy(), *self._series[:, shown].copy())
