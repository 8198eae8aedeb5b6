"""ROS clients for the services of the other nodes. Each call has a deadline."""

import contextlib
import queue
import time
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node

from mrd_base.nodes.graph import (
    ABORT_CONTROL,
    ABORT_EXPERIMENT,
    DAQ_RESET_FAULT,
    DAQ_TARE,
    LOAD_CONTROL,
    LOAD_EXPERIMENT,
    SERVO_ENABLE,
    SERVO_HOME,
    SERVO_RESET_FAULT,
    SERVO_REST,
    START_CONTROL,
    START_EXPERIMENT,
    START_RECORDING,
    STOP_RECORDING,
    Service,
)
from mrd_bench_driver.supervision.errors import RefusedError
from mrd_bench_driver.supervision.operations import Interruption, never_interrupted

# The service by which ROS sets the parameters of the DAQ.
_DAQ_PARAMETERS = Service("daq/set_parameters", SetParameters, "daq", "set parameters")
# Services that the supervisor calls.
_SERVICES = {
    service.name: service
    for service in (
        *(SERVO_ENABLE, SERVO_HOME, SERVO_REST, SERVO_RESET_FAULT, DAQ_TARE, DAQ_RESET_FAULT, _DAQ_PARAMETERS),
        *(LOAD_CONTROL, START_CONTROL, ABORT_CONTROL),
        *(LOAD_EXPERIMENT, START_EXPERIMENT, ABORT_EXPERIMENT, START_RECORDING, STOP_RECORDING),
    )
}
# Time in s between two looks at whether a wait was interrupted.
_POLLING_INTERVAL = 0.005
# Wall time in s after which a request is repeated: a request to a node that has just been started may be lost.
_REPEAT_AFTER = 2.0
# Requests that begin something or take long are not repeated: a generator that plans for longer would load the experiment
# twice. A servo that homes refuses to home once more, so that only one homing is done.
_NOT_REPEATED = {
    service.name
    for service in (LOAD_EXPERIMENT, LOAD_CONTROL, START_EXPERIMENT, START_CONTROL, START_RECORDING, STOP_RECORDING)
}


class PeerClients:
    """Implements `Peers` by the clients of a ROS node, for threads that may wait while its executor spins elsewhere."""

    def __init__(self, node: Node) -> None:
        self._closed = False
        self._clients = {name: (service.node, service.client(node)) for name, service in _SERVICES.items()}

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
        request = _SERVICES[service].type.Request(**fields)
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
        (result,) = self._await_response(_DAQ_PARAMETERS.name, timeout, interruption, fields).results
        if not result.successful:
            raise RefusedError(f"daq: {result.reason}")
