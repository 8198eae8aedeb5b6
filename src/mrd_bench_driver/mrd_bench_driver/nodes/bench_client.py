"""A client of the bench: it waits until the nodes are up, and lets the supervisor run experiments."""

import os
import select
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionClient
from rclpy.action.client import ClientGoalHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool

from mrd_base import BenchClock, InputError
from mrd_base.barrier_clock import BarrierClock
from mrd_base.domain import claim_name, present_domain
from mrd_base.nodes.graph import (
    BENCH_STATE,
    DIAGNOSE_ON_BENCH,
    DIAGNOSTICS,
    EMERGENCY_STOP,
    NODES,
    RECORDER_STATE,
    REFUSALS,
    RUN_CONTROL,
    RUN_EXPERIMENT,
    RUN_SET,
    START_RECORDING,
    STOP_RECORDING,
    Action,
    Service,
)
from mrd_bench_driver.processes import ProcessDiedError
from mrd_interfaces.action import DiagnoseOnBench, RunExperiment, RunSet
from mrd_interfaces.msg import BenchState

# Wall time in s for all nodes to come up; the first start after an installation compiles for some 20 s, or longer on a busy
# machine. Nobody waits so long for a process that has died: the watch of the client sees it.
START_TIMEOUT = 180.0
# Wall time in s for the supervisor to accept a goal.
ACCEPT_TIMEOUT = 30.0
# Wall time in s for a cancelled experiment to end; it includes the time in which the recorder may close its bag.
CANCEL_TIMEOUT = 90.0

# Wall time in s for rod and recording to end after a node has died: without its supervisor, only for the rod to stand; else
# also for the supervisor to end the run.
_REST_TIMEOUT, _END_TIMEOUT = 1.0, 5.0
# Wall time in s without diagnostics of the supervisor, which come every second, after which nobody waits for it any more.
_SUPERVISOR_SILENCE = 20.0
# Wall time in s in which ROS finds the nodes of another bench.
_DISCOVERY_TIME = 5.0
# Wall time in s for the reason of a rejection, which comes on a topic of its own.
_REASON_TIMEOUT = 2.0
# Nodes that a namespace may have besides a bench.
_GUESTS = {"replay", "identifier", "diagnoser", "page"}

# Receives the feedback messages of an action.
Feedback = Callable[[Any], None]


def ignore_feedback(_feedback: Any) -> None:
    """Do nothing with a feedback."""


def require_free_namespace(namespace: str) -> None:
    """Raise `InputError` if a bench is up in a namespace of this ROS domain: two benches would command each other.

    On this machine, the namespace is then kept for this process.
    """
    if claim_name(namespace) is None:
        raise _occupied(namespace, "which starts or runs on this machine")
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(f"bench_check_{os.getpid()}", context=context, start_parameter_services=False, enable_rosout=False)
    deadline = time.monotonic() + _DISCOVERY_TIME
    found: list[str] = []
    while not found and time.monotonic() < deadline:
        time.sleep(0.05)
        names = node.get_node_names_and_namespaces()
        found = sorted(name for name, its_namespace in names if its_namespace == namespace and name in set(NODES) - _GUESTS)
    node.destroy_node()
    context.try_shutdown()
    if found:
        raise _occupied(namespace, ", ".join(found))


def _occupied(namespace: str, how: str) -> InputError:
    return InputError(
        f"namespace {namespace} of ROS domain {present_domain()} is occupied by another bench "
        f"({how}); end that one, or choose another --namespace or ROS_DOMAIN_ID"
    )


class BenchClient:
    """Client of the supervisor's actions, with a ROS context of its own.

    Parameters
    ----------
    namespace : str
        Namespace of the bench's nodes.
    watch : callable
        Called often during waits; an exception that it raises ends the wait.
    clock : Path, optional
        Socket of the bench time of a simulated bench. Its time does not begin before the first experiment, or
        `let_time_pass`: the same experiments with the same seed are therefore the same runs, bit by bit.

    Attributes
    ----------
    time : BenchClock
        Clock of bench time, once the nodes are up.
    stops : int
        The count of stops that the supervisor has told latest, never 0 once it is up. A run that is asked for with an
        earlier one, or with that of an earlier supervisor, is refused.
    """

    def __init__(
        self, namespace: str = "/bench", watch: Callable[[], None] = lambda: None, clock: Path | None = None
    ) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(f"bench_client_{os.getpid()}", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._watch, self._clock = watch, clock
        self._held = False
        self.time = BenchClock()
        self._run_experiment = RUN_EXPERIMENT.client(self.node)
        self._run_control = RUN_CONTROL.client(self.node)
        self._run_set = RUN_SET.client(self.node)
        self._diagnose_on_bench = DIAGNOSE_ON_BENCH.client(self.node)
        self._emergency_stop = EMERGENCY_STOP.publisher(self.node)
        self._nodes_up: set[str] = set()
        self._page_address = ""
        self._supervisor_heard = time.monotonic()  # wall time of its latest diagnostics
        DIAGNOSTICS.subscription(self.node, self._on_diagnostics)
        self.stops = 0
        BENCH_STATE.subscription(self.node, self._on_bench_state)
        self._recording = False
        RECORDER_STATE.subscription(self.node, self._on_recorder_state)
        self._refusals: list[str] = []
        REFUSALS.subscription(self.node, lambda refusal: self._refusals.append(refusal.data))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        namespace = self.node.get_namespace().strip("/")
        values = {status.name.partition(":")[0]: status.values for status in message.status}
        self._nodes_up |= values.keys()
        for entry in values.get(f"{namespace}/page", ()):
            if entry.key == "address":
                self._page_address = entry.value
        if f"{namespace}/supervisor" in values:
            self._supervisor_heard = time.monotonic()

    def _on_bench_state(self, state: BenchState) -> None:
        self.stops = state.stops

    def _on_recorder_state(self, status: DiagnosticStatus) -> None:
        self._recording = any(value.value in ("recording", "stopping") for value in status.values if value.key == "state")

    def __enter__(self) -> "BenchClient":
        return self

    def __exit__(self, *_error: object) -> None:
        if isinstance(self.time, BarrierClock):
            self.time.leave()
        self._run_experiment.destroy()
        self._run_control.destroy()
        self._run_set.destroy()
        self._diagnose_on_bench.destroy()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def spin(self, until: Callable[[], bool], timeout: float, *, watch: bool = True) -> bool:
        """Process messages until a condition holds, for at most ``timeout`` wall seconds; return whether it holds."""
        deadline = time.monotonic() + timeout
        while not until():
            if time.monotonic() > deadline:
                return False
            if watch:
                self._watch()
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def wait_until_up(self, names: set[str], timeout: float = START_TIMEOUT) -> None:
        """Wait until all nodes work and the supervisor is ready; on a real bench, their diagnostics show it."""
        namespace = self.node.get_namespace().strip("/")
        begun = self._join_simulated_bench(timeout) if self._clock else lambda: False
        actions = self._run_experiment, self._run_control, self._run_set

        def missing() -> list[str]:
            nodes = sorted(name for name in names if f"{namespace}/{name}" not in self._nodes_up and not begun())
            if nodes or (self.stops and all(action.server_is_ready() for action in actions)):
                return nodes
            return ["the actions of the supervisor"]

        if not self.spin(lambda: not missing(), timeout):
            raise InputError(
                f"the bench did not come up within {timeout:g} s: {', '.join(missing())} missing; look at the logs"
            )

    def _join_simulated_bench(self, timeout: float) -> Callable[[], bool]:
        """Take part in the time of a simulated bench; return whether all others do, too."""
        assert self._clock is not None
        if not self.spin(self._clock.exists, timeout):
            raise InputError(f"the simulated plant did not come up within {timeout:g} s; look at its log")
        clock = BarrierClock(self._clock, "bench")
        clock.hold()
        clock.join()
        self.time, self._held = clock, True
        return clock.begun.is_set

    def let_time_pass(self) -> None:
        """Let the time of a simulated bench begin."""
        if self._held:
            self._held = False
            self.time.release()

    def _hold_time(self) -> None:
        """Let the time of a simulated bench, at whose page nobody looks, stand still."""
        if isinstance(self.time, BarrierClock) and not self._held and not self._page_address:
            self._held = True
            self.time.hold()

    def stay_up(self, *, page: bool = False) -> None:
        """Let others use the bench until ``watch`` raises an exception; when a node has died, stop everything at once.

        With ``page``, print the address of the operator's page once it is served.
        """
        self.let_time_pass()
        try:
            if page:
                self.spin(lambda: bool(self._page_address), float("inf"))
                print(f"the operator's page is at {self._page_address}", flush=True)
            self.spin(lambda: False, float("inf"))
        except ProcessDiedError as died:
            self._stop_everything(died, lambda: not self._recording)
            raise

    def _stop_everything(self, died: ProcessDiedError, ended: Callable[[], bool]) -> None:
        """Stop at once, and wait for the rod and for the end of what runs.

        Nobody waits for the dead: neither for a supervisor that ends no goal, nor for one that calls a dead node.
        """
        self._emergency_stop.publish(Bool(data=True))
        begin = time.monotonic()
        self.spin(ended, _REST_TIMEOUT if died.name == "supervisor" else _END_TIMEOUT, watch=False)
        # The message must leave, and the rod stand, also where nothing was recorded.
        self.spin(lambda: False, _REST_TIMEOUT - (time.monotonic() - begin), watch=False)

    def run_experiment(
        self, experiment: str, bag: Path, seed: int, feedback: Feedback = ignore_feedback, stops: int = 0
    ) -> Any:
        """Run an experiment, given by the text of its file, and return the result of the action.

        The result of a goal that is rejected has no success, and the reason as its message. If ``watch`` raises an exception
        meanwhile, the experiment is cancelled, and its end is awaited before the exception is raised on. If it tells by
        `ProcessDiedError` that a node has died, everything is stopped at once. Where ``stops`` is an earlier `stops` of this
        client, a stop since then refuses the goal.
        """
        goal = RunExperiment.Goal(experiment=experiment, bag=str(bag), seed=seed, stops=stops)
        return self._run(RUN_EXPERIMENT, self._run_experiment, goal, feedback)

    def run_control(self, experiment: str, bag: Path, seed: int, feedback: Feedback = ignore_feedback) -> Any:
        """Run a hybrid test, given by the text of its file; otherwise as `run_experiment`."""
        goal = RunExperiment.Goal(experiment=experiment, bag=str(bag), seed=seed)
        return self._run(RUN_CONTROL, self._run_control, goal, feedback)

    def run_set(
        self, experiments: list[str], folder: Path, seed: int, feedback: Feedback = ignore_feedback, stops: int = 0
    ) -> Any:
        """Run experiments one after the other, each into its own bag in the folder; otherwise as `run_experiment`."""
        goal = RunSet.Goal(experiments=experiments, folder=str(folder), seed=seed, stops=stops)
        return self._run(RUN_SET, self._run_set, goal, feedback)

    def diagnose_on_bench(self, goal: DiagnoseOnBench.Goal, feedback: Feedback = ignore_feedback) -> Any:
        """Let the node `diagnoser` record and diagnose in turn; otherwise as `run_experiment`.

        While nothing is recorded, the time of a simulated bench stands still: the processor is free for the diagnosis.
        """
        if not self.spin(self._diagnose_on_bench.server_is_ready, START_TIMEOUT):
            raise InputError(f"the node diagnoser did not come up within {START_TIMEOUT:g} s; look at its log")

        def on_feedback(message: Any) -> None:
            if message.moves:
                self.let_time_pass()
            else:
                self._hold_time()
            feedback(message)

        return self._send(DIAGNOSE_ON_BENCH, self._diagnose_on_bench, goal, on_feedback)

    def record_by_hand(self, bag: Path, duration: float) -> None:
        """Record so many s of bench time while nothing is commanded: drive and coil are off, and a person acts.

        Raises
        ------
        InputError
            Where the recorder refuses, or samples are lost, with the reason.
        """
        self._call(START_RECORDING, bag=str(bag))
        try:
            self.let_time_pass()
            end = self.time.now() + duration
            self.spin(lambda: self.time.now() > end, float("inf"))
        finally:
            self._call(STOP_RECORDING)
            self._hold_time()

    def read_line(self) -> str:
        """Return the next line that a person types, without its end; ``q`` at the end of the input. Meanwhile the bench is
        watched.
        """
        self.spin(lambda: bool(select.select([sys.stdin], [], [], 0.0)[0]), float("inf"))
        return (sys.stdin.readline() or "q").strip()

    def _call(self, service: Service, **fields: Any) -> None:
        client = service.client(self.node)
        response = None
        if self.spin(client.service_is_ready, ACCEPT_TIMEOUT):
            called = client.call_async(service.type.Request(**fields))
            response = called.result() if self.spin(called.done, ACCEPT_TIMEOUT, watch=False) else None
        client.destroy()
        if response is None or not response.success:
            raise InputError(response.message if response else f"{service.node} does not answer; look at its log")

    def _run(self, action: Action, client: ActionClient, goal: Any, feedback: Feedback) -> Any:
        def on_feedback(message: Any) -> None:
            self.let_time_pass()  # the supervisor has begun
            feedback(message)

        return self._send(action, client, goal, on_feedback)

    def _send(self, action: Action, client: ActionClient, goal: Any, feedback: Feedback) -> Any:
        self._watch()  # what has come before the goal is sent, needs no end of it
        self._refusals.clear()
        accepted = client.send_goal_async(goal, feedback_callback=lambda message: feedback(message.feedback))
        # What comes from here on, ends the goal below.
        if not self.spin(accepted.done, ACCEPT_TIMEOUT, watch=False):
            raise InputError(f"the {action.node} did not accept the goal within {ACCEPT_TIMEOUT:g} s; look at its log")
        handle: ClientGoalHandle = accepted.result()
        if not handle.accepted:
            return action.type.Result(message=self._reason(action))
        ended = handle.get_result_async()
        self._supervisor_heard = time.monotonic()

        def done() -> bool:
            # Stopped by a signal, or hanging, it would never end the goal. Servo and DAQ have stopped by themselves.
            silence = time.monotonic() - self._supervisor_heard
            if silence > _SUPERVISOR_SILENCE:
                raise ProcessDiedError("supervisor", f"supervisor has been silent for {silence:.0f} s; look at its log")
            return bool(ended.done())

        try:
            self.spin(done, float("inf"))
        except ProcessDiedError as died:
            self._stop_everything(died, ended.done)
            raise
        except BaseException:
            handle.cancel_goal_async()
            self.spin(ended.done, CANCEL_TIMEOUT, watch=False)
            raise
        return ended.result().result

    def _reason(self, action: Action) -> str:
        """Return why a goal was rejected."""
        prefix = f"{action.name}: "

        def reasons() -> list[str]:
            return [text.removeprefix(prefix) for text in self._refusals if text.startswith(prefix)]

        self.spin(lambda: bool(reasons()), _REASON_TIMEOUT)
        return reasons()[-1] if reasons() else f"the {action.node} has rejected the goal; its log tells why"
