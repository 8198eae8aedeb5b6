"""A ramp between two levels, for quasi-static tests."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Corners, Waveform, level_field, slope_field


@dataclass(frozen=True)
class Ramp(Waveform):
    """Hold ``start`` for ``dwell``, go to ``end`` at a constant slope, and hold it."""

    start: float = level_field("held first")
    end: float = level_field("held last")
    slope: float = slope_field("steepness of the ramp")
    dwell: float = quantity(0.0, "s", "time at the start level", lower=0, upper=3600)

    def shape(self, duration: float) -> Corners:
        arrival = self.dwell + abs(self.end - self.start) / self.slope
        if arrival > duration * (1 + 1e-9):
            raise InputError(f"the ramp ends at {arrival:.4g} s, after duration_s {duration:g}; raise duration_s")
        return Corners(
            np.array([0.0, self.dwell, arrival, max(duration, arrival)]),
            np.array([self.start, self.start, self.end, self.end]),
        )
