"""The supervisor: modes, interlocks, the emergency stop, and the actions that run experiments."""

import contextlib
import dataclasses
import datetime
import math
import re
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_base import InputError, quantity
from mrd_base.config import bench_time_scale, parse_yaml
from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED, BenchNode, run_node, seconds
from mrd_bench_driver.interlocks import HEALTH, HOMING, INTERLOCKS, Snapshot, Tolerances, check
from mrd_bench_driver.modes import Mode, change
from mrd_bench_driver.nodes.peers import Peers
from mrd_bench_driver.procedure import (
    CancelledError,
    Order,
    Outcome,
    Planned,
    Recorded,
    RefusedError,
    Report,
    SetOutcome,
    TrippedError,
    run_experiment,
    run_set,
)
from mrd_interfaces.action import RunExperiment, RunSet
from mrd_interfaces.msg import BenchSamples, BenchState, Recording, ServoState, Setpoint
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.limits import Limits

# How an action ends.
End = TypeVar("End", Outcome, SetOutcome)

# The rod stands at mid-stroke when it is this close, in m.
CENTRED = 5e-4
# The rod counts as standing below this speed, in m/s.
SLOW = 2e-3


@dataclass(frozen=True)
class SupervisorConfig:
    """The section ``supervisor`` of bench.yaml."""

    time_scale: float = bench_time_scale()
    limits: Limits = Limits()
    interlocks: Tolerances = Tolerances()
    tare: bool = quantity(True, doc="whether every experiment begins with a tare of the channels marked for it")
    check: float = quantity(0.01, "ms", "between two looks at the interlocks", lower=0.001, upper=0.02)
    runs: str = quantity("runs", doc="folder of the bags whose goal names none")
    discovery_timeout: float = quantity(10.0, "s", "on the wall, for the other nodes to be seen", lower=0.1, upper=120)
    answer_timeout: float = quantity(5.0, "s", "on the wall, for an answer", lower=0.1, upper=120)
    close_timeout: float = quantity(60.0, "s", "on the wall, for the recorder to close a bag", lower=1, upper=600)
    home_timeout: float = quantity(60.0, "s", "of bench time, for homing", lower=1, upper=600)


class Supervisor(BenchNode[SupervisorConfig]):
    """Interlocks in the node's own executor, whose callbacks never wait; orders, which do, in threads of another.

    A second node in this process takes the orders, as an executor serves whole nodes.
    """

    def __init__(self) -> None:
        super().__init__("supervisor", SupervisorConfig)
        self._lock = threading.RLock()
        self.mode = Mode.IDLE
        self._message = "started"
        self._busy = ""
        self._halt_asked = threading.Event()
        self._acting: list[ServerGoalHandle] = []

        self._latest = Snapshot()  # its ages are filled in when it is looked at
        self.sample_time = -math.inf
        self.sample_period = math.nan
        self._mean: tuple[float, float] = (-math.inf, math.nan)  # time in s and position in m
        self.servo: ServoState | None = None
        self.servo_time = -math.inf
        self._setpoint_time = -math.inf
        self.experiment_state = ""

        self.peers = Peers(self)
        self._state = self.create_publisher(BenchState, "bench_state", LATCHED)
        self._emergency_stop = self.create_publisher(Bool, "emergency_stop", LATCHED)
        self.create_subscription(Bool, "emergency_stop", self._on_emergency_stop, LATCHED)
        self.create_subscription(BenchSamples, "samples", self._on_samples, RECORDED)
        self.create_subscription(ServoState, "servo_state", self._on_servo_state, RECORDED)
        self.create_subscription(Setpoint, "setpoint", self._on_setpoint, COMMAND)
        self.create_subscription(String, "experiment_state", self._on_experiment_state, LATCHED)
        self.create_service(Trigger, "emergency_stop", self._on_stop_service)
        self.create_bench_timer(self.config.check, self._watch)
        self._publish_state()

        self._orders = Node("supervisor_orders", start_parameter_services=False, enable_rosout=False)
        group = ReentrantCallbackGroup()
        for name, kind, work in (
            ("reset_fault", Trigger, self._reset_fault),
            ("home", Trigger, self._home),
            ("stop", Trigger, self._stop),
            ("control", SetBool, self._control),
        ):
            self._orders.create_service(kind, name, _served(work), callback_group=group)
        self._actions = [
            ActionServer(
                self._orders, kind, name, work, callback_group=group, cancel_callback=lambda _goal: CancelResponse.ACCEPT
            )
            for name, kind, work in (
                ("run_experiment", RunExperiment, self._run_experiment),
                ("run_set", RunSet, self._run_set),
            )
        ]
        # One thread works, the others refuse, cancel and stop.
        self._taking = MultiThreadedExecutor(num_threads=8)
        self._taking.add_node(self._orders)
        threading.Thread(target=self._taking.spin, name="orders", daemon=True).start()

    # What is heard

    def _on_samples(self, samples: BenchSamples) -> None:
        count = len(samples.position)
        if not count:
            return
        position, force = np.asarray(samples.position), np.asarray(samples.force)
        first, period = seconds(samples.header.stamp), samples.sample_period
        last_time, last_mean = self._mean
        middle, mean = first + (count - 1) / 2 * period, float(position.mean())
        # Means of whole blocks: the LVDT's noise would make a speed of its own between two samples.
        elapsed = middle - last_time
        self._mean = middle, mean
        self.sample_period = period
        self.sample_time = first + (count - 1) * period
        self._latest = dataclasses.replace(
            self._latest,
            position=_farthest(position),
            force=_farthest(force),
            speed=(mean - last_mean) / elapsed if 0 < elapsed < 0.5 else math.nan,
            current=float(np.mean(samples.coil_current)),
        )
        self._watch()

    def _on_servo_state(self, state: ServoState) -> None:
        self.servo = state
        self.servo_time = seconds(state.header.stamp)
        fault = state.message or "the motor or its driver stopped"
        if state.stopped and not state.fault:
            fault = "its emergency stop is latched"
        self._latest = dataclasses.replace(
            self._latest,
            servo_connected=state.connected,
            servo_fault=fault if state.fault or state.stopped else "",
            servo_position=state.position if state.homed else math.nan,
            servo_speed=state.velocity,
            following_error=state.following_error if state.homed else 0.0,
        )
        self._watch()

    def _on_setpoint(self, _setpoint: Setpoint) -> None:
        self._setpoint_time = self.bench.now()

    def _on_experiment_state(self, state: String) -> None:
        # The first setpoint may follow its announcement.
        self._setpoint_time = max(self._setpoint_time, self.bench.now())
        self.experiment_state = state.data

    def snapshot(self) -> Snapshot:
        """What is known now."""
        now = self.bench.now()
        running = self.mode is Mode.IDENTIFICATION and self.experiment_state == "running"
        return dataclasses.replace(
            self._latest,
            sample_age=now - self.sample_time,
            servo_age=now - self.servo_time,
            setpoint_age=now - self._setpoint_time if running else 0.0,
        )

    # Interlocks, modes and the emergency stop

    def _watch(self) -> None:
        if self.mode.may_move:
            interlocks = HOMING if self.mode is Mode.HOMING else INTERLOCKS
            trip = check(self.snapshot(), self.config.limits, self.config.interlocks, interlocks)
            if trip is not None:
                self._trip(f"interlock {trip.interlock}: {trip.line}")
        elif self.mode is Mode.IDLE and self.servo is not None and self.servo.stopped and not self._busy:
            # A stop from before this node's start.
            self._trip("the servo's emergency stop is latched; call reset_fault")

    def _trip(self, line: str) -> None:
        """Stop everything, at once and for good; the first reason stays."""
        self._emergency_stop.publish(Bool(data=True))
        with self._lock:
            if self.mode is Mode.FAULT:
                return
            self.mode, self._message = Mode.FAULT, line
            self._publish_state()
        self.get_logger().error(f"{line}; stopped")

    def _on_emergency_stop(self, message: Bool) -> None:
        # False clears nothing: only reset_fault does.
        if message.data and self.mode is not Mode.FAULT:
            self._trip("emergency stop on the topic")

    def _on_stop_service(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._trip("emergency stop by the service")
        response.success, response.message = True, "latched; call reset_fault"
        return response

    def enter(self, mode: Mode, message: str) -> None:
        """Change the mode; `RefusedError` when there is no way to it from here."""
        with self._lock:
            if self.mode is Mode.FAULT and mode is not Mode.IDLE:
                raise TrippedError(self._message)
            try:
                self.mode = change(self.mode, mode)
            except InputError as error:
                raise RefusedError(str(error)) from None
            self._message = message
            self._publish_state()

    def _leave(self, message: str) -> None:
        """Back to idle, unless in fault."""
        with self._lock:
            if self.mode.may_move:
                self.enter(Mode.IDLE, message)

    def _publish_state(self) -> None:
        message = BenchState(mode=int(self.mode), message=self._message)
        message.header.stamp = self.stamp()
        self._state.publish(message)

    def interrupted(self) -> None:
        """Raise `TrippedError` or `CancelledError` when what runs must end."""
        if self.mode is Mode.FAULT:
            raise TrippedError(self._message)
        if self._halt_asked.is_set():
            raise CancelledError

    # Services

    @contextlib.contextmanager
    def _alone(self, what: str) -> Iterator[None]:
        with self._lock:
            if self._busy:
                raise RefusedError(f"the bench is busy: {self._busy}; wait for its end or call stop")
            self._busy = what
            self._halt_asked.clear()
        try:
            yield
        finally:
            self._busy = ""

    @contextlib.contextmanager
    def _put_away(self, machine: "Machine") -> Iterator[None]:
        """Halt and go back to idle when what is inside does not end well; its own reason is what is told."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(RefusedError):
                machine.halt()
            self._leave("ended early")
            raise

    def require_idle(self) -> None:
        if self.mode is not Mode.IDLE:
            hint = "remove the cause, then call reset_fault" if self.mode is Mode.FAULT else "call stop first"
            raise RefusedError(f"the bench is in mode {self.mode} ({self._message}); {hint}")

    def _home(self, _request: Trigger.Request) -> str:
        with self._alone("home"):
            machine = Machine(self, self.interrupted)
            machine.prepare()
            with self._put_away(machine):
                self.enter(Mode.HOMING, "home")
                machine.centre(always=True)
            machine.halt()
            self._leave("homed")
        return "the rod stands at mid-stroke"

    def _control(self, request: SetBool.Request) -> str:
        if not request.data:
            return self._stop(request)
        with self._alone("control"):
            machine = Machine(self, self.interrupted)
            machine.prepare()
            with self._put_away(machine):
                self.enter(Mode.HOMING, "control")
                machine.centre()
                self.enter(Mode.CONTROL, "control")
                machine.enable()
        return "the rod follows the topic setpoint"

    def _stop(self, _request: object) -> str:
        self._halt_asked.set()
        machine = Machine(self, self.interrupted)
        try:
            failures = machine.halt_all()
        finally:
            # A procedure that runs leaves its mode itself, once it has put everything away.
            if not self._busy:
                self._leave("stopped")
        if failures:
            raise RefusedError(failures)
        return "stopped"

    def _reset_fault(self, _request: Trigger.Request) -> str:
        with self._alone("reset_fault"):
            if self.mode.may_move:
                raise RefusedError(f"the bench is in mode {self.mode}; call stop first")
            machine = Machine(self, lambda: None)
            self.peers.require(("servo", "daq"), self.config.answer_timeout, lambda: None)
            try:
                machine.recover()
            except RefusedError:
                # Whatever was reset already is latched again.
                self._emergency_stop.publish(Bool(data=True))
                raise
            self._emergency_stop.publish(Bool(data=False))
            if self.mode is Mode.FAULT:
                self.enter(Mode.IDLE, "fault reset")
        return "reset; home or run an experiment to go on"

    # The actions

    def _act(self, goal: ServerGoalHandle, what: str, outcome_type: type[End], work: Callable[["Machine"], End]) -> End:
        """Do a goal's work with the bench for itself, and tell the goal how that ended."""

        def interrupted() -> None:
            self.interrupted()
            if goal.is_cancel_requested:
                raise CancelledError

        self._acting.append(goal)
        try:
            try:
                with self._alone(what):
                    outcome = work(Machine(self, interrupted))
            except RefusedError as error:
                outcome = outcome_type(False, False, str(error))
            self.get_logger().info(outcome.message)
            if outcome.success:
                goal.succeed()
            elif outcome.cancelled and goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
        finally:
            self._acting.remove(goal)
        return outcome

    def _record(self, machine: "Machine", order: Order, report: Report) -> Outcome:
        try:
            return run_experiment(machine, order, report)
        finally:
            self._leave("the experiment ended")

    def _run_experiment(self, goal: ServerGoalHandle) -> RunExperiment.Result:
        request = goal.request

        def report(phase: str, elapsed: float, duration: float) -> None:
            goal.publish_feedback(RunExperiment.Feedback(phase=phase, elapsed=elapsed, duration=duration))

        def work(machine: "Machine") -> Outcome:
            bag = request.bag or self._bag(request.experiment)
            return self._record(machine, Order(request.experiment, str(Path(bag).resolve()), request.seed), report)

        outcome = self._act(goal, "run_experiment", Outcome, work)
        recorded = outcome.recorded
        return RunExperiment.Result(
            success=outcome.success,
            message=outcome.message,
            bag=recorded.bag,
            samples=recorded.samples,
            lost=recorded.lost,
            duration=recorded.duration,
        )

    def _run_set(self, goal: ServerGoalHandle) -> RunSet.Result:
        def work(machine: "Machine") -> SetOutcome:
            orders = self._set(goal.request)

            def report(order: Order, phase: str, elapsed: float = 0.0, duration: float = 0.0) -> None:
                goal.publish_feedback(
                    RunSet.Feedback(
                        experiment=order.name,
                        number=orders.index(order) + 1,
                        phase=phase,
                        elapsed=elapsed,
                        duration=duration,
                    )
                )

            def check(order: Order) -> None:
                report(order, "checking")
                machine.require()
                machine.load(order.experiment)

            return run_set(orders, check, lambda order: self._record(machine, order, partial(report, order)))

        outcome = self._act(goal, "run_set", SetOutcome, work)
        recordings = [
            Recording(
                experiment=order.name,
                complete=run.success,
                bag=run.recorded.bag,
                samples=run.recorded.samples,
                lost=run.recorded.lost,
                duration=run.recorded.duration,
            )
            for order, run in outcome.runs
            if run.recorded.bag
        ]
        return RunSet.Result(success=outcome.success, message=outcome.message, recordings=recordings)

    def _set(self, request: RunSet.Goal) -> list[Order]:
        """The orders of a set; refused before anything is asked of the bench."""
        folder = Path(request.folder or Path(self.config.runs) / f"set-{datetime.datetime.now():%Y%m%d-%H%M%S}").resolve()
        orders: dict[str, Order] = {}
        for number, text in enumerate(request.experiments, 1):
            try:
                name = parse_experiment(text, f"experiment {number}").name
            except InputError as error:
                raise RefusedError(str(error)) from None
            if name in orders:
                raise RefusedError(f"experiment {number}: another one of the set has the name {name}, too; rename one")
            if (folder / name).exists():
                raise RefusedError(f"{folder / name}: exists already and is not overwritten; give another folder")
            orders[name] = Order(text, str(folder / name), request.seed)
        if not orders:
            raise RefusedError("the set has no experiments; give their texts")
        return list(orders.values())

    def _bag(self, experiment: str) -> str:
        try:
            name = str(parse_yaml(experiment, "experiment").get("name"))
        except InputError as error:
            raise RefusedError(str(error)) from None
        # The generator checks the experiment as a whole; here a name need only be no path.
        name = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else "experiment"
        return str(Path(self.config.runs) / f"{name}-{datetime.datetime.now():%Y%m%d-%H%M%S}")

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """The fault, if there is one."""
        problem = self._message if self.mode is Mode.FAULT else ""
        return problem, {"mode": str(self.mode), "doing": self._busy or "nothing"}

    def close(self) -> None:
        """Nothing may go on moving without its interlocks."""
        if self.mode.may_move:
            with contextlib.suppress(Exception):
                self._trip("the supervisor ends")
                time.sleep(0.2)  # the message leaves before the process does
        self.peers.close()
        deadline = time.monotonic() + 2.0
        while self._acting and time.monotonic() < deadline:
            time.sleep(0.01)
        self._taking.shutdown(timeout_sec=2.0)
        self._orders.destroy_node()


class Machine:
    """The bench as `run_experiment` asks for it; every method is called from a thread that may wait."""

    def __init__(self, node: Supervisor, interrupted: Callable[[], None]) -> None:
        self._node = node
        self._interrupted = interrupted
        self._config = node.config

    def _ask(self, service: str, request: Any, timeout: float | None = None) -> Any:
        return self._node.peers.ask(service, request, timeout or self._config.answer_timeout, self._interrupted)

    def _wait(self, condition: Callable[[], bool], timeout: float, failure: str | Callable[[], str]) -> None:
        """Wait for a condition, ``timeout`` bench seconds at most; never less than a wall second for the machine's sake."""
        bench = self._node.bench
        deadline = time.monotonic() + max(bench.wall(timeout), 1.0)
        while not condition():
            self._interrupted()
            if time.monotonic() > deadline:
                raise RefusedError(failure if isinstance(failure, str) else failure())
            time.sleep(min(bench.wall(0.01), 0.01))

    def _servo(self) -> ServoState:
        if self._node.servo is None:
            raise RefusedError("no servo_state came; check the servo node")
        return self._node.servo

    def _require_well(self) -> None:
        config = self._config

        def trip() -> Any:
            return check(self._node.snapshot(), config.limits, config.interlocks, HOMING)

        def silent() -> bool:
            found = trip()
            return found is not None and found.interlock in ("stale samples", "lost servo")

        # Nodes that have just been started need a while to find motor and converter.
        with contextlib.suppress(RefusedError):
            self._wait(lambda: not silent(), self._node.bench.time_scale * config.answer_timeout, "")
        found = trip()
        if found is not None:
            raise RefusedError(f"not armed, {found.interlock}: {found.line}")

    def require(self) -> None:
        """All four nodes are there and the bench is idle."""
        self._node.require_idle()
        self._node.peers.require(
            ("servo", "daq", "generator", "recorder"), self._config.discovery_timeout, self._interrupted
        )

    def prepare(self) -> None:
        """What moving the rod needs: servo and daq are there and well, the bench is idle."""
        self._node.require_idle()
        self._node.peers.require(("servo", "daq"), self._config.answer_timeout, self._interrupted)
        self._require_well()

    def load(self, experiment: str) -> Planned:
        """Plan the experiment."""
        answer = self._ask("load_experiment", LoadExperiment.Request(experiment=experiment), 30.0)
        # What the generator said of the experiment before must not be taken for this one.
        self._wait(lambda: self._node.experiment_state == "loaded", 2.0, "generator: did not announce `loaded`")
        return Planned(answer.duration, answer.rate)

    def sample_at(self, rate: float) -> None:
        """Set the sample rate, and wait for samples of it."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(rate))
        request = SetParameters.Request(parameters=[Parameter(name="rate_hz", value=value)])
        timeout = self._config.answer_timeout
        (result,) = self._node.peers.call("daq/set_parameters", request, timeout, self._interrupted).results
        if not result.successful:
            raise RefusedError(f"daq: {result.reason}")
        self._wait(
            lambda: abs(self._node.sample_period * rate - 1) < 1e-6,
            2.0,
            f"daq: no samples at {rate:g} Hz came; check the converter, or the plant when it is simulated",
        )
        self._require_well()

    def enter(self, mode: Mode) -> None:
        """Change the mode."""
        self._node.enter(mode, "run_experiment")

    def centre(self, *, always: bool = False) -> None:
        """Home, unless the rod is homed and at mid-stroke."""

        def centred() -> bool:
            servo = self._servo()
            return bool(servo.homed and abs(servo.position) < CENTRED)

        if always or not centred():
            self._ask("servo/home", Trigger.Request())
            begun = self._node.bench.now()
            timeout = self._config.home_timeout
            self._wait(
                lambda: self._node.servo_time > begun and centred(),
                timeout,
                f"servo: not homed within {timeout:g} s; the rod stands at {1e3 * self._servo().position:.2f} mm",
            )

    def tare(self) -> None:
        """Tare, as soon as all has been at rest for long enough."""
        if not self._config.tare:
            return
        refusal = "daq: no tare"

        def done() -> bool:
            nonlocal refusal
            answer = self._node.peers.call("daq/tare", Trigger.Request(), self._config.answer_timeout, self._interrupted)
            refusal = f"daq: {answer.message}"
            if not answer.success:
                time.sleep(min(self._node.bench.wall(0.1), 0.1))
            return bool(answer.success)

        self._wait(done, 5.0, lambda: refusal)

    def enable(self) -> None:
        """Switch the drive on."""
        self._ask("servo/enable", SetBool.Request(data=True))
        self._wait(lambda: bool(self._servo().enabled), 2.0, "servo: the drive did not switch on; check the motor's power")

    def start_recording(self, order: Order) -> None:
        """Open the bag."""
        request = StartRecording.Request(bag=order.bag, experiment=order.experiment, seed=order.seed)
        self._ask("start_recording", request)

    def start(self) -> None:
        """Start the setpoints."""
        self._ask("start_experiment", Trigger.Request())

    def watch(self, duration: float, report: Callable[[float], None]) -> None:
        """Wait for the generator's end."""
        node = self._node
        begin = node.bench.now()
        reported = -math.inf
        while node.experiment_state != "done":
            self._interrupted()
            elapsed = node.bench.now() - begin
            if node.experiment_state == "aborted":
                raise RefusedError("the generator aborted the experiment")
            if elapsed > duration + max(2.0, 0.02 * duration) + node.bench.time_scale:
                raise RefusedError(f"the experiment should have ended after {duration:.1f} s; check the generator")
            if time.monotonic() - reported > 0.2:
                node.peers.check("stop_recording")
                reported = time.monotonic()
                report(min(elapsed, duration))
            time.sleep(min(node.bench.wall(0.02), 0.02))

    def settle(self) -> None:
        """Wait for the samples of the last moment."""
        node = self._node
        end = node.bench.now()
        self._wait(lambda: node.sample_time >= end, 1.0, "daq: no samples came after the experiment's end")

    def abort(self) -> None:
        """Stop the setpoints."""
        self._node.peers.ask("abort_experiment", Trigger.Request(), self._config.answer_timeout)

    def halt(self) -> None:
        """Stop the rod, then let the drive go."""
        peers, timeout = self._node.peers, self._config.answer_timeout
        # The drive is switched off whether or not it stopped by itself.
        try:
            peers.ask("servo/stop", Trigger.Request(), timeout)
        finally:
            peers.ask("servo/enable", SetBool.Request(data=False), timeout)

    def halt_all(self) -> str:
        """Stop setpoints and rod, whatever runs; what failed, in one line."""
        failures = []
        runs = self._node.experiment_state in ("loaded", "running")
        for step in (self.halt, self.abort) if runs else (self.halt,):
            try:
                step()
            except RefusedError as error:
                failures.append(str(error))
        return "; ".join(failures)

    def stop_recording(self) -> Recorded:
        """Close the bag."""
        answer = self._node.peers.call("stop_recording", StopRecording.Request(), self._config.close_timeout)
        return Recorded(answer.bag, answer.samples, answer.lost, answer.duration, "" if answer.success else answer.message)

    def recover(self) -> None:
        """Reset servo and daq when the inputs are healthy."""
        config, node = self._config, self._node

        def trip() -> Any:
            return check(node.snapshot(), config.limits, config.interlocks, HEALTH)

        first = trip()
        if first is not None and first.interlock == "stale samples":
            # A converter that failed is started by the reset itself.
            self._ask("daq/reset_fault", Trigger.Request(), 10.0)
        with contextlib.suppress(RefusedError):
            self._wait(lambda: trip() is None, 1.0, "")
        found = trip()
        if found is not None:
            raise RefusedError(f"not reset, {found.interlock}: {found.line}")
        standing = "the rod still moves; reset once it stands"
        self._wait(lambda: abs(self._servo().velocity) < SLOW, 2.0, standing)
        self._ask("servo/reset_fault", Trigger.Request(), 10.0)
        self._ask("daq/reset_fault", Trigger.Request(), 10.0)
        self._wait(
            lambda: not (self._servo().stopped or self._servo().fault),
            2.0,
            "servo: still in fault after its reset; look at its message",
        )


def _farthest(values: np.ndarray[Any, Any]) -> float:
    return float(values[np.argmax(np.abs(values))])


def _served(work: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
    """Callback of a service whose work returns the answer's line, or raises it."""

    def serve(request: Any, response: Any) -> Any:
        try:
            response.message, response.success = work(request), True
        except (RefusedError, TrippedError) as error:
            response.message = str(error)
        except CancelledError:
            response.message = "stopped before its end"
        return response

    return serve


def main() -> None:
    """Run the node."""
    run_node(Supervisor)


if __name__ == "__main__":
    main()
