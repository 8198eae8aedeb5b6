"""A sine, the waveform of most published damper tests."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_trajectory.waveforms.waveform import Array, Smooth, Waveform, level_field


@dataclass(frozen=True)
class Sine(Waveform):
    """Follow ``offset + amplitude sin(2π frequency t)``."""

    amplitude: float = level_field("half of peak to peak", lower=0)
    frequency: float = quantity(unit="Hz", doc="of the sine", lower=1e-3, upper=100)
    offset: float = level_field("mean", 0.0)

    def shape(self, duration: float) -> Smooth:
        rate = 2 * np.pi * self.frequency

        def motion(time: Array) -> tuple[Array, Array, Array]:
            sine, cosine = self.amplitude * np.sin(rate * time), self.amplitude * np.cos(rate * time)
            return self.offset + sine, rate * cosine, -(rate**2) * sine

        return Smooth(motion, self.frequency)
