"""Means of blocks of samples, as scalars for plots."""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_bench_driver.acquisition.channels import UNITS


class Means(NamedTuple):
    """Means of one block: bench time of its middle in s, and each quantity of `UNITS` and the velocity, in SI units."""

    time: float
    values: dict[str, float]


class BlockMeans:
    """Averages blocks of samples that follow each other.

    The velocity in the middle of a block comes from the mean positions of the blocks before and after it: differences of
    single samples would show little but the noise of the LVDT. The means of a block are therefore known one block later, and
    not at all where a neighbour is missing.
    """

    def __init__(self) -> None:
        self._blocks: deque[Means] = deque(maxlen=3)
        self._next_time = -np.inf

    def add(self, time: float, period: float, samples: NDArray[np.float64]) -> Means | None:
        """Add a block; return the means of the block before it, if that has two neighbours.

        Parameters
        ----------
        time : float
            Bench time in s of the first sample.
        period : float
            Sample period in s.
        samples : ndarray (channels, n)
            Samples in SI units, in the order of `UNITS`; the last of these may be missing, whose mean is then nan.
        """
        count = samples.shape[1]
        if abs(time - self._next_time) > 0.5 * period:  # samples are missing, or the rate has changed
            self._blocks.clear()
        self._next_time = time + count * period
        means = dict.fromkeys(UNITS, math.nan) | dict(zip(UNITS, samples.mean(axis=1).tolist(), strict=False))
        self._blocks.append(Means(time + (count - 1) / 2 * period, means))
        if len(self._blocks) < 3:
            return None
        before, block, after = self._blocks
        velocity = (after.values["position"] - before.values["position"]) / (after.time - before.time)
        return Means(block.time, block.values | {"velocity": velocity})
