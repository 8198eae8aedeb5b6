"""Rest: whether rod and coil stand still, by the blocks of samples and the states of the servo that a recorder hears."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from mrd_runs.blocks import Blocks

# Time in s over which the speed of the rod is measured. Within it, the mains hum cancels, and noise of 10 µm rms at 1 kHz
# makes less than 0.2 mm/s.
_SPEED_INTERVAL = 0.02


@dataclass(frozen=True)
class RestLimits:
    """Speed of the rod in m/s and current in A below which rod and coil are at rest, and how long they must be, in s."""

    speed: float = 2e-3
    current: float = 0.05
    duration: float = 0.5


@dataclass
class RestMonitor:
    """Follows how long rod and coil have been at rest, by the stamps of what was added, in bench time.

    Attributes
    ----------
    limits : RestLimits
    speed, current : float
        Latest speed of the rod in m/s and current in A.
    """

    limits: RestLimits
    speed: float = 0.0
    current: float = 0.0
    _rest_began: float | None = None
    _latest: float = 0.0
    # Time in s and mean position in m of the latest blocks.
    _positions: deque[tuple[float, float]] = field(default_factory=deque)

    def add_samples(self, blocks: Blocks) -> None:
        """Add blocks of samples, in their order."""
        ends = np.cumsum(blocks.count)
        for stamp, period, count, end in zip(1e-9 * blocks.stamp, blocks.period, blocks.count, ends, strict=True):
            if count == 0:
                continue
            part = slice(end - count, end)
            middle = stamp + (count - 1) / 2 * period
            self._positions.append((middle, float(blocks.series["position"][part].mean())))
            self.current = abs(float(blocks.series["coil_current"][part].mean()))
            self._measure_speed()
            self._add(float(stamp), float(stamp + count * period))

    def add_speed(self, time: float, speed: float) -> None:
        """Add a speed of the rod in m/s that the servo measured at a time in s."""
        # The samples tell that the rod rests, and how long; the servo can only object.
        if not abs(speed) < self.limits.speed:
            self.speed, self._rest_began = abs(speed), None

    @property
    def rested(self) -> bool:
        """Whether rod and coil have been at rest for long enough."""
        return self._rest_began is not None and self._latest - self._rest_began >= self.limits.duration

    def describe(self) -> str:
        """Return the latest motion and current, for a message."""
        return f"{1e3 * self.speed:.1f} mm/s, {self.current:.2f} A"

    def _measure_speed(self) -> None:
        time, position = self._positions[-1]
        while len(self._positions) > 2 and time - self._positions[1][0] >= _SPEED_INTERVAL - 1e-9:
            self._positions.popleft()
        elapsed = time - self._positions[0][0]
        if elapsed > 0:
            self.speed = abs(position - self._positions[0][1]) / elapsed

    def _add(self, begin: float, end: float) -> None:
        # A value that is not a number is no rest.
        if not (len(self._positions) > 1 and self.speed < self.limits.speed and self.current < self.limits.current):
            self._rest_began = None
        elif self._rest_began is None:
            self._rest_began = begin
        self._latest = end
