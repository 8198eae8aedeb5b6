"""A level that does not change."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_trajectory.waveforms.waveform import Holds, Waveform


@dataclass(frozen=True)
class Constant(Waveform):
    """One level throughout."""

    level: float = quantity(0.0, "level", "held throughout")

    def shape(self, duration: float) -> Holds:
        return Holds(np.zeros(1), np.array([self.level]))
