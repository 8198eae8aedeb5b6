"""The interface of a DAQ backend, and the blocks of readings that it delivers."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mrd_bench_driver.acquisition.channels import ChannelMap, CoilOutput


class AcquisitionError(Exception):
    """The converter failed while it ran. The message names the remedy; `Backend.open` may restart the converter."""


@dataclass(frozen=True)
class ConverterSettings:
    """ConverterSettings of the converter, its sample rate in Hz, and the length of a block in s."""

    device: str
    channels: ChannelMap
    coil: CoilOutput
    hardware_rate: float
    block: float

    @property
    def block_samples(self) -> int:
        """Readings per channel in one block."""
        return max(1, round(self.block * self.hardware_rate))


@dataclass(frozen=True)
class VoltBlock:
    """Successive readings, or averages of readings, of all channels.

    Attributes
    ----------
    sequence : int
        Number of the first reading. A jump shows lost readings, a step back a converter that was restarted.
    time : float
        Bench time of the first reading in s.
    volts : ndarray (channels, n)
        Voltages in V, channels in the order of `ChannelMap`.
    """

    sequence: int
    time: float
    volts: NDArray[np.float64]


class Backend(Protocol):
    """A converter with its coil output. One thread reads it; any thread may write or close it."""

    product: str
    """Product and serial number, known once the converter is open."""

    def open(self) -> None:
        """Set the coil output to 0 V and start sampling; raise InputError if this fails."""

    def read(self) -> VoltBlock | None:
        """Wait for the next block. Return None if none came for a moment; raise AcquisitionError if none will come."""

    def write(self, volts: float) -> None:
        """Set the voltage of the coil output."""

    def close(self) -> None:
        """Set the coil output to 0 V and release the converter. This may be called at any time, and twice."""
