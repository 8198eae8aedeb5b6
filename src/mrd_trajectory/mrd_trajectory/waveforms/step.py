"""A step."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_trajectory.waveforms.waveform import Holds, Waveform, level_field


@dataclass(frozen=True)
class Step(Waveform):
    """Hold ``start`` until ``delay``, then ``end``."""

    start: float = level_field("before the step")
    end: float = level_field("after the step")
    delay: float = quantity(unit="s", doc="time of the step", lower=1e-3, upper=3600)

    def shape(self, duration: float) -> Holds:
        return Holds(np.array([0.0, self.delay]), np.array([self.start, self.end]))
