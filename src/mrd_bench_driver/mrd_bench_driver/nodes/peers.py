"""The nodes that the supervisor asks, each call with a deadline."""

import contextlib
import queue
import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from mrd_bench_driver.procedure import RefusedError
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording

# Service and type by the node that offers it.
_SERVICES: dict[str, dict[str, Any]] = {
    "servo": {"servo/enable": SetBool, "servo/home": Trigger, "servo/stop": Trigger, "servo/reset_fault": Trigger},
    "daq": {"daq/tare": Trigger, "daq/reset_fault": Trigger, "daq/set_parameters": SetParameters},
    "generator": {"load_experiment": LoadExperiment, "start_experiment": Trigger, "abort_experiment": Trigger},
    "recorder": {"start_recording": StartRecording, "stop_recording": StopRecording},
}

_POLL = 0.005

# Wall seconds after which a question is asked again: one to a node that has just been started anew may be lost. Those that
# begin something are asked once.
_AGAIN = 2.0
_ONCE = ("start_experiment", "start_recording", "stop_recording", "servo/home")


class Peers:
    """Clients of the other nodes, for threads that may wait while the executor spins elsewhere."""

    def __init__(self, node: Node) -> None:
        self._closed = False
        self._clients = {
            service: (owner, node.create_client(kind, service))
            for owner, services in _SERVICES.items()
            for service, kind in services.items()
        }

    def close(self) -> None:
        """Refuse everything from now on: nobody spins the executor any more."""
        self._closed = True

    def require(self, owners: tuple[str, ...], timeout: float, interrupted: Callable[[], None]) -> None:
        """Wait until the nodes are there, ``timeout`` wall seconds at most; `RefusedError` names those that are not."""
        deadline = time.monotonic() + timeout
        while True:
            missing = {
                owner: service
                for service, (owner, client) in self._clients.items()
                if owner in owners and not client.service_is_ready()
            }
            if not missing:
                return
            if time.monotonic() > deadline:
                names = ", ".join(f"{owner} (no service {service})" for owner, service in missing.items())
                raise RefusedError(f"not there: {names}; start what is missing in the same namespace")
            interrupted()
            time.sleep(0.05)

    def check(self, service: str) -> None:
        """Refuse when the node that offers a service is gone; after a crash it takes ROS some 20 s to know."""
        owner, client = self._clients[service]
        if self._closed:
            raise RefusedError("the supervisor ends")
        if not client.service_is_ready():
            raise RefusedError(f"{owner} is gone: no service {service}")

    def call(self, service: str, request: Any, timeout: float, interrupted: Callable[[], None] = lambda: None) -> Any:
        """Response of a service, after ``timeout`` wall seconds at most.

        ``interrupted`` may end the wait early by raising. `RefusedError` when no answer came.
        """
        owner, client = self._clients[service]
        answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        asked: list[Any] = []

        def ask() -> None:
            future = client.call_async(request)
            asked.append(future)
            future.add_done_callback(answers.put)

        self.check(service)
        begin = time.monotonic()
        try:
            ask()
            while True:
                with contextlib.suppress(queue.Empty):
                    return answers.get(timeout=_POLL).result()
                interrupted()
                self.check(service)
                waited = time.monotonic() - begin
                if waited > timeout:
                    raise RefusedError(f"{owner} did not answer {service} within {timeout:g} s")
                if service not in _ONCE and waited > _AGAIN * len(asked):
                    ask()
        finally:
            for future in asked:
                client.remove_pending_request(future)

    def ask(self, service: str, request: Any, timeout: float, interrupted: Callable[[], None] = lambda: None) -> Any:
        """Like `call`, but `RefusedError` also when the node says no."""
        response = self.call(service, request, timeout, interrupted)
        if not response.success:
            raise RefusedError(f"{self._clients[service][0]}: {response.message or service + ' failed'}")
        return response
