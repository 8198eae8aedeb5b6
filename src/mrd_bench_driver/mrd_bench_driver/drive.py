"""How a stream of setpoints becomes motion commands that end by themselves.

Class 5 has no time-stamped streaming over RS-232, so every tick sends a position target a short way ahead, with the speed
and the acceleration that reach it when the setpoint does. The motor plans a trapezoid to it: with a new target every tick
the rod never slows down for the old one; without, be it host or line that died, the rod comes to rest there.
"""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError
from mrd_bench_driver.smartmotor import POSITION, STATUS_0, Report, Units, motion
from mrd_trajectory.limits import Limits

# From the end of a question to the start of its answer, in s (Moog Class 5, published measurement at 9600 baud).
TURNAROUND = 0.0035
SLOWEST_BAUD = 9600
# Slower than this the rod counts as standing, in m/s.
STANDING = 1e-3
_LEAST_ACCELERATION = 0.1


@dataclass(frozen=True)
class Plan:
    """What one tick of streaming carries over the line.

    Attributes
    ----------
    rate : float
        Ticks per second.
    with_acceleration : bool
        Whether each tick sends ADT; a slow line keeps one set beforehand.
    spare : int
        Every ``spare``-th tick asks for another report than the position: beside it on a fast line, in its place on a
        slow one.
    """

    rate: float
    with_acceleration: bool
    spare: int


def plan(baud_rate: int, units: Units, limits: Limits, ceiling: float) -> Plan:
    """Fastest streaming that the line carries, from the bytes of the longest commands and replies.

    Raises
    ------
    InputError
        Below 9600 baud, where a tick would take longer than a stop may.
    """
    if baud_rate < SLOWEST_BAUD:
        raise InputError(f"baud_rate is {baud_rate}, expected at least {SLOWEST_BAUD} to stream setpoints")

    def exchange(report: Report) -> float:
        reply = max(len(str(units.counts(-limits.stroke / 2))), len(str(units.counts(limits.stroke / 2))))
        size = len(report.query) + 1 + (reply if report is POSITION else 5) + 1
        return 10 * size / baud_rate + TURNAROUND

    farthest = min(units.counts(limits.reach), units.counts(-limits.reach))
    speed, acceleration = units.vt(limits.speed), units.adt(limits.acceleration)
    whole = 10 * len(motion(farthest, speed, acceleration)) / baud_rate + exchange(POSITION) + exchange(STATUS_0) / 3
    if 1 / whole >= 25:
        return Plan(_round(1 / whole, ceiling), True, 3)
    slow = 10 * len(motion(farthest, speed, None)) / baud_rate + max(exchange(POSITION), exchange(STATUS_0))
    return Plan(_round(1 / slow, ceiling), False, 4)


def _round(rate: float, ceiling: float) -> float:
    return float(min(ceiling, 5 * max(1, rate // 5)))


@dataclass(frozen=True)
class Horizon:
    """How far ahead a command reaches: ``coast`` s at speed, then a stop, all over ``stop`` s after the command.

    Parameters
    ----------
    tick : float
        Time in s between two commands.
    least : float
        Wished time in s to the stop; a slow line needs three ticks.
    """

    tick: float
    least: float

    @property
    def stop(self) -> float:
        """Time in s from a command, the last one, to standstill."""
        return max(self.least, 3 * self.tick)

    @property
    def coast(self) -> float:
        """Time in s after a command before the rod slows down for its target: the next one may be half a tick late."""
        return max(self.stop / 4, 1.5 * self.tick)

    @property
    def ahead(self) -> float:
        """Travel to the target in s at the commanded speed: all of the coast and half of the slowing down."""
        return (self.stop + self.coast) / 2

    def hardest(self, speed: float) -> float:
        """Acceleration in m/s² that stops the rod in time from any speed up to ``speed`` m/s."""
        return speed / (self.stop - self.coast)


@dataclass(frozen=True)
class Setpoint:
    """Where the rod should be: position m, velocity m/s, acceleration m/s² at a bench time s."""

    time: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time: float) -> "Setpoint":
        """Setpoint at another time, carried on with constant acceleration."""
        dt = time - self.time
        return Setpoint(
            time,
            self.position + dt * (self.velocity + dt * self.acceleration / 2),
            self.velocity + dt * self.acceleration,
            self.acceleration,
        )


def refusal(setpoint: Setpoint, limits: Limits) -> str:
    """Why a setpoint cannot be obeyed whatever the rod does; "" when it can."""
    numbers = (setpoint.time, setpoint.position, setpoint.velocity, setpoint.acceleration)
    if not np.isfinite(numbers).all():
        return f"setpoint holds {numbers}, expected finite numbers"
    if abs(setpoint.position) > limits.reach * (1 + 1e-9):
        return (
            f"setpoint at {1e3 * setpoint.position:.2f} mm exceeds the reach of ±{1e3 * limits.reach:.2f} mm; "
            "reduce the amplitude or the offset"
        )
    if abs(setpoint.velocity) > limits.speed * (1 + 1e-9):
        return (
            f"setpoint at {1e3 * setpoint.velocity:.1f} mm/s exceeds the speed limit of {1e3 * limits.speed:.1f} mm/s; "
            "reduce the amplitude or the frequency"
        )
    return ""


@dataclass(frozen=True)
class Target:
    """One motion command, at the rod: it holds from ``time`` (bench s) on.

    ``position`` m is where the motion ends, ``velocity`` m/s (signed) what the rod reaches, at ``acceleration`` m/s²;
    ``start`` m/s is what it did before.
    """

    time: float
    position: float
    velocity: float
    acceleration: float
    start: float = 0.0

    def travel(self, begin: float, end: float) -> float:
        """Travel in m between two times after ``time``, if the rod follows and the target stays ahead."""
        return self._travelled(end) - self._travelled(begin)

    def _travelled(self, time: float) -> float:
        change = self.velocity - self.start
        ramp = abs(change) / self.acceleration
        elapsed = max(0.0, time - self.time)
        if elapsed >= ramp:
            return self.velocity * elapsed - change * ramp / 2
        return elapsed * (self.start + change * elapsed / ramp / 2)


def aim(
    desired: Setpoint, rod: float, before: float, horizon: Horizon, gain: float, limits: Limits, fixed: float | None = None
) -> Target:
    """Motion command for the next tick.

    Parameters
    ----------
    desired : Setpoint
        At the time at which the command takes effect.
    rod : float
        Position of the rod in m at that time.
    before : float
        Velocity in m/s that the previous command gave the rod.
    gain : float
        Speed in m/s added per metre of following error.
    limits : Limits
        The target is kept within their reach, the speed within theirs.
    fixed : float, optional
        Acceleration in m/s² that the motor was given beforehand; else it is chosen.

    Returns
    -------
    Target
        It ends ``horizon.ahead`` of travel beyond the setpoint, and the acceleration suffices both to take on the new
        speed within a tick and to stop within the horizon.
    """
    tick = horizon.tick
    # The motor ramps to the new speed, then holds it. Where the ramp fills the tick, the speed is the setpoint's at the
    # tick's end; where it is over at once, that at its middle: on average the rod goes as the setpoint does.
    ramp = fixed or max(abs(desired.acceleration), horizon.hardest(abs(desired.velocity)), _LEAST_ACCELERATION)
    share = min(1.0, abs(desired.acceleration) / ramp)
    velocity = desired.velocity + desired.acceleration * tick * (1 + share) / 2
    position = desired.position + velocity * horizon.ahead
    velocity += gain * (desired.position - rod)
    velocity = min(limits.speed, max(-limits.speed, velocity))
    acceleration = fixed or max(
        abs(velocity - before) / tick, horizon.hardest(max(abs(velocity), abs(before))), _LEAST_ACCELERATION
    )
    position = min(limits.reach, max(-limits.reach, position))
    return Target(desired.time, position, velocity, acceleration, before)
