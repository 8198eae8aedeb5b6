"""Backend of the simulated plant. The node carries the voltages between the plant and this backend."""

import math
import queue
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import BenchClock
from mrd_bench_driver.acquisition.backend import AcquisitionError, ConverterSettings, VoltBlock


class Simulated:
    """Backend that receives blocks by `feed` and passes the coil voltage to ``send``."""

    def __init__(self, wiring: ConverterSettings, clock: BenchClock) -> None:
        self.product = "simulated"
        self.send: Callable[[float], None] = lambda _volts: None
        self._wiring, self._clock = wiring, clock
        self._inputs = [channel.input for _, channel in wiring.channels.items()]
        self._volts = math.nan  # on the coil output
        self._failed = False
        self._processing = False  # whether the block that was read last may still be processed
        self._blocks: queue.SimpleQueue[VoltBlock | AcquisitionError] = queue.SimpleQueue()

    def feed(
        self, sequence: int, time: float, sample_period: float, inputs: Sequence[str], volts: NDArray[np.float64]
    ) -> None:
        """Add a block from the plant: ``volts`` (n · inputs,), input after input."""
        if self._failed:
            return  # nobody reads
        self._clock.hold()
        self._blocks.put(self._to_block(sequence, time, sample_period, inputs, volts))

    def _to_block(
        self, sequence: int, time: float, sample_period: float, inputs: Sequence[str], volts: NDArray[np.float64]
    ) -> VoltBlock | AcquisitionError:
        if not inputs:
            return AcquisitionError("the converter is gone; check its cable and power, then call reset_fault")
        missing = [name for name in self._inputs if name not in inputs]
        if missing:
            return AcquisitionError(
                f"the plant has no {', '.join(missing)} (it has {', '.join(inputs)}); give both the same channels"
            )
        if abs(sample_period * self._wiring.hardware_rate - 1) > 1e-6:
            return AcquisitionError(
                f"the plant samples at {1 / sample_period if sample_period else 0:g} Hz, expected "
                f"{self._wiring.hardware_rate:g} Hz; give plant and daq the same rate"
            )
        if len(volts) % len(inputs):
            return AcquisitionError(
                f"the plant sent {len(volts)} values for {len(inputs)} channels, expected as many for each"
            )
        rows = [inputs.index(name) for name in self._inputs]
        return VoltBlock(sequence, time, volts.reshape(len(inputs), -1)[rows])

    def open(self) -> None:
        """Discard earlier blocks and set the coil output to 0 V."""
        self._discard()
        self._failed = False
        self._volts = math.nan
        self.write(0.0)

    def read(self) -> VoltBlock | None:
        """Return the next block, or None if none came for a moment. The block before has been processed by now."""
        if self._processing:
            self._processing = False
            self._clock.release()
        try:
            block = self._blocks.get(timeout=0.1)
        except queue.Empty:
            return None
        if isinstance(block, AcquisitionError):
            self._failed = True
            self._clock.release()
            self._discard()
            raise block
        self._processing = True
        return block

    def _discard(self) -> None:
        while not self._blocks.empty():
            self._blocks.get()
            self._clock.release()

    def write(self, volts: float) -> None:
        """Send a coil voltage to the plant, which keeps it."""
        if volts != self._volts:
            self._volts = volts
            self.send(volts)

    def close(self) -> None:
        """Set the coil output to 0 V."""
        self.write(0.0)
