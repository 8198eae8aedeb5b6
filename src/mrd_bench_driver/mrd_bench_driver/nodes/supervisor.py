"""The node ``supervisor``: it connects a `Supervisor` with topics, services and actions."""

import contextlib
import dataclasses
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_base import InputError
from mrd_base.lease import is_later, is_timely
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import (
    BENCH_STATE,
    CONTROL,
    CONTROL_CYCLE,
    CONTROL_STATE,
    DAQ_STATE,
    EMERGENCY_STOP,
    EMERGENCY_STOP_SERVICE,
    EXPERIMENT_STATE,
    HOME,
    LEASE,
    RECORDER_STATE,
    RESET_FAULT,
    RUN_CONTROL,
    RUN_EXPERIMENT,
    RUN_SET,
    SAMPLES,
    SERVO_STATE,
    SETPOINT,
    STOP,
    Action,
    Service,
)
from mrd_base.nodes.lease import hear_emergency_stop
from mrd_bench_driver.nodes.peer_clients import PeerClients
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_bench_driver.supervision.errors import CancelledError, RefusedError, TrippedError
from mrd_bench_driver.supervision.modes import BenchMode, Mode
from mrd_bench_driver.supervision.operations import BagSummary
from mrd_bench_driver.supervision.procedure import RunOutcome, SetOutcome
from mrd_bench_driver.supervision.run_requests import RunRequest
from mrd_bench_driver.supervision.supervisor import Supervisor
from mrd_interfaces.action import RunExperiment, RunSet
from mrd_interfaces.msg import BenchSamples, BenchState, ControlCycle, Lease, Recording, ServoState, Setpoint

_STATUS_FIELDS = [field.name for field in dataclasses.fields(ServoStatus) if field.name != "time"]
# Threads for requests: one runs a procedure, the others refuse, cancel and stop.
_REQUEST_THREADS = 8
# Bench time in s between two renewals of the lease.
_RENEWAL = 0.04
# Wall time in s for running actions to end when the node closes.
_CLOSE_TIMEOUT = 2.0
# Bench time in s within which an emergency stop that is heard may be our own.
_ECHO = 0.1


class SupervisorNode(BenchNode[SupervisorConfig]):
    """Watches the interlocks, renews the lease, holds the mode of the bench, and runs experiments.

    Topics are served by the executor of this node, in callbacks that never wait; requests by the threads of another one.

    An executor serves whole nodes, so a second node in this process takes the requests.
    """

    def __init__(self) -> None:
        super().__init__("supervisor", SupervisorConfig)
        self._peers = PeerClients(self)
        self._state = BENCH_STATE.publisher(self)
        self._emergency_stop = EMERGENCY_STOP.publisher(self)
        self._lease = LEASE.publisher(self)
        self._holder, self._since = f"{self.get_fully_qualified_name()} (process {os.getpid()})", self.bench.now()
        self._late, self._stop_sent = 0, -math.inf
        self._renewed = -math.inf
        self._supervisor = Supervisor(self.config, self.bench, self._peers, self._announce, self._send_emergency_stop)
        hear_emergency_stop(self, self._on_emergency_stop)
        LEASE.subscription(self, self._on_lease)
        # First what servo and DAQ say, then what they measure: a cause comes before its consequences.
        DAQ_STATE.subscription(self, self._on_daq_state)
        SERVO_STATE.subscription(self, self._on_servo_state)
        SAMPLES.subscription(self, self._on_samples)
        SETPOINT.subscription(self, self._on_setpoint)
        CONTROL_CYCLE.subscription(self, self._on_control_cycle)
        EXPERIMENT_STATE.subscription(self, partial(self._on_experiment_state, "generator"))
        CONTROL_STATE.subscription(self, partial(self._on_experiment_state, "controller"))
        RECORDER_STATE.subscription(self, self._on_recorder_state)
        EMERGENCY_STOP_SERVICE.serve(self, self._on_emergency_stop_service)
        self.create_bench_timer(self.config.check, self._tick)

        self._active_goals: list[ServerGoalHandle] = []
        self._stops_before: dict[bytes, int] = {}  # number of stops that came before a goal was accepted, by its id
        self._request_node = Node("supervisor_requests", start_parameter_services=False, enable_rosout=False)
        self._create_request_servers()
        self._request_executor = MultiThreadedExecutor(num_threads=_REQUEST_THREADS)
        self._request_executor.add_node(self._request_node)
        self._closing = False
        threading.Thread(target=self._serve_requests, name="requests", daemon=True).start()

    def _serve_requests(self) -> None:
        try:
            self._request_executor.spin()
        finally:
            # After an error, a supervisor that hears no stop must not go on renewing the lease.
            if not self._closing:
                os.kill(os.getpid(), signal.SIGTERM)

    def _create_request_servers(self) -> None:
        supervisor, group = self._supervisor, ReentrantCallbackGroup()

        def control(request: SetBool.Request) -> str:
            return supervisor.control() if request.data else supervisor.stop()

        services: dict[Service, Callable[[Any], str]] = {
            RESET_FAULT: lambda _request: supervisor.reset_fault(),
            HOME: lambda _request: supervisor.home(),
            STOP: lambda _request: supervisor.stop(),
            CONTROL: control,
        }
        for service, work in services.items():
            service.serve(self._request_node, _service_callback(work), callback_group=group)

        def check_experiment(goal: RunExperiment.Goal) -> None:
            supervisor.check_experiment(goal.experiment, goal.bag, goal.seed, goal.stops)

        def check_control(goal: RunExperiment.Goal) -> None:
            supervisor.check_control(goal.experiment, goal.bag, goal.seed, goal.stops)

        def check_set(goal: RunSet.Goal) -> None:
            supervisor.check_set(goal.experiments, goal.folder, goal.seed, goal.stops)

        actions: dict[Action, tuple[Callable[[Any], Any], Callable[[Any], None]]] = {
            RUN_EXPERIMENT: (partial(self._run_one, supervisor.run_experiment), check_experiment),
            RUN_CONTROL: (partial(self._run_one, supervisor.run_control), check_control),
            RUN_SET: (self._run_set, check_set),
        }
        self._action_servers = [
            action.server(
                self._request_node,
                execute,
                callback_group=group,
                goal_callback=self._goal_callback(action.name, check),
                handle_accepted_callback=self._accept,
                cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            )
            for action, (execute, check) in actions.items()
        ]

    def _goal_callback(self, name: str, check: Callable[[Any], None]) -> Callable[[Any], GoalResponse]:
        """Return a callback that rejects a goal for which ``check`` raises `RefusedError`."""

        def accept(goal: Any) -> GoalResponse:
            try:
                check(goal)
            except RefusedError as error:
                self.refuse(name, str(error))
                return GoalResponse.REJECT
            return GoalResponse.ACCEPT

        return accept

    def _accept(self, goal: ServerGoalHandle) -> None:
        # A stop that comes before the goal begins is meant for it.
        self._stops_before[bytes(goal.goal_id.uuid)] = self._supervisor.stops
        goal.execute()

    # Topics and the service emergency_stop

    def _on_samples(self, samples: BenchSamples) -> None:
        self._supervisor.monitor.add_samples(
            seconds(samples.header.stamp),
            samples.sample_period,
            np.asarray(samples.position),
            np.asarray(samples.force),
            np.asarray(samples.coil_current),
            np.asarray(samples.temperature),
        )
        self._supervisor.check_interlocks()

    def _on_servo_state(self, state: ServoState) -> None:
        fields = {name: getattr(state, name) for name in _STATUS_FIELDS}
        self._supervisor.monitor.add_servo_status(ServoStatus(seconds(state.header.stamp), **fields))
        self._supervisor.check_interlocks()

    def _on_setpoint(self, setpoint: Setpoint) -> None:
        # A setpoint that nobody follows must not hide that the others have ended.
        if setpoint.lease == self._supervisor.mode.lease:
            now, stamp = self.bench.now(), seconds(setpoint.header.stamp)
            timely = is_timely(stamp, now, self.config.setpoint_timeout)
            self._supervisor.monitor.add_setpoint(now, 0.0 if timely else now - stamp)

    def _on_control_cycle(self, cycle: ControlCycle) -> None:
        self._supervisor.monitor.add_control_cycle(cycle.work, cycle.power)

    def _on_experiment_state(self, source: str, state: String) -> None:
        self._supervisor.monitor.add_experiment_state(state.data, self.bench.now(), source)

    def _on_recorder_state(self, status: DiagnosticStatus) -> None:
        state = next((value.value for value in status.values if value.key == "state"), "")
        problem = status.message if status.level == DiagnosticStatus.ERROR else ""
        self._supervisor.monitor.add_recorder_state(state, problem, self.bench.now())

    def _on_daq_state(self, status: DiagnosticStatus) -> None:
        self._supervisor.monitor.add_daq_problem(status.message if status.level == DiagnosticStatus.ERROR else "")
        self._supervisor.check_interlocks()

    def _on_lease(self, lease: Lease) -> None:
        age, age_of_other = self.bench.now() - self._since, seconds(lease.header.stamp) - lease.since
        if is_later(self._holder, age, lease.holder, age_of_other):
            self.ending = InputError(
                f"{lease.holder} supervises this bench already; stop it, or give this one another namespace or domain"
            )

    def _tick(self) -> None:
        """Check the interlocks and, as long as they are checked, renew the lease."""
        self._supervisor.tick()
        now = self.bench.now()
        if now - self._renewed > _RENEWAL - self.config.check / 2:
            self._renew_lease(self._supervisor.mode)

    def _renew_lease(self, mode: BenchMode) -> None:
        # Mode and number are of one instant, and no renewal with an earlier mode comes after a change.
        with mode.lock:
            self._renewed = self.bench.now()
            lease = Lease(
                holder=self._holder, since=self._since, mode=int(mode.current), number=mode.lease, source=mode.source
            )
            lease.header.stamp = self.stamp(self._renewed)
            self._lease.publish(lease)

    def _on_emergency_stop(self, message: Bool) -> None:
        # False has no effect: only reset_fault releases the stop. In a fault, this message may be our own; else it must
        # not be missed there either, because a reset may be under way.
        if message.data and (self._supervisor.mode.current is not Mode.FAULT or self.bench.now() > self._stop_sent + _ECHO):
            self._supervisor.emergency_stop("emergency stop on the topic")

    def _on_emergency_stop_service(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._supervisor.emergency_stop("emergency stop by the service")
        response.success, response.message = True, "latched; call reset_fault"
        return response

    def _send_emergency_stop(self, stop: bool) -> None:
        self._stop_sent = self.bench.now()
        self._emergency_stop.publish(Bool(data=stop))

    def _announce(self, mode: BenchMode, stops: int) -> None:
        # Servo and DAQ hear of the mode first: whoever reads the state and calls a stop means this mode.
        self._renew_lease(mode)
        message = BenchState(mode=int(mode.current), message=mode.reason, stops=stops)
        message.header.stamp = self.stamp()
        self._state.publish(message)
        if mode.current is Mode.FAULT:
            self.get_logger().error(f"{mode.reason}; stopped")

    # Actions

    def _run_one(self, run: Callable[..., RunOutcome], goal: ServerGoalHandle) -> RunExperiment.Result:
        request = goal.request

        def progress(phase: str, elapsed: float, duration: float) -> None:
            goal.publish_feedback(RunExperiment.Feedback(phase=phase, elapsed=elapsed, duration=duration))

        with self._active(goal) as cancelled:
            outcome = run(request.experiment, request.bag, request.seed, progress, cancelled)
            self._end(goal, outcome)
        return RunExperiment.Result(success=outcome.success, message=outcome.message, **_bag_fields(outcome.recorded))

    def _run_set(self, goal: ServerGoalHandle) -> RunSet.Result:
        request = goal.request

        def progress(number: int, run: RunRequest, phase: str, elapsed: float, duration: float) -> None:
            goal.publish_feedback(
                RunSet.Feedback(experiment=run.name, number=number, phase=phase, elapsed=elapsed, duration=duration)
            )

        with self._active(goal) as cancelled:
            outcome = self._supervisor.run_set(request.experiments, request.folder, request.seed, progress, cancelled)
            self._end(goal, outcome)
        recordings = [
            Recording(experiment=run.name, complete=run_outcome.success, **_bag_fields(run_outcome.recorded))
            for run, run_outcome in outcome.runs
            if run_outcome.recorded.bag
        ]
        return RunSet.Result(success=outcome.success, message=outcome.message, recordings=recordings)

    @contextlib.contextmanager
    def _active(self, goal: ServerGoalHandle) -> Iterator[Callable[[], bool]]:
        """Keep a goal among those that run; yields what tells whether it is cancelled, or the bench stopped."""
        self._active_goals.append(goal)
        before = self._stops_before.pop(bytes(goal.goal_id.uuid))
        try:
            yield (
                lambda: (
                    goal.is_cancel_requested
                    or self._supervisor.stops != before
                    # A stop that came between check and acceptance.
                    or self._supervisor.stopped_since(goal.request.stops)
                )
            )
        finally:
            self._active_goals.remove(goal)

    def _end(self, goal: ServerGoalHandle, outcome: RunOutcome | SetOutcome) -> None:
        """Log how a goal ended, and tell its client."""
        self.get_logger().info(outcome.message)
        if outcome.success:
            goal.succeed()
        elif outcome.cancelled and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()

    # The base of a node

    def warning(self) -> str:
        """Return how many cycles were late since the last call."""
        before, self._late = self._late, self._supervisor.late_cycles
        late = self._late - before
        return f"{late} cycles were more than {1e3 * self.config.late:g} ms late; this machine is busy" if late > 0 else ""

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return the fault, if there is one, and the mode."""
        mode = self._supervisor.mode
        problem = mode.reason if mode.current is Mode.FAULT else ""
        return problem, {"mode": str(mode.current), "procedure": self._supervisor.procedure or "none"}

    def close(self) -> None:
        """Stop the bench if the rod may move: it must not go on without its interlocks."""
        if self._supervisor.mode.current.may_move:
            with contextlib.suppress(Exception):
                self._supervisor.emergency_stop("the supervisor ends")
                time.sleep(0.2)  # the message must leave before the process ends
        self._peers.close()
        deadline = time.monotonic() + _CLOSE_TIMEOUT
        while self._active_goals and time.monotonic() < deadline:
            time.sleep(0.01)
        self._closing = True
        self._request_executor.shutdown(timeout_sec=2.0)
        self._request_node.destroy_node()


def _bag_fields(recorded: BagSummary) -> dict[str, Any]:
    """Return the fields of a bag that the messages RunExperiment.Result and Recording share."""
    fields = dataclasses.asdict(recorded)
    del fields["problem"]
    return fields


def _service_callback(work: Callable[[Any], str]) -> Callable[[Any, Any], Any]:
    """Return a callback of a service; ``work`` returns the message of success or raises that of a failure."""

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
    run_node(SupervisorNode)


if __name__ == "__main__":
    main()
