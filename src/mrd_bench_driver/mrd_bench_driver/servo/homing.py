"""Homing: set the origin of the motor's encoder, which counts from its switch-on, by the LVDT, which knows mid-stroke."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from mrd_bench_driver.servo.streaming import RodSetpoint

# Time in s over which the LVDT is averaged at rest; it holds several periods of mains hum.
AVERAGING_TIME = 0.2
# Longest wait in s for such an average.
AVERAGING_TIMEOUT = 2.0
# Travel in m beyond which the rod counts as moving while the LVDT is averaged; noise of the LVDT's block means is less.
REST_TOLERANCE = 2e-4
# Longest delay in s of the samples behind the rod, through filters and transport.
_MAX_SAMPLE_DELAY = 0.3
# Time in s within which the motor must report the new origin and the travel limits.
_ORIGIN_TIMEOUT = 0.5
# Time in s that the drive and the filters of the samples need to settle after the move.
_SETTLING_TIME = 0.1
# Time in s after the planned end of the move within which the rod must stand at mid-stroke.
_ARRIVAL_TIMEOUT = 1.0
# Shortest duration in s of the move to mid-stroke.
_MIN_MOVE_TIME = 0.3


class Phase(Enum):
    """Phase of the homing."""

    MEASURE = "averaging the LVDT"
    ORIGIN = "setting the origin"
    MOVE = "moving to mid-stroke"
    CHECK = "comparing encoder and LVDT"


class HomingError(Exception):
    """Homing failed; the message says why and what to do."""


class RestAverage:
    """Mean of the LVDT over `AVERAGING_TIME` seconds in which the rod stands.

    Parameters
    ----------
    start : float
        Bench time in s; earlier samples are ignored.
    position : float
        Position of the rod in m by the encoder at the start.
    """

    def __init__(self, start: float, position: float) -> None:
        self._start, self._position = start, position
        self._first = self._last = float("nan")
        self._means: list[float] = []
        self._sum, self._count = 0.0, 0

    def add(self, time: float, period: float, position: npt.NDArray[np.float64] | Sequence[float]) -> None:
        """Add a block of samples: bench time of the first, sample period in s, positions in m."""
        values = np.asarray(position, dtype=np.float64)
        times = time + period * np.arange(values.size)
        valid = (times >= self._start) & np.isfinite(values)
        if not valid.any():
            return
        self._first = float(times[valid][0]) if not self._count else self._first
        self._last = float(times[valid][-1])
        self._means.append(float(values[valid].mean()))
        self._sum += float(values[valid].sum())
        self._count += int(valid.sum())

    def mean(self, now: float, position: float) -> float | None:
        """Return the mean position in m by the LVDT, or None while samples are missing.

        Raises
        ------
        HomingError
            If the rod moves or the samples do not come.
        """
        spread = max(self._means) - min(self._means) if self._means else 0.0
        if abs(position - self._position) > REST_TOLERANCE or spread > REST_TOLERANCE:
            raise HomingError("the rod moves while its rest position is measured; wait until it stands and home again")
        if self._count >= 3 and self._last - self._first >= AVERAGING_TIME:
            return self._sum / self._count
        if now - self._start > AVERAGING_TIMEOUT:
            raise HomingError(
                f"too few fresh position samples on the topic samples: {self._count} came, {AVERAGING_TIME:g} s of them are "
                "needed; check that the daq runs"
            )
        return None


@dataclass(frozen=True)
class QuinticMove:
    """Move to mid-stroke along a polynomial of fifth degree in time, at rest at both ends.

    Parameters
    ----------
    begin : float
        Bench time in s at which the move begins.
    start : float
        Position in m at which it begins.
    speed : float
        Greatest speed in m/s.
    """

    begin: float
    start: float
    speed: float

    @property
    def duration(self) -> float:
        """Time in s to mid-stroke. The peak speed of the polynomial is 15/8 of its mean speed."""
        return max(_MIN_MOVE_TIME, 1.875 * abs(self.start) / self.speed)

    def at(self, time: float) -> RodSetpoint:
        """Return the setpoint at a bench time."""
        s = min(1.0, max(0.0, (time - self.begin) / self.duration))
        position = self.start * (1 - s**3 * (10 - 15 * s + 6 * s**2))
        velocity = -self.start * 30 * s**2 * (1 - s) ** 2 / self.duration
        acceleration = -self.start * 60 * s * (1 - s) * (1 - 2 * s) / self.duration**2
        return RodSetpoint(time, position, velocity, acceleration)


class Homing:
    """One homing, phase by phase. It decides what comes next; the servo sends the commands.

    Parameters
    ----------
    now : float
        Bench time in s.
    position : float
        Position of the rod in m by the encoder, whatever its origin.
    speed : float
        Greatest speed in m/s of the move to mid-stroke.
    tolerance : float
        Largest accepted difference in m between encoder and LVDT at the end.
    """

    def __init__(self, now: float, position: float, speed: float, tolerance: float) -> None:
        self.phase = Phase.MEASURE
        self.origin = float("nan")
        self.move = QuinticMove(now, 0.0, speed)
        self._speed, self._tolerance = speed, tolerance
        self._average = RestAverage(now, position)
        self._phase_begin = now

    def add_samples(
        self, time: float, period: float, lvdt: npt.NDArray[np.float64] | Sequence[float], position: float
    ) -> None:
        """Add a block of LVDT samples in m. While the rod moves, they must agree with the encoder's ``position``."""
        if self.phase in (Phase.MEASURE, Phase.CHECK):
            self._average.add(time, period, lvdt)
        elif self.phase is Phase.MOVE and time >= self._phase_begin and len(lvdt):
            difference = float(np.mean(lvdt)) - position
            if abs(difference) > self._tolerance + self._speed * _MAX_SAMPLE_DELAY:
                raise HomingError(self._disagreement(difference))

    def measured_position(self, now: float, position: float) -> float | None:
        """Return the position in m by the LVDT once its average is complete; the phase then becomes ORIGIN."""
        if self.phase is not Phase.MEASURE:
            return None
        mean = self._average.mean(now, position)
        if mean is not None:
            self.origin, self.phase, self._phase_begin = mean, Phase.ORIGIN, now
        return mean

    def confirm_origin(self, now: float, position: float, confirmed: bool) -> None:
        """Begin the move to mid-stroke once the motor has ``confirmed`` the new origin.

        Raises
        ------
        HomingError
            If the confirmation does not come in time.
        """
        if confirmed:
            self.phase, self._phase_begin = Phase.MOVE, now
            self.move = QuinticMove(now, position, self._speed)
        elif now - self._phase_begin > _ORIGIN_TIMEOUT:
            raise HomingError("the motor did not take the origin and the travel limits; check the line and home again")

    def arrived(self, now: float, position: float, standing: bool) -> bool:
        """Return whether the rod has arrived at mid-stroke; the phase then becomes CHECK."""
        if self.phase is not Phase.MOVE or now < self.move.begin + self.move.duration:
            return False
        if standing and abs(position) < REST_TOLERANCE:
            self.phase, self._average = Phase.CHECK, RestAverage(now + _SETTLING_TIME, position)
            return True
        if now > self.move.begin + self.move.duration + _ARRIVAL_TIMEOUT:
            raise HomingError(
                f"the rod did not reach mid-stroke, it stands at {1e3 * position:.2f} mm; check whether it is jammed"
            )
        return False

    def complete(self, now: float, position: float) -> bool:
        """Return whether encoder and LVDT agree at mid-stroke, so that the rod is homed."""
        if self.phase is not Phase.CHECK:
            return False
        mean = self._average.mean(now, position)
        if mean is None:
            return False
        if abs(mean - position) > self._tolerance:
            raise HomingError(self._disagreement(mean - position))
        return True

    def _disagreement(self, difference: float) -> str:
        return (
            f"LVDT and encoder disagree by {1e3 * difference:.2f} mm after homing's move (limit "
            f"{1e3 * self._tolerance:g} mm); check sign and calibration of the LVDT, the direction of the motor "
            "(drive.reversed), the gear ratio and the coupling"
        )
