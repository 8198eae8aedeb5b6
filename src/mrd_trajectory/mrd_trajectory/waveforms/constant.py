"""A level that does not change."""

from dataclasses import dataclass

import numpy as np

from mrd_trajectory.waveforms.waveform import Holds, Waveform, level_field


@dataclass(frozen=True)
class Constant(Waveform):
    """Hold one level."""

    level: float = level_field("held for the whole time", 0.0)

    def shape(self, duration: float) -> Holds:
        return Holds(np.zeros(1), np.array([self.level]))
