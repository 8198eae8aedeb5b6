"""The node ``page``: it hears the bench, asks it for what operators want, and serves the page."""

import asyncio
import concurrent.futures
import itertools
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from ament_index_python import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool, String
from std_srvs.srv import SetBool, Trigger

from mrd_base import InputError, from_mapping, quantity, read_node_parameters, read_yaml
from mrd_base.config import node_patterns
from mrd_base.domain import present_domain
from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import (
    BENCH_STATE,
    CONTROL_CYCLE,
    CONTROL_STATE,
    DAQ_STATE,
    DAQ_TARE,
    DIAGNOSE_ON_BENCH,
    DIAGNOSTICS,
    EMERGENCY_STOP,
    EXPERIMENT_STATE,
    HOME,
    LEASE,
    RECORDER_STATE,
    REFUSALS,
    RESET_FAULT,
    RUN_CONTROL,
    RUN_EXPERIMENT,
    SAMPLES,
    SERVO_ENABLE,
    SERVO_STATE,
    SETPOINT,
    STOP,
    Action,
)
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.supervision.config import SupervisorConfig
from mrd_dashboard.access import read_credentials
from mrd_dashboard.audit import AuditLog
from mrd_dashboard.bench_diagnosis import BenchDiagnosis, BenchDiagnosisOutcome, BenchDiagnosisRequest
from mrd_dashboard.bench_view import DAQ, SERVO, BenchView, NodeHealth
from mrd_dashboard.control_right import ControlRight
from mrd_dashboard.dashboard import Dashboard, Progress, RoundProgress, RunOutcome
from mrd_dashboard.guide import Guide
from mrd_dashboard.jobs import Jobs
from mrd_dashboard.recordings import Recordings
from mrd_dashboard.run_queue import Kind, RunQueue
from mrd_dashboard.server import PageServer
from mrd_dashboard.workers import Workers
from mrd_interfaces.action import DiagnoseOnBench, RunExperiment
from mrd_interfaces.msg import BenchSamples, BenchState, ControlCycle, Lease, ServoState
from mrd_trajectory.settings import read_settings

# Wall time in s for a response. Homing takes up to a minute of bench time.
_ANSWER_TIMEOUT, _HOME_TIMEOUT = 30.0, 180.0
# Wall time in s for the reason of a rejection, which comes on a topic of its own.
_REASON_TIMEOUT = 2.0
# Wall time in s without the supervisor in the graph, or with the lease of another one, after which a run is given up, and
# between two looks.
_GONE_AFTER, _LOOK_PERIOD = 10.0, 1.0
_STATUS_FIELDS = ("position", "velocity", "following_error", "bus_voltage", "temperature", "status", "connected", "enabled")
_STATUS_FLAGS = ("homed", "moving", "fault", "stopped", "message")
# The page must never make a publisher of the bench wait: what it misses, it does not draw.
_BEST_EFFORT = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass(frozen=True)
class PageConfig:
    """Section ``page`` of bench.yaml."""

    host: str = quantity("127.0.0.1", doc="address at which the page is served; another than this machine's needs access")
    port: int = quantity(8080, doc="port of the page", lower=1, upper=65535)
    access: str = quantity("", doc="file with password and tokens, written by the tool access; empty: no login")
    names: str = quantity(
        "", doc="names, with spaces between, by which browsers reach the page beside addresses and the names of this machine"
    )
    runs: str = quantity("runs", doc="folder of the recordings")
    experiments: str = quantity("", doc="folder of the experiments to choose from; empty: those that are shipped")
    bench: str = quantity("", doc="bench.yaml with the limits; empty: --params-file, else $MRD_BENCH")
    plant: str = quantity(
        "", doc="plant.yaml of the simulated bench, into which a diagnosis is put; empty: beside bench.yaml"
    )


class RosCommands:
    """Requests to the bench by services and actions, made from the thread of the web server.

    Parameters
    ----------
    node : BenchNode
        The node whose executor receives the answers, in another thread.
    view : BenchView
        What this node hears of the bench.
    """

    def __init__(self, node: BenchNode[Any], view: BenchView) -> None:
        self._node, self._view = node, view
        self._emergency_stop = EMERGENCY_STOP.publisher(node)
        self._services = {
            "end run": (STOP.client(node), Trigger.Request(), _ANSWER_TIMEOUT),
            "home": (HOME.client(node), Trigger.Request(), _HOME_TIMEOUT),
            "tare": (DAQ_TARE.client(node), Trigger.Request(), _ANSWER_TIMEOUT),
            "enable": (SERVO_ENABLE.client(node), SetBool.Request(data=True), _ANSWER_TIMEOUT),
            "disable": (SERVO_ENABLE.client(node), SetBool.Request(data=False), _ANSWER_TIMEOUT),
            "reset fault": (RESET_FAULT.client(node), Trigger.Request(), _ANSWER_TIMEOUT),
        }
        self._runs = {
            kind: (action, action.client(node))
            for kind, action in {"identification": RUN_EXPERIMENT, "control": RUN_CONTROL}.items()
        }
        self._diagnose = DIAGNOSE_ON_BENCH.client(node)
        self._diagnosis: Any = None
        self._refusals: list[str] = []
        REFUSALS.subscription(node, lambda refusal: self._refusals.append(refusal.data))

    def emergency_stop(self) -> None:
        """Send the emergency stop, which servo and DAQ hear without the supervisor, too."""
        self._emergency_stop.publish(Bool(data=True))

    async def call(self, name: str) -> str:
        """Call a service; raise `InputError` with its refusal."""
        client, request, timeout = self._services[name]
        if not client.service_is_ready():
            raise InputError(f"{name}: the bench does not answer; look whether it is up (service {client.srv_name})")
        response = await _answer(client.call_async(request), timeout, name)
        if not response.success:
            raise InputError(f"{name} is refused: {response.message}")
        return f"{name}: {response.message or 'done'}"

    async def run(self, kind: Kind, experiment: str, bag: Path, seed: int, stops: int, progress: Progress) -> RunOutcome:
        """Send an experiment or a hybrid test to the supervisor, and return when it has ended."""
        action, client = self._runs[kind]
        if not client.server_is_ready():
            raise InputError("the bench does not answer; look whether its supervisor is up, then try again")
        self._refusals.clear()
        goal = RunExperiment.Goal(experiment=experiment, bag=str(bag), seed=seed, stops=stops)
        loop = asyncio.get_running_loop()

        def hear(message: Any) -> None:
            # It comes in the thread of the executor; the queue belongs to this one.
            loop.call_soon_threadsafe(progress, message.feedback.phase, message.feedback.elapsed)

        sent = await self._in_executor(partial(client.send_goal_async, goal, feedback_callback=hear))
        handle = await _answer(sent, _ANSWER_TIMEOUT, f"the {action.node}")
        if not handle.accepted:
            raise InputError(await self._reason(action))
        awaited = await self._in_executor(handle.get_result_async)
        result = (await self._while_there(client, awaited)).result
        return RunOutcome(result.success, result.message, result.bag)

    async def diagnose(self, request: BenchDiagnosisRequest, progress: RoundProgress) -> BenchDiagnosisOutcome:
        """Send a diagnosis on the bench to the diagnoser, and return when it has ended."""
        client = self._diagnose
        if not client.server_is_ready():
            raise InputError(
                f"the node diagnoser does not answer; start it: ROS_DOMAIN_ID={present_domain()} ros2 run mrd_diagnosis "
                f"diagnoser --ros-args -r __ns:={self._node.get_namespace()} --params-file {shlex.quote(request.bench)}"
            )
        self._refusals.clear()
        goal = DiagnoseOnBench.Goal(
            model=request.model,
            budget=request.budget,
            folder=str(request.folder.resolve()),
            bench=request.bench,
            runs=list(request.runs),
        )
        loop = asyncio.get_running_loop()

        def hear(message: Any) -> None:
            heard = message.feedback
            loop.call_soon_threadsafe(progress, heard.round, heard.stage, heard.fraction, heard.added)

        sent = await self._in_executor(partial(client.send_goal_async, goal, feedback_callback=hear))
        handle = await _answer(sent, _ANSWER_TIMEOUT, f"the {DIAGNOSE_ON_BENCH.node}")
        if not handle.accepted:
            raise InputError(await self._reason(DIAGNOSE_ON_BENCH))
        self._diagnosis = handle
        awaited = await self._in_executor(handle.get_result_async)
        result = (await self._while_there(client, awaited, "diagnosis")).result
        message = result.message or "the diagnoser failed; look at its log"
        return BenchDiagnosisOutcome(result.success, message, result.why, result.ending)

    def cancel_diagnosis(self) -> None:
        """End the diagnosis on the bench, and what it records."""
        if self._diagnosis is not None and self._node.executor is not None:
            self._node.executor.create_task(self._diagnosis.cancel_goal_async)

    async def _in_executor(self, work: Callable[[], Any]) -> Any:
        """Return the result of a function that the executor of the node calls.

        rclpy notes a goal, without a lock, after it has sent it: in another thread, the answer could be taken before, and be
        lost. Services have a lock.
        """
        if self._node.executor is None:
            raise InputError("the page is still starting; try again")
        done: concurrent.futures.Future[Any] = concurrent.futures.Future()

        def call() -> None:
            if done.set_running_or_notify_cancel():
                try:
                    done.set_result(work())
                except Exception as error:  # raised in the executor, it would end the node
                    done.set_exception(error)

        self._node.executor.create_task(call)
        return await asyncio.wrap_future(done)

    async def _while_there(self, client: Any, future: Any, what: str = "run") -> Any:
        """Wait for the result of a run, or of a diagnosis that records runs, as long as there are the supervisor that runs
        them, which another one could not go on with, and the node that could send the result.
        """
        supervisor = self._view.lease_holder
        result = asyncio.ensure_future(_answer(future, None, f"the {what}"))
        missing = 0.0
        while missing < _GONE_AFTER:
            done, _ = await asyncio.wait({result}, timeout=_LOOK_PERIOD)
            if done:
                return result.result()
            latest = self._view.lease_holder
            supervisor = supervisor or latest
            there = client.server_is_ready() and latest == supervisor
            missing = 0.0 if there else missing + _LOOK_PERIOD
        result.cancel()
        gone = "diagnoser" if what == "diagnosis" and latest == supervisor else "supervisor"
        raise InputError(f"the {gone} has gone in the {what}; look at its log, start the bench again, and try again")

    async def _reason(self, action: Action) -> str:
        prefix = f"{action.name}: "
        for _ in range(int(_REASON_TIMEOUT / 0.05)):
            if reasons := [text.removeprefix(prefix) for text in self._refusals if text.startswith(prefix)]:
                return reasons[-1]
            await asyncio.sleep(0.05)
        return f"the {action.node} has rejected the goal; its log tells why"


async def _answer(future: Any, timeout: float | None, what: str) -> Any:
    """Wait, in the loop of the web server, for a future that the executor of the node completes."""
    bridge: concurrent.futures.Future[Any] = concurrent.futures.Future()
    # It may be cancelled at any moment; an error here would end the node.
    future.add_done_callback(lambda done: bridge.set_result(done) if bridge.set_running_or_notify_cancel() else None)
    try:
        return (await asyncio.wait_for(asyncio.wrap_future(bridge), timeout)).result()
    except TimeoutError:
        raise InputError(f"{what}: no answer within {timeout:g} s; look at the log of the node") from None


class Page(BenchNode[PageConfig]):
    """Hears the bench and serves the page. It takes no part in the time of a simulated bench, and may fail at any time."""

    def __init__(self) -> None:
        super().__init__("page", PageConfig)
        config = self.config
        credentials = read_credentials(config.access) if config.access else None
        bench = bench_file(config.bench, sys.argv)
        plant = Path(config.plant or Path(bench).with_name("plant.yaml")).expanduser()
        supervisor = from_mapping(SupervisorConfig, read_node_parameters(bench, "supervisor"), bench)
        self._view = BenchView(supervisor, read_settings(bench))
        recordings = Recordings(Path(config.runs))
        folder = recordings.folder
        self._workers = Workers()
        self._audit = AuditLog(folder / "audit.jsonl")
        dashboard = Dashboard(
            bench=self._view,
            commands=RosCommands(self, self._view),
            recordings=recordings,
            queue=RunQueue(folder / "queue.json"),
            jobs=Jobs(folder / "results"),
            control=ControlRight(),
            audit=self._audit,
            experiments=_experiments(config.experiments),
            hybrid_test=Path(get_package_share_directory("mrd_bringup"), "config", "control", "hybrid_test.yaml"),
            workers=self._workers,
            bench_file=bench,
            plant=str(plant) if plant.is_file() else "",
            guide=Guide(folder / "guide.json"),
            bench_diagnosis=BenchDiagnosis(folder / "bench_diagnosis.json"),
        )
        self._listen()
        self._server = PageServer(dashboard, config.host, config.port, credentials, config.names)
        self.get_logger().info(f"the page is at {self._server.url}")

    def _listen(self) -> None:
        view = self._view
        LEASE.subscription(self, self._on_lease, _BEST_EFFORT)
        SAMPLES.subscription(self, self._on_samples, _BEST_EFFORT)
        SERVO_STATE.subscription(self, self._on_servo_state, _BEST_EFFORT)
        SETPOINT.subscription(self, lambda message: view.monitor.add_setpoint(seconds(message.header.stamp)), _BEST_EFFORT)
        CONTROL_CYCLE.subscription(self, self._on_control_cycle, _BEST_EFFORT)
        BENCH_STATE.subscription(self, self._on_bench_state)
        for topic, source in ((EXPERIMENT_STATE, "generator"), (CONTROL_STATE, "controller")):
            topic.subscription(self, partial(self._on_experiment_state, source))
        DAQ_STATE.subscription(self, self._on_daq_state)
        RECORDER_STATE.subscription(self, self._on_recorder_state)
        DIAGNOSTICS.subscription(self, self._on_diagnostics)

    def _on_lease(self, lease: Lease) -> None:
        self._view.hear_lease(seconds(lease.header.stamp), lease.holder, lease.since, lease.source)

    def _on_samples(self, block: BenchSamples) -> None:
        time, period = seconds(block.header.stamp), block.sample_period
        series = np.asarray(block.position), np.asarray(block.force), np.asarray(block.coil_current)
        self._view.hear(DAQ)
        self._view.monitor.add_samples(time, period, *series, np.asarray(block.temperature))
        self._view.samples.add(block.sequence, time, period, *series)

    def _on_control_cycle(self, cycle: ControlCycle) -> None:
        self._view.monitor.add_control_cycle(cycle.work, cycle.power)
        self._view.cycles.add(cycle)

    def _on_servo_state(self, state: ServoState) -> None:
        fields = {name: getattr(state, name) for name in (*_STATUS_FIELDS, *_STATUS_FLAGS)}
        self._view.hear(SERVO)
        self._view.monitor.add_servo_status(ServoStatus(seconds(state.header.stamp), **fields))

    def _on_bench_state(self, state: BenchState) -> None:
        self._view.mode, self._view.reason, self._view.stops = Mode(state.mode), state.message, state.stops

    def _on_experiment_state(self, source: str, state: String) -> None:
        self._view.monitor.add_experiment_state(state.data, self._view.bench_time, source)

    def _on_daq_state(self, status: DiagnosticStatus) -> None:
        self._view.monitor.daq_problem = status.message if status.level == DiagnosticStatus.ERROR else ""

    def _on_recorder_state(self, status: DiagnosticStatus) -> None:
        values = {value.key: value.value for value in status.values}
        problem = status.message if status.level == DiagnosticStatus.ERROR else ""
        self._view.hear_recorder(values.get("state", ""), problem, values.get("bag", ""))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        prefix = f"{self.get_namespace().strip('/')}/"
        for status in message.status:
            name = status.name.partition(":")[0]
            if name.startswith(prefix):
                values = {value.key: value.value for value in status.values}
                level = int.from_bytes(status.level, "little")
                self._view.hear_node(name.removeprefix(prefix), NodeHealth(level, status.message, values))

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return no problem, and the address of the page."""
        return "", {"address": self._server.url}

    def close(self) -> None:
        """End the web server. The bench goes on."""
        self._server.close()
        self._workers.close()
        self._audit.close()


def bench_file(named: str, arguments: Sequence[str]) -> str:
    """Return the path of the bench.yaml whose limits the bench has; other nodes may run in other folders.

    Parameters
    ----------
    named : str
        The parameter ``bench``, or "".
    arguments : sequence of str
        Command line of the node: without the parameter, the file with the section ``supervisor`` counts.

    Raises
    ------
    InputError
        When it is unknown: the page must not preview runs by other limits.
    """
    if named:
        return _absolute(named)
    files = [file for option, file in itertools.pairwise(arguments) if option == "--params-file"]
    own = set(node_patterns("supervisor")) - {"/**"}
    found = [file for file in files if own & read_yaml(file).keys()]
    if len(found) > 1:
        raise InputError(f"{' and '.join(found)} both have a section supervisor; name the bench's by the parameter bench")
    if bench := found[0] if found else os.environ.get("MRD_BENCH", ""):
        return _absolute(bench)
    raise InputError(
        "the limits of the bench are unknown; give its bench.yaml by --params-file or the parameter bench, or set MRD_BENCH"
    )


def _absolute(file: str) -> str:
    return str(Path(file).expanduser().absolute())  # beside a link may stand another plant.yaml than beside its target


def _experiments(folder: str) -> Path:
    if folder:
        return Path(folder).expanduser()
    return Path(get_package_share_directory("mrd_bringup"), "config", "experiments")


def main() -> None:
    """Entry point of ``ros2 run mrd_dashboard page``."""
    run_node(Page)


if __name__ == "__main__":
    main()
