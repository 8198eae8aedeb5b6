"""Triangles of several slopes one after the other, for several constant speeds in one run."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Corners, Waveform, level_field, repeat_pattern


@dataclass(frozen=True)
class Ladder(Waveform):
    """Follow whole triangles around ``offset`` for ``hold`` at each slope; after the last slope, start again.

    At each slope, the time is divided into as few triangles as ``amplitude`` allows. A slow slope therefore travels less.
    """

    slopes: tuple[float, ...] = quantity(
        unit="level/s", doc="steepness of the lines, in their order in time", lower=1e-7, upper=1e3
    )
    amplitude: float = level_field("largest half of peak to peak", lower=1e-6)
    hold: float = quantity(unit="s", doc="time at each slope", lower=1e-3, upper=3600)
    offset: float = level_field("mean", 0.0)

    def shape(self, duration: float) -> Corners:
        slopes = np.array(self.slopes)
        cycles = np.maximum(np.ceil(slopes * self.hold / (4 * self.amplitude) - 1e-9), 1).astype(int)
        if cycles.sum() * max(duration / (len(slopes) * self.hold), 1) > 3e5:
            raise InputError("the ladder has more than a million corners; raise its amplitude or reduce its slopes")
        quarters = np.repeat(self.hold / (4 * cycles), cycles)
        steps = quarters[:, None] * [1.0, 2.0, 1.0]
        starts = np.cumsum(steps) - steps.ravel()
        levels = np.repeat(slopes, cycles)[:, None] * quarters[:, None] * [0.0, 1.0, -1.0]
        return Corners(*repeat_pattern(starts, self.offset + levels.ravel(), len(slopes) * self.hold, duration))
