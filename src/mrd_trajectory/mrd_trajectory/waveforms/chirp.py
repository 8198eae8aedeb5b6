"""A sine whose frequency rises or falls exponentially."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_trajectory.waveforms.waveform import Array, Smooth, Waveform, level_field


@dataclass(frozen=True)
class Chirp(Waveform):
    """Sweep the frequency exponentially from ``start`` to ``end`` in one pass.

    With ``constant_speed`` the amplitude falls as the frequency rises, so that the peak rate stays the same.
    """

    amplitude: float = level_field("half of peak to peak; with constant_speed: at the start", lower=0)
    start: float = quantity(unit="Hz", doc="first frequency", lower=1e-3, upper=100)
    end: float = quantity(unit="Hz", doc="last frequency", lower=1e-3, upper=100)
    constant_speed: bool = quantity(False, "", "keep amplitude × frequency instead of the amplitude")
    offset: float = level_field("mean", 0.0)

    def shape(self, duration: float) -> Smooth:
        growth = np.log(self.end / self.start) / duration
        decay = growth if self.constant_speed else 0.0

        def motion(time: Array) -> tuple[Array, Array, Array]:
            # Level = offset + a sin φ with φ' = 2π f(t), where f and a are exponential.
            rate = 2 * np.pi * self.start * np.exp(growth * time)
            phase = 2 * np.pi * self.start * (np.expm1(growth * time) / growth if growth else time)
            amplitude = self.amplitude * np.exp(-decay * time)
            sine, cosine = amplitude * np.sin(phase), amplitude * np.cos(phase)
            return (
                self.offset + sine,
                rate * cosine - decay * sine,
                (decay**2 - rate**2) * sine + (growth - 2 * decay) * rate * cosine,
            )

        return Smooth(motion, max(self.start, self.end))
