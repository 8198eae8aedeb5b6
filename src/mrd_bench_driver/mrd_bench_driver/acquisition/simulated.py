"""Terminals of the simulated plant; the node carries the volts to and fro."""

import queue
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import BenchClock
from mrd_bench_driver.acquisition.backend import AcquisitionError, VoltBlock, Wiring


def _nowhere(_volts: float) -> None:
    pass


class Simulated:
    """Backend that is fed with blocks and gives its coil voltage to ``send``."""

    def __init__(self, wiring: Wiring, _clock: BenchClock) -> None:
        self.product = "simulated"
        self.send: Callable[[float], None] = _nowhere
        self._wiring = wiring
        self._inputs = [channel.input for _, channel in wiring.channels.items()]
        self._blocks: queue.SimpleQueue[VoltBlock | AcquisitionError] = queue.SimpleQueue()

    def feed(
        self, sequence: int, time: float, sample_period: float, inputs: Sequence[str], volts: NDArray[np.float64]
    ) -> None:
        """Take a block as the plant sends it: ``volts`` (n · inputs,), input after input."""
        self._blocks.put(self._block(sequence, time, sample_period, inputs, volts))

    def _block(
        self, sequence: int, time: float, sample_period: float, inputs: Sequence[str], volts: NDArray[np.float64]
    ) -> VoltBlock | AcquisitionError:
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
        """Forget what came before; the coil is at 0 V."""
        while not self._blocks.empty():
            self._blocks.get()
        self.send(0.0)

    def read(self) -> VoltBlock | None:
        """Next block fed, or None after a moment without one."""
        try:
            block = self._blocks.get(timeout=0.1)
        except queue.Empty:
            return None
        if isinstance(block, AcquisitionError):
            raise block
        return block

    def write(self, volts: float) -> None:
        """Give a coil voltage to the plant."""
        self.send(volts)

    def close(self) -> None:
        """Leave the coil at 0 V."""
        self.send(0.0)
