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
    """Keeps the latest samples; one thread adds, any thread reads.

    Parameters
    ----------
    capacity : int
        Number of samples kept; by default, half a minute at 2 kHz.
    """

    def __init__(self, capacity: int = 60_000) -> None:
        self._lock = threading.Lock()
        self._ring = np.zeros((4, capacity))
        self._numbers = np.zeros(capacity, dtype=np.int64)
        self._added = 0

    def add(self, number: int, time: float, period: float, position: Array, force: Array, current: Array) -> None:
        """Add a block of samples.

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
        times = time + period * np.arange(count)
        with self._lock:
            capacity = len(self._numbers)
            if self._added and count and times[0] <= self._ring[0, (self._added - 1) % capacity]:
                self._added = 0  # the bench was started again
            places = (self._added + np.arange(count)) % capacity
            self._ring[:, places] = times, position, force, current
            self._numbers[places] = number + np.arange(count)
            self._added += count

    def latest(self, duration: float) -> Samples:
        """Return the samples of the last ``duration`` s; none before the first block came."""
        with self._lock:
            capacity = len(self._numbers)
            kept = min(self._added, capacity)
            places = (self._added - kept + np.arange(kept)) % capacity
            times = self._ring[0, places]
            if kept:
                places = places[np.searchsorted(times, times[-1] - duration) :]
            return Samples(self._numbers[places], *self._ring[:, places])
