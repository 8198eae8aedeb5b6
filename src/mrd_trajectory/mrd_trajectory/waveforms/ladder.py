"""Triangles of several slopes one after the other: constant speeds from slow to fast in one run."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Corners, Waveform, level_field, repeat_pattern


@dataclass(frozen=True)
class Ladder(Waveform):
    """Whole triangles about ``offset``, for ``hold`` at each slope in turn, from the first again after the last.

    At each slope as few triangles as fit into ``amplitude`` share the time, so that a slow rung travels less.
    """

    slopes: tuple[float, ...] = quantity(
        unit="level/s", doc="steepness of the lines, in the order of their turns", lower=1e-7, upper=1e3
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
