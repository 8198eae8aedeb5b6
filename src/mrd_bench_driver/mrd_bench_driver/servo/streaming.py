"""Turn a stream of setpoints into motion commands, each of which ends by itself.

A SmartMotor Class 5 accepts no time-stamped setpoints over RS-232. Every tick therefore sends a position target a short way
ahead of the setpoint, with a speed and an acceleration. The motor plans a trapezoidal velocity profile to this target. As
long as each tick brings a new target, the rod does not slow down for the previous one. If the host or the line fails, the
rod comes to rest at the last target.
"""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError
from mrd_bench_driver.servo.smartmotor import POSITION, STATUS_0, MotorUnits, Query, encode_move
from mrd_trajectory.limits import Limits

# Time in s from the end of a query to the start of its reply (Moog Class 5, published measurement at 9600 baud).
TURNAROUND = 0.0035
# Slowest line in bit/s that carries a target and a position query 25 times per second.
SLOWEST_BAUD_RATE = 9600
# Speed in m/s below which the rod counts as standing; noise of the position readings stays below it.
STANDSTILL_SPEED = 1e-3
# Least acceleration in m/s² of a command: with less, a rod at rest would hardly start.
_MIN_ACCELERATION = 0.1
# Rate in Hz that a line must reach with everything in each tick; a slower line uses the shorter schedule.
_MIN_FULL_RATE = 25


@dataclass(frozen=True)
class StreamingSchedule:
    """Rate and contents of the ticks that stream motion commands over the serial line.

    Attributes
    ----------
    rate : float
        Ticks per second.
    with_acceleration : bool
        Whether each tick sends the acceleration. On a slow line the motor keeps one that was set beforehand.
    status_interval : int
        Every ``status_interval``-th tick queries a status word, voltage or temperature: in addition to the position on a
        fast line, instead of it on a slow line.
    """

    rate: float
    with_acceleration: bool
    status_interval: int


def plan_streaming(baud_rate: int, units: MotorUnits, limits: Limits, max_rate: float) -> StreamingSchedule:
    """Return the fastest schedule that the line carries, from the bytes of the longest commands and replies.

    Raises
    ------
    InputError
        Below 9600 baud, where a tick would take longer than a stop may.
    """
    if baud_rate < SLOWEST_BAUD_RATE:
        raise InputError(f"baud_rate is {baud_rate}, expected at least {SLOWEST_BAUD_RATE} to stream setpoints")

    def query_time(query: Query) -> float:
        reply = max(len(str(units.counts(-limits.stroke / 2))), len(str(units.counts(limits.stroke / 2))))
        size = len(query.command) + 1 + (reply if query is POSITION else 5) + 1
        return 10 * size / baud_rate + TURNAROUND

    def rounded(tick: float) -> float:
        return float(min(max_rate, 5 * max(1, 1 / tick // 5)))

    longest = min(units.counts(limits.reach), units.counts(-limits.reach))
    vt, adt = units.vt(limits.speed), units.adt(limits.acceleration)
    tick = 10 * len(encode_move(longest, vt, adt)) / baud_rate + query_time(POSITION) + query_time(STATUS_0) / 3
    if 1 / tick >= _MIN_FULL_RATE:
        return StreamingSchedule(rounded(tick), True, 3)
    tick = 10 * len(encode_move(longest, vt, None)) / baud_rate + max(query_time(POSITION), query_time(STATUS_0))
    return StreamingSchedule(rounded(tick), False, 4)


@dataclass(frozen=True)
class Horizon:
    """Duration of a motion command that no other follows: ``coast`` s at speed, then braking until ``stop`` s.

    Parameters
    ----------
    tick : float
        Time in s between two commands.
    min_stop : float
        Desired time in s from a command to standstill. A slow line needs three ticks, which may be longer.
    """

    tick: float
    min_stop: float

    @property
    def stop(self) -> float:
        """Time in s from the last command to standstill."""
        return max(self.min_stop, 3 * self.tick)

    @property
    def coast(self) -> float:
        """Time in s after a command before the rod brakes for its target. The next command may be half a tick late."""
        return max(self.stop / 4, 1.5 * self.tick)

    @property
    def lead(self) -> float:
        """Time in s by which the target is ahead of the rod at the commanded speed: the coast and half of the braking."""
        return (self.stop + self.coast) / 2

    def braking_acceleration(self, speed: float) -> float:
        """Return the acceleration in m/s² that stops the rod in time from any speed up to ``speed`` m/s."""
        return speed / (self.stop - self.coast)


@dataclass(frozen=True)
class RodSetpoint:
    """Intended motion of the rod at a bench time in s: position in m, velocity in m/s, acceleration in m/s²."""

    time: float
    position: float
    velocity: float
    acceleration: float

    def at(self, time: float) -> "RodSetpoint":
        """Return the setpoint at another bench time, extrapolated with constant acceleration."""
        dt = time - self.time
        return RodSetpoint(
            time,
            self.position + dt * (self.velocity + dt * self.acceleration / 2),
            self.velocity + dt * self.acceleration,
            self.acceleration,
        )


def setpoint_error(setpoint: RodSetpoint, limits: Limits) -> str:
    """Return why a setpoint cannot be followed wherever the rod is, or "" if it can."""
    numbers = (setpoint.time, setpoint.position, setpoint.velocity, setpoint.acceleration)
    if not np.isfinite(numbers).all():
        return f"setpoint holds {numbers}, expected finite numbers"
    # The relative tolerance lets setpoints pass that lie exactly on a limit before they are rounded.
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
class MotionCommand:
    """One motion command in SI units at the rod.

    Attributes
    ----------
    time : float
        Bench time in s from which the command is in force.
    position : float
        Target in m, where the motion ends if no other command follows.
    velocity : float
        Signed velocity in m/s that the rod reaches on the way.
    acceleration : float
        Acceleration in m/s² with which it reaches this velocity.
    initial_velocity : float
        Velocity in m/s of the rod before the command.
    """

    time: float
    position: float
    velocity: float
    acceleration: float
    initial_velocity: float = 0.0

    def travel(self, begin: float, end: float) -> float:
        """Return the travel in m between two bench times, provided that the rod follows and the target stays ahead."""
        return self._travel_until(end) - self._travel_until(begin)

    def _travel_until(self, time: float) -> float:
        change = self.velocity - self.initial_velocity
        ramp = abs(change) / self.acceleration
        elapsed = max(0.0, time - self.time)
        if elapsed >= ramp:
            return self.velocity * elapsed - change * ramp / 2
        return elapsed * (self.initial_velocity + change * elapsed / ramp / 2)


def plan_move(
    setpoint: RodSetpoint,
    position: float,
    previous_velocity: float,
    horizon: Horizon,
    gain: float,
    limits: Limits,
    fixed_acceleration: float | None = None,
) -> MotionCommand:
    """Return the motion command for the next tick.

    Parameters
    ----------
    setpoint : RodSetpoint
        Setpoint at the time at which the command takes effect.
    position : float
        Position of the rod in m at that time.
    previous_velocity : float
        Velocity in m/s that the previous command gave the rod.
    horizon : Horizon
        How long the command lasts.
    gain : float
        Speed in m/s added per metre of following error.
    limits : Limits
        The target is kept within the reach, the speed within the speed limit.
    fixed_acceleration : float, optional
        Acceleration in m/s² that the motor was given beforehand. Without it, the command chooses one.

    Returns
    -------
    MotionCommand
        Its target lies ``horizon.lead`` of travel ahead of the setpoint. Its acceleration suffices both to reach the new
        speed within a tick and to stop within the horizon.
    """
    tick = horizon.tick
    # The motor ramps to the new speed, then holds it. If the ramp takes the whole tick, the new speed is the setpoint's at
    # the end of the tick. If the ramp is short, it is the setpoint's in the middle of the tick. In both cases the rod's mean
    # velocity over the tick is that of the setpoint.
    ramp = fixed_acceleration or max(
        abs(setpoint.acceleration), horizon.braking_acceleration(abs(setpoint.velocity)), _MIN_ACCELERATION
    )
    ramp_share = min(1.0, abs(setpoint.acceleration) / ramp)
    velocity = setpoint.velocity + setpoint.acceleration * tick * (1 + ramp_share) / 2
    target = setpoint.position + velocity * horizon.lead
    velocity += gain * (setpoint.position - position)
    velocity = min(limits.speed, max(-limits.speed, velocity))
    acceleration = fixed_acceleration or max(
        abs(velocity - previous_velocity) / tick,
        horizon.braking_acceleration(max(abs(velocity), abs(previous_velocity))),
        _MIN_ACCELERATION,
    )
    target = min(limits.reach, max(-limits.reach, target))
    return MotionCommand(setpoint.time, target, velocity, acceleration, previous_velocity)
