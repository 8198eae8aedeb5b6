"""The whole bench as processes, for the tests of this folder and the fault campaign."""

import dataclasses
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from mrd_base.nodes.bench_node import LATCHED, RECORDED, seconds
from mrd_bench_driver.nodes.bench_client import BenchClient
from mrd_bench_driver.processes import BenchProcesses, bench_processes, clock_of
from mrd_interfaces.action import RunExperiment
from mrd_interfaces.msg import ServoState, Setpoint

ROOT = Path(__file__).resolve().parents[1]
BENCH, PLANT = ROOT / "config/bench.yaml", ROOT / "config/plant.yaml"

SLOW = 2e-3
"""m/s; the rod counts as stopped below it."""


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
        self.client = BenchClient(watch=self.processes.check, clock=clock_of(self._folder / "motor"))
        self.client.wait_until_up(set(self.processes.specs))
        # These are created beforehand: how long ROS takes to match a client is no part of how long the rod takes to stop.
        self.plant = self.client.node.create_client(SetParameters, "plant/set_parameters")
        self.button = self.client.node.create_publisher(Bool, "emergency_stop", LATCHED)
        self.truth: list[JointState] = self.subscribe("plant/true_state", JointState, RECORDED)
        self.servo: list[ServoState] = self.subscribe("servo_state", ServoState, RECORDED)
        assert self.client.spin(lambda: self.plant.service_is_ready(), 10)
        self.clock = self.client.time
        self.client.let_time_pass()
        return self

    def __exit__(self, *_error: object) -> None:
        self.client.__exit__()
        self.processes.close()

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
        client = ActionClient(self.client.node, RunExperiment, action)
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
