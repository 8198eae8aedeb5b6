"""What every backend does."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mrd_bench_driver.channels import Channels, Coil


class AcquisitionError(Exception):
    """The converter failed while running, in one line with the remedy; `Backend.open` may start it anew."""


@dataclass(frozen=True)
class Wiring:
    """What is connected where, and how fast it is read."""

    device: str
    channels: Channels
    coil: Coil
    hardware_rate: float
    block: float

    @property
    def block_samples(self) -> int:
        """Samples per channel in one block."""
        return max(1, round(self.block * self.hardware_rate))


@dataclass(frozen=True)
class VoltBlock:
    """Successive readings of all channels.

    Attributes
    ----------
    sequence : int
        Number of the first reading; a jump tells of lost ones, a step back of a converter that started anew.
    time : float
        Bench time of the first reading in s.
    volts : ndarray (channels, n)
        V, channels in the order of `Channels`.
    """

    sequence: int
    time: float
    volts: NDArray[np.float64]


class Backend(Protocol):
    """A converter with its coil output. One thread reads; any thread may write or close."""

    product: str
    """Product and serial number, known once open."""

    def open(self) -> None:
        """Put 0 V on the coil output and start sampling; InputError when that cannot be."""

    def read(self) -> VoltBlock | None:
        """Wait for the next block; None when none came within a moment, AcquisitionError when none will."""

    def write(self, volts: float) -> None:
        """Put a voltage on the coil output."""

    def close(self) -> None:
        """Leave 0 V on the coil output and let go of the converter; may be called at any time and twice."""
