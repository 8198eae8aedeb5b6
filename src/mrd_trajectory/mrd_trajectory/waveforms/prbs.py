"""Pseudo-random binary sequence of maximal length."""

from dataclasses import dataclass

import numpy as np
import scipy

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Holds, Waveform, level_field


@dataclass(frozen=True)
class Prbs(Waveform):
    """Switch between two levels by a shift register of ``order`` bits with the maximal period ``2^order − 1`` bits.

    The spectrum is flat up to about ``0.44 / bit`` (Golomb, *Shift Register Sequences*, 1967).
    """

    low: float = level_field("level of a 0")
    high: float = level_field("level of a 1")
    bit: float = quantity(unit="s", doc="time of one bit", lower=1e-3, upper=3600)
    order: int = quantity(10, "", "bits of the shift register; repeats after 2^order − 1 bits", lower=2, upper=20)
    seed: int = quantity(0, "", "selects the start in the sequence", lower=0)

    def bits(self, count: int) -> np.ndarray[tuple[int], np.dtype[np.int8]]:
        """Return the first ``count`` bits."""
        # All states of the register but zero are on one cycle, so each of them is a start.
        start = 1 + int(np.random.default_rng(self.seed).integers(2**self.order - 1))
        register = (start >> np.arange(self.order)) & 1
        sequence: np.ndarray[tuple[int], np.dtype[np.int8]] = scipy.signal.max_len_seq(self.order, register, count)[0]
        return sequence

    def shape(self, duration: float) -> Holds:
        if duration / self.bit > 1e6:
            raise InputError("the sequence has more than a million bits; raise bit_s")
        count = int(np.ceil(duration / self.bit)) + 1
        bits = self.bits(count)
        switches = np.flatnonzero(np.diff(bits, prepend=1 - bits[0]))
        return Holds(self.bit * switches.astype(float), np.where(bits[switches] == 1, self.high, self.low))
