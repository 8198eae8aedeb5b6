"""Homing: set the origin of the motor's encoder, which counts from its switch-on, by the LVDT, which knows mid-stroke.

An unplugged LVDT reads mid-stroke wherever the rod stands. It is therefore believed only once it has followed the motor.
"""

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
# Travel in m over which the LVDT must have followed the motor before it is believed.
LEAST_TRAVEL = 2e-3
# Longest delay in s of the samples behind the rod, through filters and transport.
_MAX_SAMPLE_DELAY = 0.3
# Time in s within which the motor must report the new origin and the travel limits.
_ORIGIN_TIMEOUT = 0.5
# Time in s that the drive and the filters of the samples need to settle after the move.
_SETTLING_TIME = 0.1
# Time in s after the planned end of a move within which the rod must stand there.
_ARRIVAL_TIMEOUT = 1.0
# Shortest duration in s of a move.
_MIN_MOVE_TIME = 0.3


class Phase(Enum):
    """Phase of the homing."""

    MEASURE = "averaging the LVDT"
    ORIGIN = "setting the origin"
    MOVE = "moving to one side or to mid-stroke"
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
    """Move along a polynomial of fifth degree in time, at rest at both ends.

    Parameters
    ----------
    begin : float
        Bench time in s at which the move begins.
    start : float
        Position in m at which it begins.
    end : float
        Position in m at which it ends.
    speed : float
        Greatest speed in m/s.
    """

    begin: float
    start: float
    end: float
    speed: float

    @property
    def duration(self) -> float:
        """Time in s to the end. The peak speed of the polynomial is 15/8 of its mean speed."""
        return max(_MIN_MOVE_TIME, 1.875 * abs(self.end - self.start) / self.speed)

    def at(self, time: float) -> RodSetpoint:
        """Return the setpoint at a bench time."""
        s = min(1.0, max(0.0, (time - self.begin) / self.duration))
        travel = self.end - self.start
        position = self.start + travel * s**3 * (10 - 15 * s + 6 * s**2)
        velocity = travel * 30 * s**2 * (1 - s) ** 2 / self.duration
        acceleration = travel * 60 * s * (1 - s) * (1 - 2 * s) / self.duration**2
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
        Greatest speed in m/s of its moves.
    tolerance : float
        Largest accepted difference in m between encoder and LVDT after a move, at most half of its travel.
    least_travel : float
        Travel in m over which the LVDT must have followed the motor; a rod nearer to mid-stroke first goes so far aside.
    """

    def __init__(self, now: float, position: float, speed: float, tolerance: float, least_travel: float) -> None:
        self.phase = Phase.MEASURE
        self.origin = float("nan")
        self.move = QuinticMove(now, 0.0, 0.0, speed)
        self._speed, self._tolerance, self._least_travel = speed, tolerance, least_travel
        # Back to where the encoder counts from: there is room where the rod was homed before, and attempts with a dead LVDT,
        # each of which takes the place where it begins for mid-stroke, go to and fro instead of on to the end of the stroke.
        self._aside = -least_travel if position >= 0.0 else least_travel
        self._average = RestAverage(now, position)
        self._phase_begin = now

    def add_samples(
        self, time: float, period: float, lvdt: npt.NDArray[np.float64] | Sequence[float], position: float
    ) -> None:
        """Add a block of LVDT samples in m. While the rod moves, they must agree with the encoder's ``position``."""
        if self.phase in (Phase.MEASURE, Phase.CHECK):
            self._average.add(time, period, lvdt)
        elif self.phase is Phase.MOVE and time >= self._phase_begin and len(lvdt):
            self._compare(float(np.mean(lvdt)), position, self._tolerance + self._speed * _MAX_SAMPLE_DELAY)

    def measured_position(self, now: float, position: float) -> float | None:
        """Return the position in m by the LVDT once its average is complete; the phase then becomes ORIGIN."""
        if self.phase is not Phase.MEASURE:
            return None
        mean = self._average.mean(now, position)
        if mean is not None:
            self.origin, self.phase, self._phase_begin = mean, Phase.ORIGIN, now
            # With a wider tolerance, an LVDT that stands still would pass.
            self._tolerance = min(self._tolerance, max(abs(mean), self._least_travel) / 2)
        return mean

    def confirm_origin(self, now: float, position: float, confirmed: bool) -> None:
        """Begin the move to mid-stroke, or first to one side, once the motor has ``confirmed`` the new origin.

        Raises
        ------
        HomingError
            If the confirmation does not come in time.
        """
        if confirmed:
            self._move(now, position, 0.0 if abs(self.origin) >= self._least_travel else self.origin + self._aside)
        elif now - self._phase_begin > _ORIGIN_TIMEOUT:
            raise HomingError("the motor did not take the origin and the travel limits; check the line and home again")

    def _move(self, now: float, position: float, end: float) -> None:
        self.phase, self._phase_begin = Phase.MOVE, now
        self.move = QuinticMove(now, position, end, self._speed)

    def arrived(self, now: float, position: float, standing: bool) -> bool:
        """Return whether the rod has arrived at the end of its move; the phase then becomes CHECK."""
        if self.phase is not Phase.MOVE or now < self.move.begin + self.move.duration:
            return False
        if standing and abs(position - self.move.end) < REST_TOLERANCE:
            self.phase, self._average = Phase.CHECK, RestAverage(now + _SETTLING_TIME, position)
            return True
        if now > self.move.begin + self.move.duration + _ARRIVAL_TIMEOUT:
            raise HomingError(
                f"the rod did not reach {1e3 * self.move.end:.2f} mm, it stands at {1e3 * position:.2f} mm by the encoder; "
                "check whether it is jammed"
            )
        return False

    def complete(self, now: float, position: float) -> bool:
        """Return whether encoder and LVDT agree at mid-stroke, so that the rod is homed.

        Where they agree to one side of it, the rod goes on to mid-stroke.
        """
        if self.phase is not Phase.CHECK:
            return False
        mean = self._average.mean(now, position)
        if mean is None:
            return False
        self._compare(mean, position, self._tolerance)
        if self.move.end != 0.0:
            self._move(now, position, 0.0)
            return False
        return True

    def _compare(self, lvdt: float, position: float, limit: float) -> None:
        difference = lvdt - position
        if abs(difference) > limit:
            raise HomingError(
                f"LVDT and encoder disagree by {1e3 * difference:.2f} mm, limit ±{1e3 * limit:.3g} mm; the rod has moved by "
                f"{1e3 * (position - self.origin):.2f} mm by the encoder, by {1e3 * (lvdt - self.origin):.2f} mm by the "
                "LVDT; look for an unplugged or stuck LVDT or a slipping pinion, and check sign and calibration of the "
                "LVDT, the direction of the motor (drive.reversed), the gear ratio and the coupling"
            )
