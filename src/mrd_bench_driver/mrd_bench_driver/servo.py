"""The servo: decides what the motor is told; `servo_loop` carries it over the line.

Every public method may be called from any thread and returns at once. Times are bench seconds.
"""

import heapq
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from mrd_bench_driver.drive import STANDING, Horizon, Plan, Setpoint, aim, plan, refusal
from mrd_bench_driver.homing import REST, Homing, HomingError, Phase
from mrd_bench_driver.rod import PositionJump, Rod
from mrd_bench_driver.servo_config import ServoConfig, ServoReport
from mrd_bench_driver.smartmotor import (
    BUS_VOLTAGE,
    FIRMWARE,
    POSITION,
    RESOLUTION,
    STATUS_0,
    STATUS_1,
    TEMPERATURE,
    Report,
    Status,
    Units,
    decode_status,
    motion,
)
from mrd_bench_driver.smartmotor_setup import Motor

# Order in which waiting reports get their turn; faults show in word 0.
_ROTATION = (STATUS_0, STATUS_1, STATUS_0, BUS_VOLTAGE, STATUS_0, TEMPERATURE)
# Speed in m/s below which letting go of the rod is gentle, and the wait in s for it.
_SLOW = 5e-3
_LET_GO = (0.05, 0.3)


class Activity(Enum):
    """What moves the rod."""

    NOTHING = "standing"
    SETPOINTS = "following setpoints"
    HOMING = "homing"


class Answer(NamedTuple):
    """Answer to a request."""

    success: bool
    message: str


@dataclass(frozen=True)
class Batch:
    """One write of a tick: bytes, the reports that they ask for, and the time by which a first RPA is taken."""

    time: float
    data: bytes
    reports: tuple[Report, ...]
    asked: float


class Servo:
    """State of the servo.

    Parameters
    ----------
    config : ServoConfig
    wake : callable
        Called when a stop waits to be sent; it must bring `take` about at once.
    """

    def __init__(self, config: ServoConfig, wake: Callable[[], None] = lambda: None) -> None:
        self.config, self._wake = config, wake
        self._lock = threading.RLock()
        self._outbox: list[tuple[int, int, bytes]] = []
        self._sent = 0
        self._units = Units(config.drive)
        self._baud_rate = config.baud_rate
        self._plan: Plan = plan(config.baud_rate, self._units, config.limits, config.rate)
        self._rod = Rod()
        self._activity = Activity.NOTHING
        self._setpoint = Setpoint(-math.inf, 0.0, 0.0, 0.0)
        self._homing: Homing | None = None
        self._connected = self._homed = self._stopped = self._synced = False
        self._holding = self._armed = False
        self._fault = self._note = ""
        self._values: dict[Report, int] = {}
        self._changed = -math.inf
        self._let_go: float | None = None
        self._following_error = 0.0
        self._ticks, self._rotation = 0, 0
        self._tick, self._last_tick = 1 / self._plan.rate, math.nan
        self.missed_replies = self.ignored_setpoints = 0

    # -- requests ------------------------------------------------------------------------------------------------------

    def setpoint(self, setpoint: Setpoint, now: float) -> None:
        """Follow a setpoint; refused with a fault when it cannot be followed, ignored when the servo is not ready."""
        with self._lock:
            late = abs(now - setpoint.time) > self.config.setpoint_timeout
            ready = self._armed and self._holding and self._homed and self._activity is not Activity.HOMING
            if line := refusal(setpoint, self.config.limits):
                if ready:
                    self._fail(line)
                return
            if not ready or late or setpoint.time <= self._setpoint.time:
                self.ignored_setpoints += 1
                return
            distance = setpoint.at(now).position - self._rod.position
            if self._activity is Activity.NOTHING:
                if not abs(distance) <= self.config.start_distance:
                    self._fail(
                        f"first setpoint is {1e3 * distance:.2f} mm away from the rod, at most "
                        f"{1e3 * self.config.start_distance:g} mm are allowed; start where the rod stands"
                    )
                    return
                self._activity, self._following_error = Activity.SETPOINTS, 0.0
                self._rod.command(None)
            self._setpoint = setpoint

    def enable(self, on: bool, now: float) -> Answer:
        """Let the drive hold the rod and setpoints be followed, or bring the rod to rest and let it go."""
        with self._lock:
            if not on:
                self._halt(b"X\r")
                self._let_go = now
                return Answer(True, "disabled")
            if reason := self._not_ready():
                return Answer(False, reason)
            self._hold(now)
            self._armed, self._note = True, ""
            return Answer(True, "enabled" if self._homed else "enabled; not homed, setpoints are ignored until it is")

    def home(self, now: float) -> Answer:
        """Begin homing; the state tells the rest (homed, or fault with its line)."""
        with self._lock:
            if reason := self._not_ready():
                return Answer(False, reason)
            if self._activity is not Activity.NOTHING or abs(self._rod.velocity) > STANDING:
                return Answer(False, f"the servo is {self._activity.value}; stop it first")
            self._hold(now)
            self._homed, self._armed, self._note = False, True, ""
            self._homing = Homing(now, self._rod.position, self.config.homing_speed, self.config.homing_tolerance)
            self._activity = Activity.HOMING
            return Answer(True, "homing begun")

    def stop(self) -> Answer:
        """Bring the rod to rest and hold it; setpoints are ignored until `enable`."""
        with self._lock:
            self._halt(b"X\r")
            return Answer(True, "stopped; enable to go on")

    def emergency_stop(self, now: float) -> None:
        """Stop abruptly and let go; latched until `reset_fault`."""
        with self._lock:
            self._stopped = True
            self._halt(b"S\r")
            self._let_go = now

    def reset_fault(self, now: float) -> Answer:
        """Clear faults and the emergency stop; the drive stays off until `enable`."""
        with self._lock:
            if self._connected and abs(self._rod.velocity) > _SLOW:
                return Answer(False, "the rod still moves; reset once it stands")
            # Be stays while the trajectory generator runs: OFF goes first.
            command = b"OFF ZS\r"
            if self._homed and abs(self._rod.position) > self._travel_limit:
                command, self._homed = b"OFF SLD ZS\r", False
            self._halt(command)
            self._holding, self._let_go, self._stopped = False, None, False
            self._fault = self._note = ""
            self._values.pop(STATUS_0, None)
            self._values.pop(STATUS_1, None)
            self._changed = now
            return Answer(True, "faults cleared; enable to go on")

    def samples(self, time: float, period: float, position: npt.NDArray[np.float64] | Sequence[float]) -> None:
        """Take a block of LVDT positions (first at ``time`` s, ``period`` s apart, in m); homing needs them."""
        with self._lock:
            if self._homing is not None:
                try:
                    self._homing.add(time, period, position, self._rod.position)
                except HomingError as error:
                    self._fail(f"homing: {error}")

    # -- the line's side -----------------------------------------------------------------------------------------------

    def connected(self, motor: Motor, baud_rate: int, now: float) -> None:
        """Take over a motor that stands, off and set up. It is homed only if it was and has not been reset since."""
        with self._lock:
            self._units, self._baud_rate = motor.units, baud_rate
            self._plan = plan(baud_rate, motor.units, self.config.limits, self.config.rate)
            self._connected, self._synced = True, True
            self._homed = self._homed and decode_status(*motor.words).soft_limits
            self._rod.place(now, motor.units.metres(motor.position))
            self._outbox.clear()
            self._holding, self._let_go, self._note = False, None, ""
            self._values.clear()
            self._changed = now
            self._tick, self._last_tick = 1 / self._plan.rate, math.nan

    def lost(self, reason: str) -> None:
        """Take note that the line is gone: nothing moves again before `enable`."""
        with self._lock:
            self._connected = self._holding = self._armed = False
            self._activity, self._let_go = Activity.NOTHING, None
            if self._homing is not None:
                self._homing, self._homed = None, False
            self._note = reason

    @property
    def keep_origin(self) -> bool:
        """Whether the motor, unless reset, still counts from mid-stroke."""
        return self._homed

    @property
    def period(self) -> float:
        """Time in s between two ticks."""
        return 1 / self._plan.rate

    def take(self) -> bytes:
        """Commands that wait to be sent, stops first."""
        with self._lock:
            return b"".join(heapq.heappop(self._outbox)[2] for _ in range(len(self._outbox)))

    def tick(self, now: float) -> Batch:
        """What to send now, after what waits (`take`)."""
        with self._lock:
            if not math.isnan(self._last_tick):
                measured = min(0.1, now - self._last_tick)
                self._tick = max(self.period, 0.9 * self._tick + 0.1 * measured)
            self._last_tick = now
            self._watch(now)
            self._home(now)
            move = self._motion(now)
            self._ticks += 1
            reports = self._reports(bool(move))
            data = move + b" ".join(report.query for report in reports) + b"\r"
            return Batch(now, data, reports, now + 10 * (len(move) + len(POSITION.query) + 1) / self._baud_rate)

    def replied(self, batch: Batch, values: Sequence[int], arrived: float) -> None:
        """Take the values of a batch's reports; the first reply ended at the bench time ``arrived``."""
        with self._lock:
            if batch.time <= self._changed:
                return  # asked before what was commanded since: an old truth
            for report, value in zip(batch.reports, values, strict=True):
                if report is RESOLUTION:
                    # The answers are known and differ in form: whatever was late, replies match questions again.
                    self._synced = value == self.config.drive.counts_per_revolution
                elif report is FIRMWARE:
                    continue
                elif report is POSITION:
                    taken = min(batch.asked, arrived - 10 * (len(str(value)) + 1) / self._baud_rate)
                    self._take_position(max(batch.time, taken), self._units.metres(value))
                else:
                    self._values[report] = value
                    if report in (STATUS_0, STATUS_1):
                        self._judge_status(batch.time)

    def missed(self) -> None:
        """Take note that the replies of a batch are missing or wrong; the next one finds out where questions stand."""
        with self._lock:
            self.missed_replies += 1
            self._synced = False

    def broken_off(self) -> None:
        """Take note that the wait for replies was broken off."""
        with self._lock:
            self._synced = False

    def report(self, now: float) -> ServoReport:
        """State of the servo."""
        with self._lock:
            status = self._status
            voltage, temperature = self._values.get(BUS_VOLTAGE), self._values.get(TEMPERATURE)
            stopped = "emergency stop; reset_fault clears it" if self._stopped else ""
            return ServoReport(
                time=self._rod.time if self._connected else now,
                position=self._rod.position,
                velocity=self._rod.velocity if self._connected else 0.0,
                following_error=self._following_error if self._activity is not Activity.NOTHING else 0.0,
                bus_voltage=math.nan if voltage is None else voltage / 1000,
                temperature=math.nan if temperature is None else float(temperature),
                status=self._values.get(STATUS_0, 0),
                connected=self._connected,
                enabled=self._holding and self._armed,
                homed=self._homed,
                moving=self._connected and (status.moving or abs(self._rod.velocity) > STANDING),
                fault=bool(self._fault),
                stopped=self._stopped,
                message=self._fault or stopped or self._note,
            )

    # -- within --------------------------------------------------------------------------------------------------------

    @property
    def _status(self) -> Status:
        return decode_status(self._values.get(STATUS_0, 0), self._values.get(STATUS_1, 0))

    @property
    def _travel_limit(self) -> float:
        """Where the motor itself stops: beyond every setpoint, before the end of the stroke."""
        return self.config.limits.reach + self.config.limits.margin / 2

    @property
    def _horizon(self) -> Horizon:
        return Horizon(self._tick, self.config.stop_time)

    def _not_ready(self) -> str:
        if not self._connected:
            return f"the motor is not connected ({self._note or 'still looking for it'})"
        if self._stopped:
            return "the emergency stop is latched; reset_fault clears it"
        return f"{self._fault}; reset_fault clears it" if self._fault else ""

    def _push(self, command: bytes, urgent: bool = False) -> None:
        if not self._connected:
            return  # a motor that connects is switched off anyway
        self._sent += 1
        heapq.heappush(self._outbox, (0 if urgent else 1, self._sent, command))
        if urgent:
            self._wake()

    def _halt(self, command: bytes) -> None:
        """Send a stop before anything else, and nothing of what waited: it was asked for before."""
        self._outbox = [entry for entry in self._outbox if entry[0] == 0]
        heapq.heapify(self._outbox)
        self._push(command, urgent=True)
        self._armed, self._activity = False, Activity.NOTHING
        self._rod.command(None)
        if self._homing is not None:
            self._homing, self._homed = None, False

    def _fail(self, reason: str) -> None:
        self._fault = self._fault or reason
        self._halt(b"X\r")

    def _hold(self, now: float) -> None:
        """Switch the drive on where the rod stands."""
        self._let_go = None
        if self._holding:
            return
        here = self._units.counts(self._rod.position)
        acceleration = self._units.adt(self._horizon.hardest(self.config.limits.speed))
        self._push(b"MP " + motion(here, self._units.vt(_SLOW), acceleration))
        self._holding, self._changed = True, now

    def _watch(self, now: float) -> None:
        """Notice what no longer comes."""
        if self._let_go is not None:
            soonest, latest = self._let_go + _LET_GO[0], self._let_go + _LET_GO[1]
            if now > latest or (now > soonest and abs(self._rod.velocity) < _SLOW):
                self._push(b"OFF\r")
                self._let_go, self._holding, self._changed = None, False, now
        if self._activity is Activity.SETPOINTS and now - self._setpoint.time > self.config.setpoint_timeout:
            if abs(self._setpoint.velocity) < STANDING and abs(self._following_error) < REST:
                self._activity = Activity.NOTHING
                self._rod.command(None)
            else:
                self._halt(b"X\r")
                self._note = "setpoints stopped while the rod moved; check the generator, then enable again"
        if self._activity is not Activity.NOTHING and now - self._rod.time > self.config.feedback_timeout:
            self._fail(
                f"no valid position from the motor for {1e3 * (now - self._rod.time):.0f} ms of motion; check the line"
            )

    def _home(self, now: float) -> None:
        homing = self._homing
        if homing is None:
            return
        rod = self._rod.position
        try:
            origin = homing.measured(now, rod)
            if origin is not None:
                self._set_origin(origin, now)
            elif homing.phase is Phase.ORIGIN:
                limited = self._status.soft_limits or abs(homing.origin) > self._travel_limit
                fresh = STATUS_1 in self._values and self._rod.time > self._changed
                if homing.origin_taken(now, rod, fresh and limited and abs(rod - homing.origin) < REST):
                    self._rod.command(None)
            elif homing.arrived(now, rod, abs(self._rod.velocity) < STANDING):
                self._push(b"SLE\r")
            elif homing.confirmed(now, rod):
                self._homing, self._homed, self._activity = None, True, Activity.NOTHING
        except HomingError as error:
            self._fail(f"homing: {error}")

    def _set_origin(self, origin: float, now: float) -> None:
        low, high = sorted((self._units.counts(-self._travel_limit), self._units.counts(self._travel_limit)))
        here = self._units.counts(origin)
        # The motor keeps its old target when the origin moves: PT goes with it. A rod beyond the limits must first come
        # back, since with them it could not move at all.
        enable = b" SLE" if abs(origin) <= self._travel_limit else b""
        self._push(b"SLD O=%d PT=%d SLN=%d SLP=%d%s\r" % (here, here, low, high, enable))
        self._rod.place(now, origin)
        self._values.pop(STATUS_1, None)
        self._changed = now

    def _motion(self, now: float) -> bytes:
        moving = self._homing is not None and self._homing.phase is Phase.MOVE
        if self._activity is not Activity.SETPOINTS and not moving:
            return b""
        # A setpoint that is getting old is not carried on: the motion then ends by itself.
        if not moving and now - self._setpoint.time > self.config.setpoint_timeout / 2:
            return b""
        # Without ADT in each tick (a slow line) it is sent only now and then, lest a spoiled byte count for ever.
        fixed = None if self._plan.with_acceleration else self._horizon.hardest(self.config.limits.speed)
        with_adt = fixed is None or self._ticks % 25 == 0
        length = len(motion(self._units.counts(self._rod.position), self._units.vt(0.05), 1000 if with_adt else None))
        desired = self._desired(now + 10 * length / self._baud_rate)
        target = aim(
            desired,
            self._rod.predict(desired.time),
            self._rod.commanded_velocity,
            self._horizon,
            self.config.position_gain,
            self.config.limits,
            fixed,
        )
        self._rod.command(target)
        adt = self._units.adt(target.acceleration) if with_adt else None
        return motion(self._units.counts(target.position), self._units.vt(abs(target.velocity)), adt)

    def _desired(self, time: float) -> Setpoint:
        if self._homing is not None:
            return self._homing.approach.at(time)
        return self._setpoint.at(time)

    def _reports(self, moved: bool) -> tuple[Report, ...]:
        if not self._synced:
            return (FIRMWARE, RESOLUTION)
        if self._homing is not None and self._homing.phase is Phase.ORIGIN:
            return (POSITION, STATUS_1)
        if self._ticks % self._plan.spare:
            return (POSITION,)
        self._rotation = (self._rotation + 1) % len(_ROTATION)
        spare = _ROTATION[self._rotation]
        return (spare,) if moved and not self._plan.with_acceleration else (POSITION, spare)

    def _take_position(self, time: float, position: float) -> None:
        try:
            believed = self._rod.report(time, position)
        except PositionJump as jump:
            self._homed = False
            self._rod.place(time, position)
            self._fail(f"{jump}; was it reset? reset_fault, then home again")
            return
        if not believed or self._activity is Activity.NOTHING:
            return
        if self._homing is not None and self._homing.phase is not Phase.MOVE:
            return
        self._following_error = self._desired(time).position - self._rod.position
        if abs(self._following_error) > self.config.following_error_limit:
            self._fail(
                f"following error of {1e3 * self._following_error:.2f} mm exceeds "
                f"{1e3 * self.config.following_error_limit:g} mm; look for a jammed rod, too fast a setpoint or a slow line"
            )

    def _judge_status(self, asked: float) -> None:
        status = self._status
        if status.faults and not self._fault:
            self._fail("motor: " + "; ".join(status.faults))
        if STATUS_0 not in self._values or asked < self._changed + 0.05:
            return
        if self._holding and status.off:
            self._holding = False
            self._fail("the drive went off by itself; check the motor's supply, then reset_fault")
        elif not self._holding and not status.off:
            self._push(b"OFF\r")
