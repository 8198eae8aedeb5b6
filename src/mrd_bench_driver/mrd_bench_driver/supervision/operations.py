"""The operations on the bench of which procedures consist: home, tare, enable, record, start, stop, and others.

Each operation calls services of the other nodes, waits for its effect, and ends within a deadline. An operation that cannot
be done raises `RefusedError`.
"""

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from mrd_base import BenchClock
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.errors import RefusedError
from mrd_bench_driver.supervision.interlocks import (
    HOMING_INTERLOCKS,
    LOST_SERVO,
    RESET_INTERLOCKS,
    STALE_SAMPLES,
    Interlocks,
    Trip,
    check_start_temperature,
    first_trip,
)
from mrd_bench_driver.supervision.modes import BenchMode, Mode
from mrd_bench_driver.supervision.punctuality import Punctuality
from mrd_bench_driver.supervision.run_requests import RunRequest
from mrd_bench_driver.supervision.snapshot import BenchMonitor, Snapshot, SourceState

# Distance in m from mid-stroke below which the rod need not be homed again before an experiment.
CENTRE_TOLERANCE = 5e-4
# Speed in m/s below which a fault may be reset.
RESET_SPEED = 2e-3
# Bench time in s for what takes effect within a few periods of servo, DAQ or generator, with a margin.
_EFFECT_TIMEOUT = 2.0
# Bench time in s for samples to pass through the DAQ, and for inputs to become healthy.
_SAMPLE_TIMEOUT = 1.0
# Bench time in s for the bench to come to rest before a tare.
_TARE_TIMEOUT = 5.0
# Wall time in s that generator or controller may take to check and plan an experiment: nothing moves meanwhile, and a busy
# machine took more than 30 s for a hybrid test.
_PLANNING_TIMEOUT = 120.0
# Wall time in s for a reset, which may restart a converter.
_RESET_TIMEOUT = 10.0
# Wall time in s between two reports of the progress of an experiment.
_PROGRESS_INTERVAL = 0.2
# Bench time in s between two looks, while the recorder waits for rest, at whether it is still there.
_REST_INTERVAL = 0.5
# Bench time in s over which the supervisor's cycle is measured before anything moves.
_MEASUREMENT = 0.25
# Bench time in s for all nodes to hear of a new mode, which the lease carries.
_LEASE_DELAY = 0.05
# Bench time in s after which a silent recorder ends a run. It is no danger, and may have to wait for a disk.
_RECORDER_SILENCE = 0.8
# Time by which an experiment may exceed its duration: bench time in s, and share of the duration.
_OVERTIME = (3.0, 0.02)

Interruption = Callable[[], None]


def never_interrupted() -> None:
    """Interrupt nothing."""


@dataclass(frozen=True)
class Source:
    """Where the setpoints of a run come from.

    Attributes
    ----------
    node : str
    load, start, abort : str
        Its services.
    mode : Mode
        Mode of the bench during the run.
    action : str
        Action of the supervisor that begins the run.
    """

    node: str
    load: str
    start: str
    abort: str
    mode: Mode
    action: str


GENERATOR = Source(
    "generator", "load_experiment", "start_experiment", "abort_experiment", Mode.IDENTIFICATION, "run_experiment"
)
CONTROLLER = Source("controller", "load_control", "start_control", "abort_control", Mode.CONTROL, "run_control")


class Peers(Protocol):
    """Services of the other nodes: ``servo``, ``daq``, ``generator``, ``controller`` and ``recorder``.

    Timeouts are in wall seconds.

    While a call waits, it calls ``interruption``, which ends the wait by raising an exception, and whose own time does not
    count.
    """

    def require(self, nodes: tuple[str, ...], timeout: float, interruption: Interruption) -> None:
        """Wait until the nodes are present."""

    def check(self, service: str) -> None:
        """Refuse if the node that offers a service is gone."""

    def call(
        self,
        service: str,
        timeout: float,
        interruption: Interruption = never_interrupted,
        *,
        may_fail: bool = False,
        **fields: Any,
    ) -> Any:
        """Call a service with these fields and return its response; refuse one without success, unless it may fail."""

    def set_sample_rate(self, rate: float, timeout: float, interruption: Interruption) -> None:
        """Set the sample rate in Hz of the DAQ."""


@dataclass(frozen=True)
class LoadedExperiment:
    """Duration in s and sample rate in Hz of a loaded experiment."""

    duration: float
    rate: float


@dataclass(frozen=True)
class BagSummary:
    """Content of a closed bag: folder, numbers of recorded and lost samples, duration in s, and what is wrong with it."""

    bag: str = ""
    samples: int = 0
    lost: int = 0
    duration: float = 0.0
    problem: str = ""


class BenchOperations:
    """The operations on the bench. Each may block; call them from a thread that may wait.

    During every wait they call ``interruption``, which ends the operation by raising `TrippedError` or `CancelledError`.
    """

    def __init__(
        self,
        config: SupervisorConfig,
        clock: BenchClock,
        peers: Peers,
        monitor: BenchMonitor,
        mode: BenchMode,
        interruption: Interruption,
        punctuality: Punctuality,
        source: Source = GENERATOR,
    ) -> None:
        self.source, self._punctuality = source, punctuality
        self._config, self._clock, self._peers = config, clock, peers
        self._monitor, self._mode, self._interruption = monitor, mode, interruption
        self._rate, self._loads, self._lease = math.nan, 0, 0

    # Conditions

    def require_ready(self) -> None:
        """Wait until all nodes are present and know that the bench is idle; refuse unless it is."""
        self._mode.require_idle()
        self._clock.sleep(_LEASE_DELAY)
        self._peers.require(
            ("servo", "daq", self.source.node, "recorder"), self._config.discovery_timeout, self._interruption
        )

    def require_start_temperature(self) -> None:
        """Refuse to start a run with a damper that is too hot or too cold, as far as a sensor tells."""
        if problem := check_start_temperature(self._monitor.snapshot(self._clock.now()), self._config.interlocks):
            raise RefusedError(f"not started, {problem}")

    def require_ready_to_move(self) -> None:
        """Wait until servo and DAQ are present and healthy; refuse unless the bench is idle."""
        self._mode.require_idle()
        self.require_servo_and_daq()
        self._require_healthy()
        self.require_punctual_machine()

    def require_servo_and_daq(self) -> None:
        """Wait until servo and DAQ are present."""
        self._peers.require(("servo", "daq"), self._config.answer_timeout, self._interruption)

    def _require_healthy(self) -> None:
        def silent() -> bool:
            trip = self._first_trip(HOMING_INTERLOCKS)
            return trip is not None and trip.interlock in (STALE_SAMPLES, LOST_SERVO)

        # Nodes that have just been started need a while to find motor and converter.
        with contextlib.suppress(RefusedError):
            self._wait_until(lambda: not silent(), self._config.answer_timeout, "")
        trip = self._first_trip(HOMING_INTERLOCKS)
        if trip is not None:
            raise RefusedError(f"not armed, {trip.interlock}: {trip.message}")

    def require_punctual_machine(self) -> None:
        """Measure for a moment how punctual the supervisor's cycle is; refuse if it is too late to stop the rod in time."""
        self._punctuality.restart()
        self._clock.sleep(_MEASUREMENT)
        if problem := self._punctuality.problem(self._clock.now()):
            raise RefusedError(f"not armed, {problem}")

    # The experiment

    def load(self, experiment: str) -> LoadedExperiment:
        """Let the generator plan an experiment, or the controller check a hybrid test. Nothing moves."""
        loads = self._told.loads
        response = self._call(self.source.load, _PLANNING_TIMEOUT, experiment=experiment)
        # The state of an earlier experiment must not be taken for the state of this one.
        self._wait_until(lambda: self._told.loads > loads, _EFFECT_TIMEOUT, f"{self.source.node}: did not announce `loaded`")
        self._loads = loads + 1
        return LoadedExperiment(response.duration, response.rate)

    def require_prepared(self) -> None:
        """Refuse where the recorder has fallen silent, or the experiment does not wait for its start any more."""
        self._require_recorder()
        self._require_loaded()

    def _require_loaded(self) -> None:
        """Refuse where what was loaded here does not wait for its start any more."""
        node, told = self.source.node, self._told
        if told.loads != self._loads:
            raise RefusedError(f"{node}: somebody has loaded another experiment meanwhile; run this one again")
        if told.state == "aborted":
            raise RefusedError(f"the {node} aborted the experiment before its start; {told.reason}")
        if told.state in ("running", "done"):
            raise RefusedError(f"{node}: somebody has started the experiment before its recording; run it again")

    def start_experiment(self) -> None:
        """Start the setpoints of the loaded experiment."""
        self._require_loaded()
        self._call(self.source.start)

    def follow_experiment(self, duration: float, progress: Callable[[float], None]) -> str:
        """Wait for the end of the experiment and report its progress in s; return why it ended early, or "".

        Refuse if it ends otherwise or is late, if somebody stops the rod or changes the rate, or if the recording fails.
        """
        clock = self._clock
        begin = clock.now()
        latest = duration + max(_OVERTIME[0], _OVERTIME[1] * duration)
        reported = -math.inf
        while self._told.state != "done":
            self._interruption()
            elapsed = clock.now() - begin
            self._require_undisturbed(begin)
            if self._told.state == "aborted":
                reason = self._told.reason or "look at its log"
                raise RefusedError(f"the {self.source.node} aborted the experiment; {reason}")
            self._require_recording()
            if elapsed > latest:
                raise RefusedError(f"the experiment should have ended after {duration:.1f} s; check the {self.source.node}")
            if time.monotonic() - reported > _PROGRESS_INTERVAL:
                self._peers.check("stop_recording")
                reported = time.monotonic()
                progress(min(elapsed, duration))
            clock.sleep_step(0.02)
        self._require_undisturbed(begin)
        return self._told.reason

    def _require_recording(self) -> None:
        monitor = self._monitor
        if monitor.recording_problem:
            raise RefusedError(monitor.recording_problem)
        self._require_recorder()
        if monitor.recorder_state != "recording":
            raise RefusedError("recorder: the recording ended during the run; look at its log")

    def _require_recorder(self) -> None:
        """Refuse where the recorder has fallen silent."""
        silence = self._clock.now() - self._monitor.recorder_time
        if silence > _RECORDER_SILENCE:
            raise RefusedError(f"recorder: has been silent for {silence:.2f} s; look at its log")

    def _require_undisturbed(self, begin: float) -> None:
        servo = self._servo()
        if servo.time > begin and not servo.enabled:
            raise RefusedError(
                f"servo: somebody stopped the rod during the run ({servo.message or 'by servo/stop or servo/enable'})"
            )
        if abs(self._monitor.sample_period * self._rate - 1) > 1e-6:
            raise RefusedError(f"daq: somebody changed the sample rate to {1 / self._monitor.sample_period:g} Hz")

    def await_last_samples(self) -> None:
        """Wait until the samples of the present instant have arrived."""
        end = self._clock.now()
        self._wait_until(
            lambda: self._monitor.sample_time >= end,
            _SAMPLE_TIMEOUT,
            "daq: no samples came after the experiment's end; check the converter",
        )

    def abort_experiment(self) -> None:
        """Stop the setpoints; the coil current follows them to 0 A."""
        self._peers.call(self.source.abort, self._config.answer_timeout)

    # Samples and recording

    def set_sample_rate(self, rate: float) -> None:
        """Set the sample rate in Hz; wait until samples come at this rate and the servo is healthy."""
        self._rate = rate
        self._peers.set_sample_rate(rate, self._config.answer_timeout, self._interruption)
        self._wait_until(
            lambda: abs(self._monitor.sample_period * rate - 1) < 1e-6,
            _EFFECT_TIMEOUT,
            f"daq: no samples at {rate:g} Hz came; check the converter, or the plant when it is simulated",
        )
        self._require_healthy()

    def tare(self) -> None:
        """Tare the sensors, if configured, as soon as the bench has been at rest for long enough.

        Refuse where somebody starts or aborts the experiment meanwhile.
        """
        if not self._config.tare:
            return
        reason = ""

        def tared() -> bool:
            nonlocal reason
            self._require_loaded()
            response = self._peers.call("daq/tare", self._config.answer_timeout, self._interruption, may_fail=True)
            reason = response.message
            if not response.success:
                self._clock.sleep_step(0.1)
            return bool(response.success)

        self._wait_until(tared, _TARE_TIMEOUT, lambda: f"daq: {reason}")

    def start_recording(self, request: RunRequest) -> None:
        """Open the bag."""
        self._lease = self._mode.lease
        self._call(
            "start_recording", bag=str(request.bag), experiment=request.experiment, seed=request.seed, lease=self._lease
        )

        def records() -> bool:
            self._require_recorder()
            return self._monitor.recorder_state == "recording"

        self._wait_until(records, _EFFECT_TIMEOUT, "recorder: did not announce `recording`")

    def stop_recording(self) -> BagSummary:
        """Close the bag and count its samples. The recorder waits until rod and coil are at rest, in bench time."""
        clock, monitor = self._clock, self._monitor
        latest = clock.now() + self._config.close_timeout

        def let_rod_rest() -> None:
            # A simulated bench would stand still during the call. It ends the wait at the instant at which rest was seen.
            if monitor.recorder_state == "stopping" and clock.now() < latest:
                monitor.recorder_changed.wait(clock.now() + _REST_INTERVAL)

        timeout = self._config.close_timeout
        response = self._peers.call("stop_recording", timeout, let_rod_rest, may_fail=True, lease=self._lease)
        problem = "" if response.success else response.message
        return BagSummary(response.bag, response.samples, response.lost, response.duration, problem)

    # The rod

    def enter(self, mode: Mode, reason: str, source: str = "") -> None:
        """Change to a mode in which the rod may move and the interlocks are checked; wait until all have heard of it."""
        self._mode.enter(mode, reason, source)
        self._clock.sleep(_LEASE_DELAY)

    def centre(self, *, always: bool = False, require: Callable[[], None] = lambda: None) -> None:
        """Home the rod, unless it is homed, by the LVDT as well, and stands at mid-stroke.

        Meanwhile ``require`` refuses where it makes no sense any more.
        """

        def centred() -> bool:
            servo = self._servo()
            difference = self._snapshot().position_difference  # nan until both have been heard
            agree = not abs(difference) > self._config.interlocks.position_difference
            return servo.homed and abs(servo.position) < CENTRE_TOLERANCE and agree

        def ended() -> bool:
            require()
            return self._servo().time > begin and (centred() or not self._servo().enabled)

        if always or not centred():
            self._call("servo/home")
            begin = self._clock.now()
            timeout = self._config.home_timeout
            self._wait_until(
                ended,
                timeout,
                lambda: f"servo: not homed within {timeout:g} s; the rod stands at {1e3 * self._servo().position:.2f} mm",
            )
            self._interruption()
            if not centred():
                raise RefusedError("servo: somebody stopped the homing")

    def enable(self) -> None:
        """Switch the drive on."""
        self._call("servo/enable", data=True)
        self._wait_until(
            lambda: self._servo().enabled, _EFFECT_TIMEOUT, "servo: the drive did not switch on; check the motor's power"
        )

    def halt(self) -> None:
        """Stop the rod, then switch the drive off."""
        self._peers.call("servo/rest", self._config.answer_timeout)

    def halt_all(self) -> list[str]:
        """Stop the rod and an experiment, whatever runs; return what failed."""
        failures = []
        active = self._told.state in ("loaded", "running")
        for step in (self.halt, self.abort_experiment) if active else (self.halt,):
            try:
                step()
            except RefusedError as error:
                failures.append(str(error))
        return failures

    def reset_faults(self) -> None:
        """Reset servo and DAQ once their data are healthy and the rod stands."""
        self._clock.sleep(_LEASE_DELAY)
        trip = self._first_trip(RESET_INTERLOCKS)
        if trip is not None and trip.interlock == STALE_SAMPLES:
            # The reset restarts a converter that failed.
            self._call("daq/reset_fault", _RESET_TIMEOUT)
        with contextlib.suppress(RefusedError):
            self._wait_until(lambda: self._first_trip(RESET_INTERLOCKS) is None, _SAMPLE_TIMEOUT, "")
        trip = self._first_trip(RESET_INTERLOCKS)
        if trip is not None:
            raise RefusedError(f"not reset, {trip.interlock}: {trip.message}")
        self._wait_until(
            lambda: abs(self._servo().velocity) < RESET_SPEED, _EFFECT_TIMEOUT, "the rod still moves; reset once it stands"
        )
        self._call("servo/reset_fault", _RESET_TIMEOUT)
        self._call("daq/reset_fault", _RESET_TIMEOUT)
        begin = self._clock.now()
        self._wait_until(
            lambda: (
                self._servo().time > begin
                and not (self._servo().stopped or self._servo().fault or self._monitor.daq_problem)
            ),
            _EFFECT_TIMEOUT,
            "servo or daq: still in fault after the reset; look at their messages",
        )

    # Internals

    def _call(self, service: str, timeout: float | None = None, **fields: Any) -> Any:
        # Else it would be chance whether a node that works at this instant, too, has done so before the request comes, and
        # whether what it then publishes has been received when the response comes.
        self._clock.settle()
        self._interruption()  # what has come meanwhile must not be answered by a request
        response = self._peers.call(service, timeout or self._config.answer_timeout, self._interruption, **fields)
        self._clock.settle()
        return response

    def _wait_until(self, condition: Callable[[], bool], timeout: float, failure: str | Callable[[], str]) -> None:
        """Wait for a condition, at most ``timeout`` bench seconds."""
        deadline = self._clock.now() + timeout
        while not condition():
            self._interruption()
            if self._clock.now() > deadline:
                raise RefusedError(failure if isinstance(failure, str) else failure())
            self._clock.sleep_step(0.01)

    @property
    def _told(self) -> SourceState:
        """What the source of the setpoints has told of its experiment."""
        return self._monitor.sources[self.source.node]

    def _servo(self) -> ServoStatus:
        if self._monitor.servo is None:
            raise RefusedError("no servo_state came; check the servo node")
        return self._monitor.servo

    def _first_trip(self, interlocks: Interlocks) -> Trip | None:
        return first_trip(self._snapshot(), self._config.limits, self._config.interlocks, interlocks)

    def _snapshot(self) -> Snapshot:
        return self._monitor.snapshot(self._clock.now(), self._mode.source)
