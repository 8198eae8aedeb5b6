"""The controller of the servo: it decides which commands and queries the motor is sent.

`ServoCommunication` carries them over the serial line. Every public method may be called from any thread and returns at
once. Times are bench times in s.
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

from mrd_base.lease import is_timely
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.homing import LEAST_TRAVEL, REST_TOLERANCE, Homing, HomingError, Phase
from mrd_bench_driver.servo.motor_setup import MotorIdentity
from mrd_bench_driver.servo.rod_estimator import PositionJumpError, RodEstimator
from mrd_bench_driver.servo.smartmotor import (
    BUS_VOLTAGE,
    FIRMWARE,
    POSITION,
    RESOLUTION,
    STATUS_0,
    STATUS_1,
    TEMPERATURE,
    MotorStatus,
    MotorUnits,
    Query,
    decode_status,
    encode_move,
)
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.servo.streaming import (
    STANDSTILL_SPEED,
    Horizon,
    RodSetpoint,
    plan_move,
    plan_streaming,
    setpoint_error,
)

# Queries other than the position, in turn. Status word 0 comes most often, because it shows the faults.
_ROTATION = (STATUS_0, STATUS_1, STATUS_0, BUS_VOLTAGE, STATUS_0, TEMPERATURE)
# Speed in m/s below which the drive may be switched off without a jerk of the rod.
_RELEASE_SPEED = 5e-3
# Shortest and longest wait in s for this speed.
_RELEASE_WAIT = (0.05, 0.3)
# Age in s of a switching command below which the status words may still show the state before it.
_STATUS_DELAY = 0.05
# Begin of the command that switches the drive on.
_SWITCH_ON = b"MP "
# Ticks between two accelerations on a line too slow for one in each tick; a garbled one is corrected this soon.
_ACCELERATION_INTERVAL = 25
# Following error, as a multiple of its limit, at which nobody asks the motor any more.
_LARGEST_EXCESS = 1.5
# Longest tick in s that counts in the mean; a longer one is a pause of the machine.
_MAX_TICK = 0.1


class Activity(Enum):
    """Source of the rod's motion."""

    NOTHING = "standing"
    SETPOINTS = "following setpoints"
    HOMING = "homing"


class Response(NamedTuple):
    """Response to a request."""

    success: bool
    message: str


@dataclass(frozen=True)
class Batch:
    """Outputs of one tick.

    Attributes
    ----------
    time : float
        Bench time in s of the tick.
    data : bytes
        Commands and queries.
    queries : tuple of Query
        Queries among them, in the order of their replies.
    position_time : float
        Bench time in s by which the motor has read its position, if that is the first query.
    """

    time: float
    data: bytes
    queries: tuple[Query, ...]
    position_time: float


class ServoController:
    """Controller of the servo.

    Parameters
    ----------
    wake_up : callable
        Called when a stop waits to be sent. It must cause a call of `take_commands` at once.
    """

    def __init__(self, config: ServoConfig, wake_up: Callable[[], None] = lambda: None) -> None:
        self.config, self._wake_up = config, wake_up
        self._lock = threading.RLock()
        self._queue: list[tuple[int, int, bytes]] = []  # heap of priority, number and command
        self._queued = 0
        self._units = MotorUnits(config.drive)
        self._baud_rate = config.baud_rate
        self._schedule = plan_streaming(config.baud_rate, self._units, config.limits, config.rate)
        self._rod = RodEstimator()
        self._activity = Activity.NOTHING
        self._setpoint = RodSetpoint(-math.inf, 0.0, 0.0, 0.0)
        self._heard = -math.inf  # when it came
        self._homing: Homing | None = None
        self._connected = self._homed = False
        self._emergency_stop = ""  # reason of the latched stop
        self._in_step = False  # whether replies are known to match their queries
        self._suspect: Query | None = None  # a status word that shows a fault, and is read again before it is believed
        self._asked = False  # whether the motor was asked for a fault because of a following error
        self._drive_on = self._armed = False  # armed: setpoints are followed
        self._fault = self._note = ""
        self._values: dict[Query, int] = {}  # latest reply to each query
        self._switched = -math.inf  # bench time of the last command after which earlier replies do not count
        self._release_requested: float | None = None
        self._following_error = 0.0
        self._ticks, self._rotation = 0, 0
        self._mean_tick, self._last_tick = 1 / self._schedule.rate, math.nan
        self.missed_replies = self.ignored_setpoints = 0

    # Requests

    def follow(self, setpoint: RodSetpoint, now: float) -> None:
        """Follow a setpoint. It is ignored while the servo is not ready; a setpoint that cannot be followed is a fault."""
        with self._lock:
            late = not is_timely(setpoint.time, now, self.config.setpoint_timeout)
            ready = self._armed and self._drive_on and self._homed and self._activity is not Activity.HOMING
            if error := setpoint_error(setpoint, self.config.limits):
                if ready:
                    self._fail(error)
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
                self._rod.set_command(None)
            # A stamp in the future must not keep the rod moving after its sender has stopped.
            self._setpoint, self._heard = setpoint, min(setpoint.time, now)

    def enable(self, on: bool, now: float) -> Response:
        """Switch the drive on and follow setpoints, or bring the rod to rest and switch the drive off."""
        with self._lock:
            if not on:
                self._stop(b"X\r")
                self._request_release(now)
                return Response(True, "disabled")
            if reason := self._reason_not_ready():
                return Response(False, reason)
            self._switch_on(now)
            self._armed, self._note = True, ""
            return Response(True, "enabled" if self._homed else "enabled; not homed, setpoints are ignored until it is")

    def home(self, now: float) -> Response:
        """Start homing. Its end shows in the status: homed, or a fault with its message."""
        with self._lock:
            if reason := self._reason_not_ready():
                return Response(False, reason)
            if self._activity is not Activity.NOTHING or abs(self._rod.velocity) > STANDSTILL_SPEED:
                return Response(False, f"the servo is {self._activity.value}; stop it first")
            self._switch_on(now)
            self._homed, self._armed, self._note = False, True, ""
            config = self.config
            travel = min(LEAST_TRAVEL, config.limits.reach / 2)  # so that the rod stays within a short stroke
            self._homing = Homing(now, self._rod.position, config.homing_speed, config.homing_tolerance, travel)
            self._activity = Activity.HOMING
            return Response(True, "homing started")

    def stop(self) -> Response:
        """Bring the rod to rest and hold it. Setpoints are ignored until `enable`."""
        with self._lock:
            self._stop(b"X\r")
            return Response(True, "stopped; enable to go on")

    def emergency_stop(self, now: float, reason: str = "emergency stop") -> None:
        """Stop abruptly and switch the drive off. The stop is latched until `reset_fault`; the first reason stays."""
        with self._lock:
            self._emergency_stop = self._emergency_stop or reason
            self._stop(b"S\r")
            self._request_release(now)

    def reset_fault(self, now: float) -> Response:
        """Clear faults and the emergency stop. The drive stays off until `enable`."""
        with self._lock:
            if self._connected and abs(self._rod.velocity) > _RELEASE_SPEED:
                return Response(False, "the rod still moves; reset once it stands")
            # The motor keeps its position-error fault (Be) while its trajectory generator runs, so OFF comes before ZS.
            command = b"OFF ZS\r"
            if self._homed and abs(self._rod.position) > self._travel_limit:
                command, self._homed = b"OFF SLD ZS\r", False
            self._stop(command)
            self._drive_on, self._release_requested = False, None
            self._fault = self._note = self._emergency_stop = ""
            self._values.pop(STATUS_0, None)
            self._values.pop(STATUS_1, None)
            self._switched = now
            return Response(True, "faults cleared; enable to go on")

    def add_samples(self, time: float, period: float, position: npt.NDArray[np.float64] | Sequence[float]) -> None:
        """Add a block of LVDT positions in m, the first at ``time`` s, ``period`` s apart. Homing needs them."""
        with self._lock:
            if self._homing is not None:
                try:
                    self._homing.add_samples(time, period, position, self._rod.position)
                except HomingError as error:
                    self._fail(f"homing: {error}")

    def status(self, now: float) -> ServoStatus:
        """Return the state of the servo."""
        with self._lock:
            motor = self._motor_status
            voltage, temperature = self._values.get(BUS_VOLTAGE), self._values.get(TEMPERATURE)
            stopped = f"{self._emergency_stop}; reset_fault clears it" if self._emergency_stop else ""
            return ServoStatus(
                time=self._rod.time if self._connected else now,
                position=self._rod.position,
                velocity=self._rod.velocity if self._connected else 0.0,
                following_error=self._following_error if self._activity is not Activity.NOTHING else 0.0,
                bus_voltage=math.nan if voltage is None else voltage / 1000,
                temperature=math.nan if temperature is None else float(temperature),
                status=self._values.get(STATUS_0, 0),
                connected=self._connected,
                enabled=self._drive_on,
                homed=self._homed,
                moving=self._connected and (motor.moving or abs(self._rod.velocity) > STANDSTILL_SPEED),
                fault=bool(self._fault),
                stopped=bool(self._emergency_stop),
                message=self._fault or stopped or self._note,
            )

    # Calls of the thread that owns the line

    def connect(self, motor: MotorIdentity, baud_rate: int, now: float) -> None:
        """Take over a motor that stands, is off, and is set up. It stays homed unless it was reset."""
        with self._lock:
            self._units, self._baud_rate = motor.units, baud_rate
            self._schedule = plan_streaming(baud_rate, motor.units, self.config.limits, self.config.rate)
            self._connected, self._in_step, self._suspect = True, True, None
            was_homed, self._homed = self._homed, self._homed and decode_status(*motor.words).soft_limits
            self._rod.reset(now, motor.units.metres(motor.position))
            self._queue.clear()
            self._drive_on, self._release_requested, self._note = False, None, ""
            if was_homed and not self._homed:
                self._note = "the motor was reset; check its supply, then home again"
                self._fault = f"{self._fault}; {self._note}" if self._fault else ""
            self._values.clear()
            self._switched = now
            self._mean_tick, self._last_tick = 1 / self._schedule.rate, math.nan

    def disconnect(self, reason: str) -> None:
        """Note that the line is lost. Nothing moves again before `enable`."""
        with self._lock:
            self._connected = self._drive_on = self._armed = False
            self._activity, self._release_requested = Activity.NOTHING, None
            self._abandon_homing()
            self._note = reason

    @property
    def homed(self) -> bool:
        """Whether the motor counts from mid-stroke, unless it was reset since the line was lost."""
        return self._homed

    @property
    def period(self) -> float:
        """Time in s between two ticks."""
        return 1 / self._schedule.rate

    @property
    def position_due(self) -> float:
        """Bench time in s at which `tick` stops the present motion if no valid position has come."""
        with self._lock:
            return math.inf if self._activity is Activity.NOTHING else self._rod.time + self.config.feedback_timeout

    def take_commands(self) -> bytes:
        """Return the commands that wait to be sent, stops first, and remove them from the queue."""
        with self._lock:
            return b"".join(heapq.heappop(self._queue)[2] for _ in range(len(self._queue)))

    def tick(self, now: float) -> Batch:
        """Return what to send now, after the commands that wait (`take_commands`)."""
        with self._lock:
            if not math.isnan(self._last_tick):
                measured = min(_MAX_TICK, now - self._last_tick)
                self._mean_tick = max(self.period, 0.9 * self._mean_tick + 0.1 * measured)
            self._last_tick = now
            self._check_timeouts(now)
            self._continue_homing(now)
            move = self._next_move(now)
            self._ticks += 1
            queries = self._next_queries(bool(move))
            data = move + b" ".join(query.command for query in queries) + b"\r"
            position_time = now + 10 * (len(move) + len(POSITION.command) + 1) / self._baud_rate
            return Batch(now, data, queries, position_time)

    def take_replies(self, batch: Batch, values: Sequence[int], arrived: float) -> None:
        """Process the replies to the queries of a batch; the first one ended at the bench time ``arrived``."""
        with self._lock:
            if batch.time <= self._switched:
                return  # the replies show the state before the last switching command
            replies = dict(zip(batch.queries, values, strict=True))
            if RESOLUTION in replies:
                # FIRMWARE and RESOLUTION have known replies of different patterns. If they come in this order, no late reply
                # is left, and replies match their queries again.
                self._in_step = replies.pop(RESOLUTION) == self.config.drive.counts_per_revolution
                if not self._in_step:
                    return
            replies.pop(FIRMWARE, None)
            for query, value in replies.items():
                if query is POSITION:
                    read = min(batch.position_time, arrived - 10 * (len(str(value)) + 1) / self._baud_rate)
                    self._process_position(max(batch.time, read), self._units.metres(value))
                else:
                    self._values[query] = value
                    if query in (STATUS_0, STATUS_1):
                        self._check_motor_status(query, batch.time)

    def replies_missed(self) -> None:
        """Note that replies of a batch are missing or wrong. The next batch checks whether replies match their queries."""
        with self._lock:
            self.missed_replies += 1
            self._in_step = False

    def replies_interrupted(self) -> None:
        """Note that the wait for replies was interrupted. The next batch checks whether replies match their queries."""
        with self._lock:
            self._in_step = False

    # Internals; the lock is held

    @property
    def _motor_status(self) -> MotorStatus:
        return decode_status(self._values.get(STATUS_0, 0), self._values.get(STATUS_1, 0))

    @property
    def _travel_limit(self) -> float:
        """Distance in m from mid-stroke at which the motor stops by itself: between reach and stroke."""
        return self.config.limits.reach + self.config.limits.margin / 2

    @property
    def _horizon(self) -> Horizon:
        return Horizon(self._mean_tick, self.config.stop_time)

    def _reason_not_ready(self) -> str:
        if not self._connected:
            return f"the motor is not connected ({self._note or 'still looking for it'})"
        if self._emergency_stop:
            return f"the emergency stop is latched ({self._emergency_stop}); reset_fault clears it"
        return f"{self._fault}; reset_fault clears it" if self._fault else ""

    def _enqueue(self, command: bytes, urgent: bool = False) -> None:
        if not self._connected:
            return  # a motor that connects is switched off anyway
        self._queued += 1
        heapq.heappush(self._queue, (0 if urgent else 1, self._queued, command))
        if urgent:
            self._wake_up()

    def _stop(self, command: bytes) -> None:
        """Send a stop before anything else. A drive that waits to be switched on stays off: this was requested before."""
        kept = [entry for entry in self._queue if not entry[2].startswith(_SWITCH_ON)]
        if len(kept) < len(self._queue):
            heapq.heapify(kept)
            self._queue, self._drive_on = kept, False
        self._enqueue(command, urgent=True)
        self._armed, self._activity = False, Activity.NOTHING
        self._rod.set_command(None)
        self._abandon_homing()

    def _request_release(self, now: float) -> None:
        """Have the drive switched off once the rod stands; requests that are repeated must not put this off."""
        self._release_requested = now if self._release_requested is None else self._release_requested

    def _abandon_homing(self) -> None:
        if self._homing is not None:
            self._homing, self._homed = None, False

    def _fail(self, reason: str) -> None:
        self._fault = self._fault or reason
        self._stop(b"X\r")

    def _switch_on(self, now: float) -> None:
        """Switch the drive on; it holds the rod where it stands."""
        self._release_requested = None
        if self._drive_on:
            return
        position = self._units.counts(self._rod.position)
        acceleration = self._units.adt(self._horizon.braking_acceleration(self.config.limits.speed))
        self._enqueue(_SWITCH_ON + encode_move(position, self._units.vt(_RELEASE_SPEED), acceleration))
        self._drive_on, self._switched = True, now

    def _check_timeouts(self, now: float) -> None:
        if self._release_requested is not None:
            waited = now - self._release_requested
            if waited > _RELEASE_WAIT[1] or (waited > _RELEASE_WAIT[0] and abs(self._rod.velocity) < _RELEASE_SPEED):
                self._enqueue(b"OFF\r")
                self._release_requested, self._drive_on, self._switched = None, False, now
        if self._activity is Activity.SETPOINTS and now - self._heard > self.config.setpoint_timeout:
            if abs(self._setpoint.velocity) < STANDSTILL_SPEED and abs(self._following_error) < REST_TOLERANCE:
                self._activity = Activity.NOTHING
                self._rod.set_command(None)
            else:
                self._fail(
                    "setpoints stopped while the rod moved; check the node that sends them (generator, or controller in a "
                    "hybrid test)"
                )
        if now >= self.position_due:
            self._fail(
                f"no valid position from the motor for {1e3 * (now - self._rod.time):.0f} ms of motion; check the line"
            )

    def _continue_homing(self, now: float) -> None:
        homing = self._homing
        if homing is None:
            return
        position = self._rod.position
        try:
            origin = homing.measured_position(now, position)
            if origin is not None:
                self._set_origin(origin, now)
            elif homing.phase is Phase.ORIGIN:
                limited = self._motor_status.soft_limits or abs(homing.origin) > self._travel_limit
                fresh = STATUS_1 in self._values and self._rod.time > self._switched
                confirmed = fresh and limited and abs(position - homing.origin) < REST_TOLERANCE
                homing.confirm_origin(now, position, confirmed)
                if confirmed:
                    self._rod.set_command(None)
            elif homing.arrived(now, position, abs(self._rod.velocity) < STANDSTILL_SPEED):
                self._enqueue(b"SLE\r")
            elif homing.complete(now, position):
                self._homing, self._homed, self._activity = None, True, Activity.NOTHING
        except HomingError as error:
            self._fail(f"homing: {error}")

    def _set_origin(self, origin: float, now: float) -> None:
        low, high = sorted((self._units.counts(-self._travel_limit), self._units.counts(self._travel_limit)))
        position = self._units.counts(origin)
        # The motor keeps its old target when the origin moves, so PT is set with it. The limits stay off for a rod beyond
        # them: it could not come back.
        enable_limits = b" SLE" if abs(origin) <= self._travel_limit else b""
        self._enqueue(b"SLD O=%d PT=%d SLN=%d SLP=%d%s\r" % (position, position, low, high, enable_limits))
        self._rod.reset(now, origin)
        self._values.pop(STATUS_1, None)
        self._switched = now

    def _next_move(self, now: float) -> bytes:
        """Return the motion command of this tick, or nothing if the rod is not to move."""
        homing_move = self._homing is not None and self._homing.phase is Phase.MOVE
        if self._activity is not Activity.SETPOINTS and not homing_move:
            return b""
        # A setpoint that is getting old is not extrapolated any more. The motion then ends by itself.
        if not homing_move and now - self._heard > self.config.setpoint_timeout / 2:
            return b""
        fixed = None if self._schedule.with_acceleration else self._horizon.braking_acceleration(self.config.limits.speed)
        with_adt = fixed is None or self._ticks % _ACCELERATION_INTERVAL == 0
        typical = encode_move(self._units.counts(self._rod.position), self._units.vt(0.05), 1000 if with_adt else None)
        setpoint = self._setpoint_at(now + 10 * len(typical) / self._baud_rate)
        command = plan_move(
            setpoint,
            self._rod.predict(setpoint.time),
            self._rod.commanded_velocity,
            self._horizon,
            self.config.position_gain,
            self.config.limits,
            fixed,
        )
        self._rod.set_command(command)
        adt = self._units.adt(command.acceleration) if with_adt else None
        return encode_move(self._units.counts(command.position), self._units.vt(abs(command.velocity)), adt)

    def _setpoint_at(self, time: float) -> RodSetpoint:
        return self._homing.move.at(time) if self._homing is not None else self._setpoint.at(time)

    def _next_queries(self, moves: bool) -> tuple[Query, ...]:
        if not self._in_step:
            return (FIRMWARE, RESOLUTION)
        if self._suspect is not None:
            return (FIRMWARE, self._suspect, RESOLUTION)  # no reply between these two can be that to another query
        if self._homing is not None and self._homing.phase is Phase.ORIGIN:
            return (POSITION, STATUS_1)
        if self._ticks % self._schedule.status_interval:
            return (POSITION,)
        self._rotation = (self._rotation + 1) % len(_ROTATION)
        query = _ROTATION[self._rotation]
        return (query,) if moves and not self._schedule.with_acceleration else (POSITION, query)

    def _process_position(self, time: float, position: float) -> None:
        try:
            accepted = self._rod.update(time, position)
        except PositionJumpError as jump:
            self._homed = False
            self._rod.reset(time, position)
            self._fail(f"{jump}; check whether it was reset, call reset_fault, then home again")
            return
        if not accepted or self._activity is Activity.NOTHING:
            return
        if self._homing is not None and self._homing.phase is not Phase.MOVE:
            return
        self._following_error = self._setpoint_at(time).position - self._rod.position
        excess = abs(self._following_error) / self.config.following_error_limit
        if excess <= 1:
            self._asked = False
        elif not self._asked:
            # A motor that has stopped for a fault of its own stays behind, too. It is asked first, so that this is named.
            self._asked, self._suspect = True, self._suspect or STATUS_0
        elif self._suspect is None or excess > _LARGEST_EXCESS:
            self._fail(
                f"following error of {1e3 * self._following_error:.2f} mm exceeds "
                f"{1e3 * self.config.following_error_limit:g} mm; look for a jammed rod, too fast a setpoint or a slow line"
            )

    def _check_motor_status(self, query: Query, queried: float) -> None:
        motor = self._motor_status
        # Only status word 0 tells whether the drive is on, and only a word that was read after the drive was switched.
        settled = query is STATUS_0 and queried >= self._switched + _STATUS_DELAY
        if ((motor.faults and not self._fault) or (settled and self._drive_on and motor.off)) and self._suspect is None:
            # A reply to another query may look like a fault. The motor stops by itself; so there is time to ask again.
            self._suspect = query
            return
        self._suspect = None
        if motor.faults and not self._fault:
            self._fail("motor: " + "; ".join(motor.faults))
        if not settled:
            return
        if self._drive_on and motor.off:
            self._drive_on = False
            self._fail("the drive went off by itself; check the motor's supply, then reset_fault")
        elif not self._drive_on and not motor.off:
            self._enqueue(b"OFF\r")
