"""A ROS node that stands for the rest of the bench, for tests of a node that runs as a process."""

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

from mrd_base.clock import BenchClock
from mrd_bench_driver.processes import BenchProcesses, ProcessSpec

# A node on its own keeps the wall's time, and trips after 100 to 150 ms of it, as it should on a real bench. A machine that
# also runs other tests may stand still for longer. The reactions are measured in bench time, by tests of the whole bench.
PATIENCE = 1.0
PATIENT = {
    "supervisor": (
        *("late_ms", "stall_ms", "setpoint_timeout_ms"),
        *(f"interlocks.{what}_stale_ms" for what in ("samples", "servo", "setpoint")),
    ),
    "daq": ("lease_timeout_ms",),
    "servo": ("setpoint_timeout_ms", "feedback_timeout_ms", "lease_timeout_ms"),
}
# Each graph has a namespace of its own, so that a shared one does not disturb another.
_NUMBERS = itertools.count()


class Graph:
    """A test's own `node`, and the processes of the nodes under test."""

    def __init__(self, folder: Path) -> None:
        namespace = f"/bench{next(_NUMBERS)}"
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("rest_of_the_bench", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._processes = BenchProcesses([], folder, namespace=namespace)
        self.clock = BenchClock()

    def start(self, executable: str, **parameters: Any) -> Any:
        parameters = dict.fromkeys(PATIENT[executable], 1e3 * PATIENCE) | parameters
        self._processes.specs[executable] = ProcessSpec("mrd_bench_driver", executable, parameters)
        return self._processes.start(executable)

    def process(self, executable: str) -> Any:
        return self._processes.running[executable]

    def log(self, executable: str) -> str:
        return self._processes.log(executable).read_text()

    def until(self, condition: Callable[[], Any], timeout: float = 15.0, failure: str = "timed out") -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < deadline, failure
            self._executor.spin_once(timeout_sec=0.005)

    def during(self, duration: float) -> None:
        """Process messages for a while, in which something must not happen."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.005)

    def call(self, service: str, service_type: Any, **fields: Any) -> Any:
        client = self.node.create_client(service_type, service)
        self.until(client.service_is_ready, failure=f"no service {service}")
        future = client.call_async(service_type.Request(**fields))
        self.until(future.done, failure=f"no response from {service}")
        client.destroy()
        return future.result()

    def subscribe(self, topic: str, message_type: Any, qos: Any) -> list[Any]:
        """Return the list to which the messages of a topic are appended."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos)
        return messages

    def close(self) -> None:
        self._processes.close()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    graph = Graph(tmp_path / "log")
    yield graph
    graph.close()


@pytest.fixture(scope="module")
def shared_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    """One graph for all tests of a module that leave the node under test as they found it."""
    graph = Graph(tmp_path_factory.mktemp("graph") / "log")
    yield graph
    graph.close()
