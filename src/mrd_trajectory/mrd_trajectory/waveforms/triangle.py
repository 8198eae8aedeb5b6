"""A triangle: constant speed to and fro."""

from dataclasses import dataclass

from mrd_base import InputError, quantity
from mrd_trajectory.waveforms.waveform import Corners, Waveform, repeated


@dataclass(frozen=True)
class Triangle(Waveform):
    """Straight lines between ``offset ± amplitude`` at one slope, starting upwards from ``offset``."""

    amplitude: float = quantity(unit="level", doc="half of peak to peak", lower=0)
    slope: float = quantity(unit="level/s", doc="steepness of the lines", lower=0)
    offset: float = quantity(0.0, "level", "mean")

    def __post_init__(self) -> None:
        if self.amplitude == 0 or self.slope == 0:
            raise InputError("amplitude and slope of a triangle must be > 0; use the waveform constant for a rest")

    def shape(self, duration: float) -> Corners:
        quarter = self.amplitude / self.slope
        if duration / quarter > 1e6:
            raise InputError("the triangle has more than a million corners; raise its amplitude or reduce its slope")
        times, levels = repeated([0.0, quarter, 3 * quarter], [0.0, 1.0, -1.0], 4 * quarter, duration)
        return Corners(times, self.offset + self.amplitude * levels)
