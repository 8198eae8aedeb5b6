"""A sine whose frequency rises over the run."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_control.excitations.excitation import Array, Excitation
from mrd_trajectory.waveforms.chirp import Chirp


@dataclass(frozen=True)
class SineSweep(Excitation):
    """The chirp of the trajectories, over the whole run."""

    amplitude: float = quantity(0.005, "mm", "of the first cycle", lower=0, upper=1)
    start: float = quantity(0.5, "Hz", "first frequency", lower=1e-3, upper=100)
    end: float = quantity(20.0, "Hz", "last frequency", lower=1e-3, upper=100)
    constant_speed: bool = quantity(True, "", "keep amplitude × frequency instead of the amplitude")

    def base(self, samples: int, rate: float) -> Array:
        chirp = Chirp(self.amplitude, self.start, self.end, self.constant_speed).shape(samples / rate)
        position, velocity, _ = chirp.motion(np.arange(samples) / rate)
        return np.stack([position, velocity], axis=1)
