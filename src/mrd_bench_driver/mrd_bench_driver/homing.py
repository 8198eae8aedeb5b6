"""Homing: the encoder counts from wherever it was switched on, the LVDT knows where mid-stroke is."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from mrd_bench_driver.drive import Setpoint

# Time in s over which the LVDT is averaged at rest, and how long to wait for such an average.
AVERAGING = 0.2
PATIENCE = 2.0
# Travel in m during the average beyond which the rod counts as moving.
REST = 2e-4
# Time in s that samples may lag behind the rod.
_LAG = 0.3


class Phase(Enum):
    """What homing is at."""

    MEASURE = "averaging the LVDT"
    ORIGIN = "setting the origin"
    MOVE = "moving to mid-stroke"
    CHECK = "comparing encoder and LVDT"


class HomingError(Exception):
    """Homing cannot go on; the line says why and what to do."""


class RestAverage:
    """Mean of the LVDT over `AVERAGING` seconds during which the rod stood.

    Parameters
    ----------
    start : float
        Bench time in s; older samples do not count.
    rod : float
        Position in m by the encoder at the start.
    """

    def __init__(self, start: float, rod: float) -> None:
        self._start, self._rod = start, rod
        self._first = self._last = float("nan")
        self._means: list[float] = []
        self._sum, self._count = 0.0, 0

    def add(self, time: float, period: float, position: npt.NDArray[np.float64] | Sequence[float]) -> None:
        """Take a block of samples: bench time of the first, sample period in s, positions in m."""
        values = np.asarray(position, dtype=np.float64)
        times = time + period * np.arange(values.size)
        fresh = (times >= self._start) & np.isfinite(values)
        if not fresh.any():
            return
        self._first = float(times[fresh][0]) if not self._count else self._first
        self._last = float(times[fresh][-1])
        self._means.append(float(values[fresh].mean()))
        self._sum += float(values[fresh].sum())
        self._count += int(fresh.sum())

    def result(self, now: float, rod: float) -> float | None:
        """Mean position in m, or None while samples are still missing.

        Raises
        ------
        HomingError
            When the rod moves or the samples do not come.
        """
        spread = max(self._means) - min(self._means) if self._means else 0.0
        if abs(rod - self._rod) > REST or spread > REST:
            raise HomingError("the rod moves while its rest position is measured; wait until it stands and home again")
        if self._count >= 3 and self._last - self._first >= AVERAGING:
            return self._sum / self._count
        if now - self._start > PATIENCE:
            raise HomingError(
                f"too few fresh position samples on the topic samples ({self._count} came, {AVERAGING:g} s of them are "
                "needed); is the daq running?"
            )
        return None


@dataclass(frozen=True)
class Approach:
    """Smooth way (quintic in time, at rest at both ends) from ``start`` m to mid-stroke.

    Parameters
    ----------
    begin : float
        Bench time in s.
    start : float
        Position in m.
    speed : float
        Greatest speed in m/s.
    """

    begin: float
    start: float
    speed: float

    @property
    def duration(self) -> float:
        """Time in s to mid-stroke; the quintic's peak speed is 15/8 of its mean."""
        return max(0.3, 1.875 * abs(self.start) / self.speed)

    def at(self, time: float) -> Setpoint:
        """Setpoint at a bench time."""
        s = min(1.0, max(0.0, (time - self.begin) / self.duration))
        position = self.start * (1 - s**3 * (10 - 15 * s + 6 * s**2))
        velocity = -self.start * 30 * s**2 * (1 - s) ** 2 / self.duration
        acceleration = -self.start * 60 * s * (1 - s) * (1 - 2 * s) / self.duration**2
        return Setpoint(time, position, velocity, acceleration)


class Homing:
    """The course of one homing; it decides, the servo commands.

    Parameters
    ----------
    now : float
        Bench time in s.
    rod : float
        Position in m by the encoder, whatever its origin.
    speed : float
        Greatest speed in m/s of the way to mid-stroke.
    tolerance : float
        Largest accepted difference in m between encoder and LVDT at the end.
    """

    def __init__(self, now: float, rod: float, speed: float, tolerance: float) -> None:
        self.phase = Phase.MEASURE
        self.origin = float("nan")
        self.approach = Approach(now, 0.0, speed)
        self._speed, self._tolerance = speed, tolerance
        self._average = RestAverage(now, rod)
        self._since = now

    def add(self, time: float, period: float, position: npt.NDArray[np.float64] | Sequence[float], rod: float) -> None:
        """Take a block of LVDT samples; while the rod moves, they must go where the encoder goes."""
        if self.phase in (Phase.MEASURE, Phase.CHECK):
            self._average.add(time, period, position)
        elif self.phase is Phase.MOVE and time >= self._since and len(position):
            difference = float(np.mean(position)) - rod
            if abs(difference) > self._tolerance + self._speed * _LAG:
                raise HomingError(self._disagreement(difference))

    def measured(self, now: float, rod: float) -> float | None:
        """Position in m by the LVDT, once the rest average stands; homing then sets the origin."""
        if self.phase is not Phase.MEASURE:
            return None
        mean = self._average.result(now, rod)
        if mean is not None:
            self.origin, self.phase, self._since = mean, Phase.ORIGIN, now
        return mean

    def origin_taken(self, now: float, rod: float, taken: bool) -> bool:
        """Tell whether the motor reports the new origin; homing then moves. Gives ``taken`` back."""
        if taken:
            self.phase, self._since = Phase.MOVE, now
            self.approach = Approach(now, rod, self._speed)
        elif now - self._since > 0.5:
            raise HomingError("the motor did not take the origin and the travel limits; check the line and home again")
        return taken

    def arrived(self, now: float, rod: float, standing: bool) -> bool:
        """Whether the move is over; homing then averages the LVDT again."""
        if self.phase is not Phase.MOVE or now < self.approach.begin + self.approach.duration:
            return False
        if standing and abs(rod) < REST:
            # The drive settles, the samples' filters too, before the average begins.
            self.phase, self._average = Phase.CHECK, RestAverage(now + 0.1, rod)
            return True
        if now > self.approach.begin + self.approach.duration + 1.0:
            raise HomingError(f"the rod did not reach mid-stroke, it stands at {1e3 * rod:.2f} mm; is it jammed?")
        return False

    def confirmed(self, now: float, rod: float) -> bool:
        """Whether encoder and LVDT agree at mid-stroke: the rod is homed."""
        if self.phase is not Phase.CHECK:
            return False
        mean = self._average.result(now, rod)
        if mean is None:
            return False
        if abs(mean - rod) > self._tolerance:
            raise HomingError(self._disagreement(mean - rod))
        return True

    def _disagreement(self, difference: float) -> str:
        return (
            f"LVDT and encoder disagree by {1e3 * difference:.2f} mm after homing's move (limit "
            f"{1e3 * self._tolerance:g} mm); check sign and calibration of the LVDT, the gear ratio and the coupling"
        )
