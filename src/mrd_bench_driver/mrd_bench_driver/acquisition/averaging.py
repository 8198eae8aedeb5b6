"""Block averages: samples at the requested rate, each the mean of several readings of a faster converter."""

import math

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_bench_driver.acquisition.backend import VoltBlock

# Range of sample rates in Hz: from the paper's 25 Hz to the default rate of the converter.
MIN_RATE, MAX_RATE = 25.0, 2000.0


def averaging_ratio(rate: float, hardware_rate: float) -> int:
    """Return the number of readings per sample.

    Raises
    ------
    InputError
        If the rate is out of range or does not divide the converter's rate. The message names the nearest valid rates.
    """
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not math.isfinite(rate):
        raise InputError(f"rate_hz is {rate!r}, expected a number from {MIN_RATE:g} to {MAX_RATE:g}")
    ratio = hardware_rate / rate if rate > 0 else math.inf
    if MIN_RATE <= rate <= min(MAX_RATE, hardware_rate) and abs(ratio - round(ratio)) <= 1e-6 * ratio:
        return round(ratio)
    fewest, most = max(1, math.ceil(hardware_rate / MAX_RATE - 1e-9)), math.floor(hardware_rate / MIN_RATE + 1e-9)
    ratio = min(max(ratio, fewest), most)
    offers = " or ".join(f"{hardware_rate / number:.6g}" for number in sorted({math.floor(ratio), math.ceil(ratio)}))
    raise InputError(
        f"rate_hz is {rate:g}, expected {MIN_RATE:g} to {MAX_RATE:g} and a whole fraction of the converter's "
        f"{hardware_rate:g} Hz; the nearest is {offers}"
    )


class Averager:
    """Turns readings into block averages on a fixed grid.

    Sample number k is the mean of ``ratio`` readings, counted from the first reading; its time is the mean of their times.
    If readings are lost, their samples are left out, and the other samples keep their numbers.

    Parameters
    ----------
    ratio : int
        Readings per sample.
    block_samples : int
        Samples per block that `push` returns.
    hardware_rate : float
        Readings per second.
    """

    def __init__(self, ratio: int, block_samples: int, hardware_rate: float) -> None:
        self._ratio = ratio
        self._block_samples = block_samples
        self._period = 1 / hardware_rate
        self._shift: int | None = None  # from the converter's numbers to ours, which start at 0 and never go back
        self._next = 0  # our number of the next reading
        self._next_time = 0.0
        self._readings: NDArray[np.float64] | None = None  # of the incomplete sample
        self._samples: list[VoltBlock] = []  # complete, without a gap, not returned yet
        self.lost = 0
        """Number of readings lost so far."""

    def push(self, block: VoltBlock) -> list[VoltBlock]:
        """Add a block of readings; return the blocks of averages that are complete. No block has a gap inside."""
        count = block.volts.shape[1]
        if self._shift is None:
            self._shift = -block.sequence
        elif block.sequence + self._shift < self._next:
            # The converter was restarted: only the clock tells how many readings are lost. It is one at least.
            missing = max(1, round((block.time - self._next_time) / self._period))
            self._shift = self._next + missing - block.sequence
        first = block.sequence + self._shift
        ready: list[VoltBlock] = []
        if first > self._next:
            self.lost += first - self._next
            ready += self._pop_blocks(everything=True)
            self._readings = None
        self._next, self._next_time = first + count, block.time + count * self._period

        readings = block.volts
        if self._readings is not None:
            readings = np.hstack([self._readings, readings])
        start = self._next - readings.shape[1]
        skip = min(-start % self._ratio, readings.shape[1])
        whole = (readings.shape[1] - skip) // self._ratio
        end = skip + whole * self._ratio
        self._readings = readings[:, end:]
        if whole:
            means = readings[:, skip:end].reshape(len(readings), whole, self._ratio).mean(axis=2)
            middle = self._next_time + (start + skip - self._next + (self._ratio - 1) / 2) * self._period
            self._samples.append(VoltBlock((start + skip) // self._ratio, middle, means))
        return ready + self._pop_blocks(everything=False)

    def _pop_blocks(self, *, everything: bool) -> list[VoltBlock]:
        if not self._samples:
            return []
        first = self._samples[0]
        volts = self._samples[0].volts if len(self._samples) == 1 else np.hstack([part.volts for part in self._samples])
        count, size = volts.shape[1], self._block_samples
        end = count if everything else count - count % size
        if end == 0:
            return []
        period = self._ratio * self._period
        blocks = [
            VoltBlock(first.sequence + at, first.time + at * period, volts[:, at : min(at + size, end)])
            for at in range(0, end, size)
        ]
        rest = VoltBlock(first.sequence + end, first.time + end * period, volts[:, end:])
        self._samples = [rest] if end < count else []
        return blocks
