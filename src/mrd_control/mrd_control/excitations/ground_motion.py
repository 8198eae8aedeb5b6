"""The acceleration of the ground in an earthquake, recorded or random."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from scipy.signal import cont2discrete, lfilter

from mrd_base import quantity
from mrd_control.excitations.excitation import (
    Array,
    Excitation,
    check_length,
    csv_field,
    csv_text,
    motion_of_acceleration,
    read_columns,
    resolve_file,
    seed_field,
)

COLUMNS = ("time_s", "acceleration_mps2")
SETTLING = 10.0
"""s before the record, over which the filters settle."""


@dataclass(frozen=True)
class GroundMotion(Excitation):
    """A recorded accelerogram, or filtered noise (Kanai, 1957; Tajimi, 1960) that rises, lasts and decays."""

    file: str = quantity("", "", f"CSV file with the header {','.join(COLUMNS)}; empty: random")
    scale: float = quantity(1.0, "", "factor on the recorded acceleration", lower=-1e3, upper=1e3)
    peak: float = quantity(1.5, "m/s2", "largest random acceleration", lower=0, upper=50)
    ground_frequency: float = quantity(2.5, "Hz", "natural frequency of the ground, of random motion", lower=0.1, upper=25)
    ground_damping: float = quantity(0.6, "", "its damping ratio", lower=0.01, upper=2)
    strong: float = quantity(8.0, "s", "duration of the strong part, of random motion", lower=0.1, upper=600)
    lowest_frequency: float = quantity(0.1, "Hz", "below which the ground does not move", lower=1e-3, upper=10)
    seed: int = seed_field()
    csv: str = csv_field()

    def resolved(self, folder: Path | None) -> Self:
        return replace(self, file=resolve_file(self.file, folder)) if self.file and not self.csv else self

    def complete(self) -> Self:
        if not self.file and not self.csv:
            return self
        return replace(self, csv=csv_text(*read_columns(self.file, self.csv, COLUMNS)))

    def base(self, samples: int, rate: float) -> Array:
        time = np.arange(samples) / rate
        acceleration = self._recorded(time) if self.file or self.csv else self._random(time, rate)
        return motion_of_acceleration(acceleration, rate, self.lowest_frequency)

    def _recorded(self, time: Array) -> Array:
        _, instants, acceleration = read_columns(self.file, self.csv, COLUMNS)
        check_length(float(instants[-1]), float(time[-1]), "s", self.file)
        return np.asarray(self.scale * np.interp(time, instants, acceleration), np.float64)

    def _random(self, time: Array, rate: float) -> Array:
        settling = int(SETTLING * rate)
        noise = np.random.default_rng(self.seed).standard_normal(settling + len(time))
        w, damping = 2.0 * math.pi * self.ground_frequency, 2.0 * self.ground_damping
        numerator, denominator, _ = cont2discrete(([damping * w, w * w], [1.0, damping * w, w * w]), 1.0 / rate, "zoh")
        stationary = lfilter(numerator.ravel(), denominator, noise)[settling:]
        # Envelope of Jennings, Housner & Tsai (1968): a parabola, one, an exponential.
        rise = 0.25 * self.strong
        envelope = np.minimum((time / rise) ** 2, 1.0) * np.exp(-np.maximum(time - rise - self.strong, 0.0) / rise)
        acceleration = stationary * envelope
        largest = float(np.abs(acceleration).max())
        return np.asarray(acceleration * (self.peak / largest if largest > 0.0 else 0.0), np.float64)
