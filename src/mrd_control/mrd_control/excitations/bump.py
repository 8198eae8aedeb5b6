"""A single bump."""

import math
from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_control.excitations.excitation import Array, Excitation, speed_field


@dataclass(frozen=True)
class Bump(Excitation):
    """A bump of the form (1 - cos) / 2."""

    height: float = quantity(0.05, "mm", "of the bump; negative: a pothole", lower=-1, upper=1)
    length: float = quantity(5.0, "m", "of the bump", lower=0.01, upper=100)
    speed: float = speed_field()
    start: float = quantity(1.0, "s", "when the wheel reaches it", lower=0, upper=3600)

    def base(self, samples: int, rate: float) -> Array:
        phase = 2.0 * math.pi * self.speed / self.length * (np.arange(samples) / rate - self.start)
        on = (phase > 0.0) & (phase < 2.0 * math.pi)
        position = np.where(on, 0.5 * self.height * (1.0 - np.cos(phase)), 0.0)
        velocity = np.where(on, math.pi * self.height * self.speed / self.length * np.sin(phase), 0.0)
        return np.stack([position, velocity], axis=1)
