"""The supervisor: it checks the interlocks, holds the mode of the bench, and runs one procedure at a time."""

import contextlib
import dataclasses
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

from mrd_base import BenchClock
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.errors import CancelledError, RefusedError
from mrd_bench_driver.supervision.interlocks import CONTROL_INTERLOCKS, HOMING_INTERLOCKS, INTERLOCKS, first_trip
from mrd_bench_driver.supervision.modes import BenchMode, Mode
from mrd_bench_driver.supervision.operations import (
    CONTROLLER,
    GENERATOR,
    BenchOperations,
    Interruption,
    Peers,
    Source,
    never_interrupted,
)
from mrd_bench_driver.supervision.procedure import Progress, RunOutcome, SetOutcome, run_experiment, run_set
from mrd_bench_driver.supervision.punctuality import Punctuality
from mrd_bench_driver.supervision.run_requests import RunRequest, control_run, require_new, set_of_runs, single_run
from mrd_bench_driver.supervision.snapshot import BenchMonitor

# Receives the number of a run in its set, from 1, its request, the phase, elapsed time in s and duration in s.
SetProgress = Callable[[int, RunRequest, str, float, float], None]

Outcome = TypeVar("Outcome", RunOutcome, SetOutcome)

# Bench time in s within which the DAQ tells of a stop.
_ANNOUNCEMENT = 0.5


class Supervisor:
    """Supervises the bench.

    The requests (`home`, `control`, `stop`, `reset_fault`, `run_experiment`, `run_set`) block, so that each needs a thread
    that may wait. Whoever adds data to `monitor` calls `check_interlocks` afterwards. This and `emergency_stop` return
    at once.

    Parameters
    ----------
    on_mode : callable
        Receives `mode` and `stop_count` at the start and after every change of one of them.
    send_emergency_stop : callable
        Sends the emergency stop to all nodes (True), or its release (False).

    Attributes
    ----------
    monitor : BenchMonitor
        What the other nodes have published.
    mode : BenchMode
        The mode of the bench and its reason.
    procedure : str
        Name of the procedure that runs, or "".
    stops : int
        How often `stop` was called.
    """

    def __init__(
        self,
        config: SupervisorConfig,
        clock: BenchClock,
        peers: Peers,
        on_mode: Callable[[BenchMode, int], None],
        send_emergency_stop: Callable[[bool], None],
    ) -> None:
        self._config, self._clock, self._peers = config, clock, peers
        self._send_emergency_stop, self._on_mode = send_emergency_stop, on_mode
        self._runs = Path(config.runs).expanduser()
        self._lock = threading.Lock()
        # Bench time in whole s, so that whoever has asked an earlier supervisor for runs counts as stopped with this one.
        self._first_count = 1 + int(clock.now())
        self._emergency_stops = 0  # so many have come
        self._stopped = -math.inf  # bench time at which the nodes were last told to stop
        self._halts, self._halt_time = 0, clock.now()  # stops by services of the servo, and bench time of the latest
        self._stops_before = 0  # stops that came before the present procedure
        self._begun = -math.inf  # bench time of its beginning
        self._controlled = -math.inf  # bench time since which somebody controls by hand
        self._punctuality = Punctuality(config.late)
        self._checked = clock.now()
        self.stops = 0
        self.monitor = BenchMonitor(clock)
        # The time in microseconds is unique, also among supervisors that follow each other.
        self.mode = BenchMode(lambda mode: on_mode(mode, self.stop_count), lambda: int(1e6 * clock.now()))
        self.procedure = ""

    # Interlocks and the emergency stop

    @property
    def stop_count(self) -> int:
        """One more with every stop, by whatever way it comes, from a number that no earlier supervisor had."""
        return self._first_count + self.stops + self._emergency_stops + self._halts

    def stopped_since(self, count: int) -> bool:
        """Whether the bench was stopped since `stop_count` had a value; never since 0, which stands for no value."""
        return count not in (0, self.stop_count)

    def _note_halt(self) -> None:
        """Count a stop by a service of the servo."""
        servo = self.monitor.servo
        if servo is not None and servo.halt_time > self._halt_time:
            self._halt_time = servo.halt_time
            self._halts += 1
            self._on_mode(self.mode, self.stop_count)

    def check_interlocks(self) -> None:
        """Stop the bench if an interlock trips while the rod may move."""
        self._note_halt()
        self._check_stall()
        self._checked = self._clock.now()
        mode, servo = self.mode.current, self.monitor.servo
        if mode.may_move:
            interlocks = {Mode.HOMING: HOMING_INTERLOCKS, Mode.CONTROL: CONTROL_INTERLOCKS}.get(mode, INTERLOCKS)
            snapshot = self.monitor.snapshot(self._clock.now(), self.mode.source)
            trip = first_trip(snapshot, self._config.limits, self._config.interlocks, interlocks)
            if trip is not None:
                self.emergency_stop(f"interlock {trip.interlock}: {trip.message}")
            elif mode is Mode.CONTROL and not self.procedure:  # somebody controls by hand
                silence = self._clock.now() - max(self._controlled, self.monitor.setpoint_time)
                if self._is_halted():
                    self.mode.leave("somebody stopped the rod (by servo/stop or servo/enable)")
                elif silence > self._config.control_timeout:
                    # Whoever has forgotten it must not find a bench that moves hours later.
                    self.mode.leave(f"no setpoint to follow came for {self._config.control_timeout:g} s; call control again")
        elif mode is Mode.IDLE and self.procedure in ("", "reset_fault"):
            # The stop is older than this process, or somebody has pressed the button of one node.
            if servo is not None and servo.stopped:
                self.emergency_stop(f"servo: {servo.message or 'its emergency stop is latched; call reset_fault'}")
            elif self.monitor.daq_problem:
                self.emergency_stop(f"daq: {self.monitor.daq_problem}")

    def _check_stall(self) -> None:
        """Trip after a pause of this process. What fell silent in its own absence is not to blame."""
        pause = self._clock.now() - self._checked
        if pause > self._config.stall and self.mode.current.may_move:
            self.emergency_stop(
                f"the supervisor was stalled for {pause:.2f} s and did not watch; look for what stopped it or keeps this "
                "machine busy"
            )

    def emergency_stop(self, reason: str) -> None:
        """Stop everything at once. The stop is latched until `reset_fault`; the reason of the first stop stays."""
        self._emergency_stops += 1
        self._latch_stop()
        self.mode.trip(reason)

    def _latch_stop(self) -> None:
        self._stopped = self._clock.now()
        self._send_emergency_stop(True)

    def tick(self) -> None:
        """Check the interlocks, and how punctually this is called every ``check`` s."""
        self._punctuality.note(self._clock.now(), self._config.check)
        self.check_interlocks()

    @property
    def late_cycles(self) -> int:
        """Number of late cycles in the latest run or since the start."""
        return self._punctuality.late

    # Requests

    def home(self) -> str:
        """Home the rod; return the message of success."""
        with self._exclusive("home"):
            bench = self._operations()
            bench.require_ready_to_move()
            with self._halt_on_failure(bench):
                bench.enter(Mode.HOMING, "home")
                bench.centre(always=True)
                bench.halt()
            self.mode.leave("homed")
        return "the rod stands at mid-stroke"

    def control(self) -> str:
        """Home the rod if necessary, then let it follow the topic ``setpoint``; return the message of success."""
        with self._exclusive("control"):
            bench = self._operations()
            bench.require_ready_to_move()
            with self._halt_on_failure(bench):
                bench.enter(Mode.HOMING, "control")
                bench.centre()
                bench.enter(Mode.CONTROL, "control")
                bench.enable()
                number, self._controlled = self.mode.lease, self._clock.now()
        # From here on, a stop ends the mode itself. One that came before has left that to this request.
        with self._clock.busy(), self._halt_on_failure(bench):
            self._raise_if_interrupted()
        return f"the rod follows setpoints that carry lease {number}"

    def stop(self) -> str:
        """Stop whatever runs; return the message of success."""
        self.stops += 1
        self._on_mode(self.mode, self.stop_count)
        try:
            with self._clock.busy():
                failures = self._operations().halt_all()
        finally:
            # A running procedure leaves its mode itself, once it has stopped everything.
            if not self.procedure:
                self.mode.leave("stopped")
        if failures:
            raise RefusedError("; ".join(failures))
        return "stopped"

    def reset_fault(self) -> str:
        """Release the emergency stop if the inputs are healthy; return the message of success."""
        with self._exclusive("reset_fault"):
            bench = self._operations(never_interrupted)
            bench.require_servo_and_daq()
            stops, problems = self._emergency_stops, self.monitor.daq_problems  # first: none that comes from here on is lost
            # The DAQ may have yet to tell of the stop that is being reset.
            late = not self.monitor.daq_problem and self._clock.now() - self._stopped < _ANNOUNCEMENT

            def stopped() -> bool:
                return self._emergency_stops > stops or self.monitor.daq_problems > problems + late or self._is_halted()

            try:
                bench.reset_faults()
            except RefusedError:
                # A node that was reset already is stopped again. Of a bench without a fault, nothing was latched.
                if self.mode.current is Mode.FAULT:
                    self._latch_stop()
                raise
            # The reset of servo and DAQ has erased what they heard meanwhile.
            if not stopped():
                self._send_emergency_stop(False)
                if self.mode.current is Mode.FAULT:
                    self.mode.enter(Mode.IDLE, "fault reset")
            if stopped():  # the latest stop has found the mode still in fault
                self.emergency_stop("a stop came during the reset")
                raise RefusedError("a stop came during the reset; reset again once nobody is in danger")
        return "reset; home or run an experiment to go on"

    def check_experiment(self, experiment: str, bag: str, seed: int, stops: int = 0) -> None:
        """Raise `RefusedError` if `run_experiment` would refuse at once, or the bench was stopped since a `stop_count`."""
        self._require_free(stops)
        require_new(single_run(experiment, bag, seed, self._runs))

    def check_control(self, experiment: str, bag: str, seed: int, stops: int = 0) -> None:
        """Raise `RefusedError` if `run_control` would refuse at once, or the bench was stopped since a `stop_count`."""
        self._require_free(stops)
        require_new(control_run(experiment, bag, seed, self._runs))

    def check_set(self, experiments: Sequence[str], folder: str, seed: int, stops: int = 0) -> None:
        """Raise `RefusedError` if `run_set` would refuse at once, or the bench was stopped since a `stop_count`."""
        self._require_free(stops)
        set_of_runs(experiments, folder, seed, self._runs)

    def run_experiment(
        self, experiment: str, bag: str, seed: int, progress: Progress, cancelled: Callable[[], bool]
    ) -> RunOutcome:
        """Run one experiment, given by the text of its file. ``cancelled`` is asked during every wait."""

        def work(bench: BenchOperations) -> RunOutcome:
            return self._run(bench, single_run(experiment, bag, seed, self._runs), progress)

        return self._run_exclusively("run_experiment", RunOutcome, work, cancelled)

    def run_control(
        self, experiment: str, bag: str, seed: int, progress: Progress, cancelled: Callable[[], bool]
    ) -> RunOutcome:
        """Run one hybrid test, given by the text of its file. ``cancelled`` is asked during every wait."""

        def work(bench: BenchOperations) -> RunOutcome:
            return self._run(bench, control_run(experiment, bag, seed, self._runs), progress)

        return self._run_exclusively("run_control", RunOutcome, work, cancelled)

    def run_set(
        self, experiments: Sequence[str], folder: str, seed: int, progress: SetProgress, cancelled: Callable[[], bool]
    ) -> SetOutcome:
        """Run experiments one after the other, each into its own bag in the folder."""

        def work(bench: BenchOperations) -> SetOutcome:
            requests = set_of_runs(experiments, folder, seed, self._runs)

            def progress_of(request: RunRequest) -> Progress:
                return partial(progress, requests.index(request) + 1, request)

            def check(request: RunRequest) -> None:
                progress_of(request)("checking", 0.0, 0.0)
                bench.require_ready()
                bench.load(request.experiment)

            return run_set(requests, check, lambda request: self._run(bench, request, progress_of(request)))

        return self._run_exclusively("run_set", SetOutcome, work, cancelled)

    # Internals

    def _operations(self, interruption: Interruption | None = None) -> BenchOperations:
        interruption = interruption or self._raise_if_interrupted
        return BenchOperations(
            self._config, self._clock, self._peers, self.monitor, self.mode, interruption, self._punctuality, self._source
        )

    @property
    def _source(self) -> Source:
        """Where the setpoints of the present procedure come from."""
        return CONTROLLER if self.procedure == "run_control" else GENERATOR

    def _raise_if_interrupted(self) -> None:
        self._check_stall()
        self.mode.require_no_fault()
        if self.stops != self._stops_before:
            raise CancelledError
        # Servo and DAQ forget a stop of what does not move yet. The procedure must not go on as if nobody had asked. An
        # emergency stop is remembered, and an interlock names it.
        servo = self.monitor.servo
        if servo and not servo.stopped and self._is_halted():
            before = {Mode.IDLE: "rod before the run", Mode.HOMING: "homing"}
            stopped = before.get(self.mode.current, "rod during the run")
            raise RefusedError(f"servo: somebody stopped the {stopped} (by servo/stop or servo/enable)")

    def _is_halted(self) -> bool:
        """Whether somebody has stopped the servo by its services since the present procedure began."""
        servo = self.monitor.servo
        return servo is not None and servo.halt_time > self._begun

    def _run_exclusively(
        self,
        name: str,
        outcome_type: type[Outcome],
        work: Callable[[BenchOperations], Outcome],
        cancelled: Callable[[], bool],
    ) -> Outcome:
        def interruption() -> None:
            self._raise_if_interrupted()
            if cancelled():
                raise CancelledError

        try:
            with self._exclusive(name):
                return work(self._operations(interruption))
        except RefusedError as error:
            return outcome_type(False, False, str(error))

    def _run(self, bench: BenchOperations, request: RunRequest, progress: Progress) -> RunOutcome:
        self._punctuality.restart()
        try:
            outcome = run_experiment(bench, request, progress)
        finally:
            self.mode.leave("the experiment ended")
        # A stop may have reached another node first, whose end of the run was noticed before its reason.
        if self.mode.current is Mode.FAULT and self.mode.reason not in outcome.message:
            outcome = dataclasses.replace(outcome, success=False, message=f"{self.mode.reason}; {outcome.message}")
        # An interlock names what fell silent. Whether only the machine was too slow, it cannot know.
        problem = self._punctuality.problem(self._clock.now())
        return dataclasses.replace(outcome, message=f"{outcome.message}; {problem}") if problem else outcome

    def _require_free(self, stops: int) -> None:
        """Refuse unless the bench is idle, no procedure runs, and nobody has stopped the bench since a `stop_count`."""
        self._require_no_procedure()
        self.mode.require_idle()
        if self.stopped_since(stops):
            raise RefusedError("somebody stopped the bench before this run; find out why, then ask for the run again")

    def _require_no_procedure(self) -> None:
        if self.procedure:
            raise RefusedError(f"the bench is busy: {self.procedure}; wait for its end or call stop")

    @contextlib.contextmanager
    def _exclusive(self, procedure: str) -> Iterator[None]:
        """Let one procedure run at a time; refuse others."""
        with self._lock:
            self._require_no_procedure()
            # A mode in which the rod may move belongs to a control by hand. A stop of it that comes now must not leave it to
            # this procedure to end that mode.
            if self.mode.current.may_move:
                self.mode.require_idle()
            self.procedure = procedure
            self._stops_before, self._begun = self.stops, self._clock.now()
        try:
            with self._clock.busy():
                yield
        finally:
            self.procedure = ""

    @contextlib.contextmanager
    def _halt_on_failure(self, bench: BenchOperations) -> Iterator[None]:
        """Halt the rod and return to idle if the body fails; the failure itself is raised on."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(RefusedError):
                bench.halt()
            self.mode.leave("ended early")
            raise
