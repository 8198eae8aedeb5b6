"""A triangle, for constant speeds in both directions."""

from dataclasses import dataclass

from mrd_base import InputError
from mrd_trajectory.waveforms.waveform import Corners, Waveform, level_field, repeat_pattern, slope_field


@dataclass(frozen=True)
class Triangle(Waveform):
    """Go between ``offset ± amplitude`` at a constant slope, starting upwards from ``offset``."""

    amplitude: float = level_field("half of peak to peak", lower=1e-6)
    slope: float = slope_field("steepness of the lines")
    offset: float = level_field("mean", 0.0)

    def shape(self, duration: float) -> Corners:
        quarter = self.amplitude / self.slope
        if duration / quarter > 1e6:
            raise InputError("the triangle has more than a million corners; raise its amplitude or reduce its slope")
        times, levels = repeat_pattern([0.0, quarter, 3 * quarter], [0.0, 1.0, -1.0], 4 * quarter, duration)
        return Corners(times, self.offset + self.amplitude * levels)
