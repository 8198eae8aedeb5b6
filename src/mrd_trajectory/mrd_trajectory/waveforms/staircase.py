"""A sequence of levels."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Holds, Waveform, level_field, repeat_pattern


@dataclass(frozen=True)
class Staircase(Waveform):
    """Hold each level for ``hold``; after the last level, start again."""

    levels: tuple[float, ...] = level_field("in their order in time")
    hold: float = quantity(unit="s", doc="time at each level", lower=1e-3, upper=3600)

    def shape(self, duration: float) -> Holds:
        if duration / self.hold > 1e6:
            raise InputError("the staircase has more than a million steps; raise hold_s")
        count = len(self.levels)
        return Holds(*repeat_pattern(np.arange(count) * self.hold, self.levels, count * self.hold, duration))
