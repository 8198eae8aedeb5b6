"""Amplitude-modulated pseudo-random sequence."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Holds, Waveform, level_field


@dataclass(frozen=True)
class Aprbs(Waveform):
    """Hold random levels for random times (APRBS; Nelles, *Nonlinear System Identification*, 2001, §17.7).

    ``count`` levels are equally spaced from ``low`` to ``high``. In shuffled rounds, each is equally frequent.
    """

    low: float = level_field("lowest level")
    high: float = level_field("highest level")
    shortest: float = quantity(unit="s", doc="shortest hold", lower=1e-3, upper=3600)
    longest: float = quantity(unit="s", doc="longest hold", lower=1e-3, upper=3600)
    count: int = quantity(16, "", "number of different levels", lower=2, upper=1000)
    seed: int = quantity(0, "", "of levels and holds", lower=0)

    def __post_init__(self) -> None:
        if self.longest < self.shortest:
            raise InputError(f"longest_s {self.longest:g} is below shortest_s {self.shortest:g}")

    def shape(self, duration: float) -> Holds:
        if duration / self.shortest > 1e6:
            raise InputError("the sequence has more than a million holds; raise shortest_s")
        generator = np.random.default_rng(self.seed)
        number = int(np.ceil(duration / self.shortest)) + 1
        rounds = np.tile(np.arange(self.count), (-(-number // self.count), 1))
        steps = generator.permuted(rounds, axis=1).ravel()[:number]
        holds = generator.uniform(self.shortest, self.longest, number)
        times = np.cumsum(holds) - holds
        inside = times < duration
        return Holds(times[inside], (self.low + (self.high - self.low) * steps / (self.count - 1))[inside])
