"""ROS clients for the services of the other nodes. Each call has a deadline."""

import contextlib
import queue
import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from mrd_bench_driver.supervision.errors import RefusedError
from mrd_bench_driver.supervision.operations import Interruption, never_interrupted
from mrd_interfaces.srv import LoadExperiment, StartRecording, StopRecording

# Services and their types, by the node that offers them.
_SERVICES: dict[str, dict[str, Any]] = {
    "servo": {"servo/enable": SetBool, "servo/home": Trigger, "servo/stop": Trigger, "servo/reset_fault": Trigger},
    "daq": {"daq/tare": Trigger, "daq/reset_fault": Trigger, "daq/set_parameters": SetParameters},
    "generator": {"load_experiment": LoadExperiment, "start_experiment": Trigger, "abort_experiment": Trigger},
    "recorder": {"start_recording": StartRecording, "stop_recording": StopRecording},
}
# Time in s between two looks at whether a wait was interrupted.
_POLLING_INTERVAL = 0.005
# Wall time in s after which a request is repeated: a request to a node that has just been started may be lost.
_REPEAT_AFTER = 2.0
# Requests that begin something are not repeated.
_NOT_REPEATED = ("start_experiment", "start_recording", "stop_recording", "servo/home")


class PeerClients:
    """Implements `Peers` by the clients of a ROS node, for threads that may wait while its executor spins elsewhere."""

    def __init__(self, node: Node) -> None:
        self._closed = False
        self._clients = {
            service: (owner, node.create_client(service_type, service))
            for owner, services in _SERVICES.items()
            for service, service_type in services.items()
        }

    def close(self) -> None:
        """Refuse all calls from now on, because nobody spins the executor any more."""
        self._closed = True

    def require(self, nodes: tuple[str, ...], timeout: float, interruption: Interruption) -> None:
        """Wait until the nodes are present."""
        deadline = time.monotonic() + timeout
        while True:
            missing = {
                owner: service
                for service, (owner, client) in self._clients.items()
                if owner in nodes and not client.service_is_ready()
            }
            if not missing:
                return
            if time.monotonic() > deadline:
                names = ", ".join(f"{owner} (no service {service})" for owner, service in missing.items())
                raise RefusedError(f"not there: {names}; start what is missing in the same namespace")
            interruption()
            time.sleep(0.05)

    def check(self, service: str) -> None:
        """Refuse if the node that offers a service is gone. After a crash, ROS notices this only after about 20 s."""
        owner, client = self._clients[service]
        if self._closed:
            raise RefusedError("the supervisor ends")
        if not client.service_is_ready():
            raise RefusedError(f"{owner} is gone: no service {service}; look at its log")

    def call(
        self,
        service: str,
        timeout: float,
        interruption: Interruption = never_interrupted,
        *,
        may_fail: bool = False,
        **fields: Any,
    ) -> Any:
        """Call a service with these fields and return its response; refuse one without success, unless it may fail."""
        response = self._await_response(service, timeout, interruption, fields)
        if not may_fail and not response.success:
            raise RefusedError(f"{self._clients[service][0]}: {response.message or service + ' failed'}")
        return response

    def _await_response(self, service: str, timeout: float, interruption: Interruption, fields: dict[str, Any]) -> Any:
        owner, client = self._clients[service]
        request = _SERVICES[owner][service].Request(**fields)
        responses: queue.SimpleQueue[Any] = queue.SimpleQueue()
        pending: list[Any] = []

        def send() -> None:
            future = client.call_async(request)
            pending.append(future)
            future.add_done_callback(responses.put)

        self.check(service)
        waited = 0.0
        try:
            send()
            while True:
                begin = time.monotonic()
                with contextlib.suppress(queue.Empty):
                    return responses.get(timeout=_POLLING_INTERVAL).result()
                waited += time.monotonic() - begin
                interruption()
                self.check(service)
                if waited > timeout:
                    raise RefusedError(f"{owner} did not respond to {service} within {timeout:g} s; look at its log")
                if service not in _NOT_REPEATED and waited > _REPEAT_AFTER * len(pending):
                    send()
        finally:
            for future in pending:
                client.remove_pending_request(future)

    def set_sample_rate(self, rate: float, timeout: float, interruption: Interruption) -> None:
        """Set the sample rate in Hz of the DAQ."""
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(rate))
        fields = {"parameters": [Parameter(name="rate_hz", value=value)]}
        (result,) = self._await_response("daq/set_parameters", timeout, interruption, fields).results
        if not result.successful:
            raise RefusedError(f"daq: {result.reason}")
