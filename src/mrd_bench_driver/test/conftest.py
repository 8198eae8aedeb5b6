"""A node that plays the rest of the bench for one that runs as a process."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor

from mrd_base.clock import BenchClock
from mrd_bench_driver.processes import BenchProcesses, Part


class Graph:
    """The rest of the bench: `node` hears and speaks, `start` runs the node under test."""

    def __init__(self, folder: Path) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("rest_of_the_bench", namespace="bench", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._processes = BenchProcesses([], folder)
        self.clock = BenchClock()

    def start(self, executable: str, **parameters: Any) -> Any:
        self._processes.parts[executable] = Part("mrd_bench_driver", executable, parameters)
        self._processes._logs.mkdir(exist_ok=True)
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
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.005)

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, failure=f"no service {service}")
        future = client.call_async(kind.Request(**fields))
        self.until(future.done, failure=f"no answer from {service}")
        client.destroy()
        return future.result()

    def hear(self, topic: str, kind: Any, qos: Any) -> list[Any]:
        heard: list[Any] = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

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
