"""A random road of an ISO 8608 class."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from mrd_base import InputError, quantity
from mrd_control.excitations.excitation import Array, Excitation, seed_field, speed_field

REFERENCE_FREQUENCY = 0.1
"""Cycles/m at which the standard gives the roughness, n0."""
CLASSES = {name: 16e-6 * 4**index for index, name in enumerate("ABCDEFGH")}
"""Geometric mean of the displacement density G_d(n0) in m³ of each class: ISO 8608 (2016), table C.1."""


@dataclass(frozen=True)
class Road(Excitation):
    """White velocity noise by ISO 8608: G_d(n) = G_d(n0) (n / n0)^-2.

    z' = 2 pi n0 sqrt(G_d(n0) v) w - 2 pi n_c v z, where w has the one-sided density one, that is the variance f_s / 2.
    """

    road_class: str = quantity("B", "", f"roughness, one of {', '.join(CLASSES)}")
    speed: float = speed_field()
    lowest_frequency: float = quantity(0.01, "", "cycles/m, below which the road is flat; 0: nowhere", lower=0, upper=1)
    seed: int = seed_field()

    def __post_init__(self) -> None:
        if self.road_class not in CLASSES:
            raise InputError(f"road_class is {self.road_class!r}, expected one of {', '.join(CLASSES)}")

    @property
    def velocity_psd(self) -> float:
        """One-sided density of the vertical velocity in (m/s)²/Hz, above the lowest frequency."""
        return float((2.0 * math.pi * REFERENCE_FREQUENCY) ** 2 * CLASSES[self.road_class] * self.speed)

    def base(self, samples: int, rate: float) -> Array:
        noise = np.random.default_rng(self.seed).standard_normal(samples) * math.sqrt(0.5 * self.velocity_psd * rate)
        decay = 2.0 * math.pi * self.lowest_frequency * self.speed
        left = math.exp(-decay / rate)
        held = -math.expm1(-decay / rate) / decay if decay else 1.0 / rate
        position = lfilter([0.0, held], [1.0, -left], noise)
        return np.stack([position, noise - decay * position], axis=1)
