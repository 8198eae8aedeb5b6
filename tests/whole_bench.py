"""The whole bench as processes, for the tests of this folder and the fault campaign."""

import contextlib
import dataclasses
import re
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from mrd_base.nodes.bench_node import LATCHED, RECORDED, seconds
from mrd_base.nodes.graph import EMERGENCY_STOP
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_bench_driver.processes import BenchProcesses, bench_processes, clock_of
from mrd_diagnosis.sequential.first_set import first_set
from mrd_interfaces.action import RunExperiment
from mrd_interfaces.msg import AnalogOutput, BenchState, ServoState, Setpoint
from mrd_runs.bag_import import write_bag
from mrd_sim.plant import read_damper
from mrd_sim.simulate import measure_plans
from mrd_trajectory.settings import read_settings

ROOT = Path(__file__).resolve().parents[1]
BENCH, PLANT = ROOT / "config/bench.yaml", ROOT / "config/plant.yaml"

SLOW = 2e-3
"""m/s; the rod counts as stopped below it."""


def simulate_first_round(folder: Path) -> None:
    """Write what a diagnosis on the bench records first, simulated without the bench."""
    damper, rng, plans = read_damper(PLANT).build(), np.random.default_rng(1), first_set(read_settings(BENCH))
    for run in [*measure_plans(plans[:1], damper, rng), *measure_plans(plans[1:], damper, rng)]:
        columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
        write_bag(columns, [], Path("simulated"), folder / run.name)


def without_progress(errors: str) -> list[str]:
    """Return the lines of stderr but those of the progress, which a bench slowed down by other work has time to print."""
    return [line for line in errors.splitlines() if not re.search(r", \d+ %(, about \d+ s left)?$", line)]


class WholeBench:
    """All nodes with a simulated plant, and a client. The client takes part in the bench time, so that it can stop it.

    Parameters
    ----------
    folder : Path
        Folder of the logs.
    parameters : mapping, optional
        Parameters of nodes that differ from the shipped files.
    control_cycle : float, optional
        Time in s between two setpoints of a hybrid test, for which the bench then has a controller.
    diagnoser : bool
        Whether the bench has a diagnoser.
    environment : str
        Environment variables of the nodes.
    """

    def __init__(
        self,
        folder: Path,
        parameters: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        control_cycle: float | None = None,
        diagnoser: bool = False,
        **environment: str,
    ) -> None:
        self._folder = folder
        specs = bench_processes(BENCH, PLANT, folder / "motor", seed=1, control_cycle=control_cycle, diagnoser=diagnoser)
        # The procedure asks a killed node to stop, too. Its silence ends the wait sooner than by default.
        given = {"supervisor": {"answer_timeout_s": 2.5, "close_timeout_s": 15.0}, **(parameters or {})}
        specs = [
            dataclasses.replace(spec, parameters={**spec.parameters, **given.get(spec.executable, {})}) for spec in specs
        ]
        self.processes = BenchProcesses(specs, folder / "log", environment=environment)

    def __enter__(self) -> "WholeBench":
        self.processes.__enter__()
        try:
            self._connect()
        except BaseException:
            self.processes.close()
            raise
        return self

    def _connect(self) -> None:
        self.client = BenchClient(watch=self.processes.check, clock=clock_of(self._folder / "motor"))
        self.client.wait_until_up(set(self.processes.specs))
        # These are created beforehand: how long ROS takes to match a client is no part of how long the rod takes to stop.
        self.plant = self.client.node.create_client(SetParameters, "plant/set_parameters")
        self.truth: list[JointState] = self.subscribe("plant/true_state", JointState, RECORDED)
        self.servo: list[ServoState] = self.subscribe("servo_state", ServoState, RECORDED)
        self.modes: list[BenchState] = self.subscribe("bench_state", BenchState, LATCHED)
        self.output: list[AnalogOutput] = self.subscribe("analog_output", AnalogOutput, LATCHED)
        self.up: set[str] = set()
        """Nodes whose diagnostics have come."""
        self.client.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)
        self._actions: dict[str, ActionClient] = {}
        self._logged: dict[str, int] = {}
        self._lasting = [end for end, _ in self._ends()]
        self._make_button()
        assert self.client.spin(lambda: self.plant.service_is_ready(), 10)
        self.clock = self.client.time
        self.client.let_time_pass()

    def __exit__(self, *_error: object) -> None:
        for action in self._actions.values():
            action.destroy()
        self.client.__exit__()
        self.processes.close()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.up |= {status.name.partition(":")[0].rpartition("/")[2] for status in message.status}

    def _ends(self) -> list[tuple[Any, Callable[[Any], object]]]:
        """Return what the client publishes, hears and calls, each with what destroys it."""
        node = self.client.node
        return [
            *((subscription, node.destroy_subscription) for subscription in node.subscriptions),
            *((publisher, node.destroy_publisher) for publisher in node.publishers),
            *((client, node.destroy_client) for client in node.clients),
        ]

    def _make_button(self) -> None:
        self.button = self.client.node.create_publisher(Bool, "emergency_stop", LATCHED)
        heard = 2 * len(set(EMERGENCY_STOP.subscribers) & set(self.processes.specs))  # reliably, and best effort
        assert self.client.spin(lambda: self.button.get_subscription_count() >= heard, 30)

    def mend(self) -> None:
        """Bring the bench to where a test may begin: nothing is broken, every node is heard, it rests in mode idle.

        A node that has ended by itself is no matter of mending. What the client made since the start is destroyed: a node
        that starts later would hear the emergency stop of a publisher that is still there.
        """
        self.processes.check()
        for end, destroy in self._ends():
            if end not in self._lasting:
                destroy(end)
        self.client.let_time_pass()  # it stands still after a diagnosis
        for process in self.processes.running.values():
            process.send_signal(signal.SIGCONT)
        # The time of the bench goes on without a node that was paused: it would be late for ever.
        left_behind = set(
            re.findall(r"(\w+) (?:was stopped|hangs|has not finished).*; the bench goes on", self.log("plant"))
        )
        for name in left_behind & self.processes.running.keys():
            self.processes.kill(name)
        gone = self.processes.specs.keys() - self.processes.running.keys()
        for name in gone:
            self.processes.start(name)
        self.await_up(gone)
        self.set_fault("")
        problem = self.reset()
        assert not problem, problem
        self.truth.clear()
        self.servo.clear()
        assert self.client.spin(self._rests, 20), "the bench does not rest"
        self._make_button()
        self._logged = {name: self.processes.log(name).stat().st_size for name in self.processes.specs}

    def _rests(self) -> bool:
        """Whether the motor is connected, the rod stands, and the coil has no current."""
        if not (self.truth and self.servo):
            return False
        true = self.truth[-1]
        return self.servo[-1].connected and abs(true.velocity[0]) < SLOW and true.effort[1] < 0.02

    def log(self, name: str) -> str:
        """Return what a node has logged in this test."""
        return self.processes.log(name).read_bytes()[self._logged.get(name, 0) :].decode(errors="replace")

    def service(self, name: str, kind: Any = Trigger, timeout: float = 30.0, **fields: Any) -> Any:
        client = self.client.node.create_client(kind, name)
        assert self.client.spin(client.service_is_ready, min(timeout, 10.0), watch=False), f"no service {name}"
        response = self.call(client, kind.Request(**fields), timeout)
        self.client.node.destroy_client(client)
        return response

    def await_up(self, names: Set[str]) -> None:
        """Wait for nodes that were started again. ROS takes the dead for alive for 20 s, so that services prove nothing."""
        self.up -= names
        assert self.client.spin(lambda: names <= self.up, 90, watch=False), f"{names - self.up} do not come up again"

    def reset(self) -> str:
        """Reset the bench; return why this fails, or ""."""
        message, deadline = "", time.monotonic() + 60
        while time.monotonic() < deadline:
            try:
                response = self.service("reset_fault")
            except AssertionError as error:
                message = str(error)
                continue
            message = response.message
            if response.success:
                idle = self.client.spin(lambda: self.modes[-1].mode == BenchState.IDLE, 10)
                return "" if idle else f"mode {self.modes[-1].mode} after the reset"
            self.client.spin(lambda: False, 0.3, watch=False)
        return f"not reset: {message}"

    def subscribe(self, topic: str, message_type: type, qos: object) -> list:
        """Return the list to which the messages of a topic are appended."""
        messages: list = []
        self.client.node.create_subscription(message_type, topic, messages.append, qos)
        return messages

    def call(self, client: Any, request: Any, timeout: float = 15.0) -> Any:
        response = client.call_async(request)
        assert self.client.spin(response.done, timeout, watch=False), f"no response from {client.srv_name}"
        return response.result()

    def setpoint_of_now(self, **fields: Any) -> Setpoint:
        """Return a setpoint that is stamped with the present bench time."""
        message = Setpoint(**fields)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(1e9 * self.clock.now()), 10**9)
        return message

    def set_fault(self, name: str) -> None:
        """Break something in the plant, or repair it with ""."""
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=name)
        response = self.call(self.plant, SetParameters.Request(parameters=[Parameter(name="fault", value=value)]))
        assert response.results[0].successful

    def run_at_speed(self, experiment: str, bag: Path, action: str = "run_experiment") -> Any:
        """Send an experiment; return the future of its result once the rod moves fast and did so already 0.3 s ago."""
        if action not in self._actions:
            self._actions[action] = ActionClient(self.client.node, RunExperiment, action)
        client = self._actions[action]
        assert self.client.spin(client.server_is_ready, 10)
        accepted = client.send_goal_async(RunExperiment.Goal(experiment=experiment, bag=str(bag)))
        assert self.client.spin(accepted.done, 10)
        ended = accepted.result().get_result_async()
        first_fast: list[float] = []

        def fast() -> bool:
            # Homing is slower, so the experiment runs.
            if not self.truth or abs(self.truth[-1].velocity[0]) < 0.04:
                return False
            first_fast.append(seconds(self.truth[-1].header.stamp))
            return first_fast[-1] - first_fast[0] > 0.3

        assert self.client.spin(lambda: fast() or ended.done(), 120), "the rod never moved"
        assert not ended.done(), ended.result().result.message
        return ended

    def time_to_rest(self, begun: float, watched: float = 1.0) -> float:
        """Watch the rod for some seconds after a bench time; return how long it moved, in bench s."""
        truth = self.truth
        self.client.spin(lambda: seconds(truth[-1].header.stamp) > begun + watched, 20, watch=False)
        assert seconds(truth[-1].header.stamp) > begun + 0.9 * watched
        stamps = [seconds(state.header.stamp) for state in truth if abs(state.velocity[0]) > SLOW]
        return max(stamps, default=begun) - begun


class SharedBench:
    """A bench that tests use one after the other. It is mended after each, and replaced where that fails.

    Between two tests its time stands still, so that it takes no processor time.

    Parameters
    ----------
    folder : Path
        Folder of the logs.
    options
        Of each `WholeBench`.
    """

    def __init__(self, folder: Path, **options: Any) -> None:
        self._folder, self._options = folder, options
        self._bench: WholeBench | None = None
        self._count = 0

    @contextlib.contextmanager
    def lent(self) -> Iterator[WholeBench]:
        """Lend the bench, at rest in mode idle, to a test."""
        if self._bench is None:
            self._count += 1
            folder = self._folder / str(self._count)
            folder.mkdir()
            self._bench = WholeBench(folder, **self._options).__enter__()
        else:
            self._bench.clock.release()
        try:
            yield self._bench
            self._bench.mend()
            self._bench.clock.hold()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End the bench."""
        if self._bench is not None:
            bench, self._bench = self._bench, None
            bench.__exit__()
