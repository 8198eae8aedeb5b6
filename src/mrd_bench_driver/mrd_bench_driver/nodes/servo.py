"""The node ``servo``: it follows setpoints and publishes the state of the servo."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState

from mrd_base.lease import Mode
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import (
    JOINT_STATES,
    SAMPLES,
    SERVO_EMERGENCY_STOP,
    SERVO_ENABLE,
    SERVO_HOME,
    SERVO_RESET_FAULT,
    SERVO_REST,
    SERVO_STATE,
    SERVO_STOP,
    SETPOINT,
    Service,
)
from mrd_base.nodes.lease import LeaseFollower, hear_emergency_stop
from mrd_bench_driver.servo.communication import ServoCommunication
from mrd_bench_driver.servo.config import ServoConfig
from mrd_bench_driver.servo.controller import Response
from mrd_bench_driver.servo.status import ServoStatus
from mrd_bench_driver.servo.streaming import RodSetpoint
from mrd_interfaces import msg

# Temperature of the motor in degC that is worth a warning: 10 below the limit at which it faults (Moog, default of TH).
_WARM = 75.0


class ServoNode(BenchNode[ServoConfig]):
    """Follows ``setpoint``; publishes ``servo_state`` and ``joint_states``.

    It moves the rod only under the supervisor's lease, and stops it by itself when the lease is no longer renewed. Anyone
    may stop it.
    """

    alone = True

    def __init__(self) -> None:
        super().__init__("servo", ServoConfig)
        self._published, self._missed = ServoStatus(), 0
        self._force = math.nan  # mean in N of a block of samples that joint_states has not told
        # No shell has expanded the parameter's ~.
        config = dataclasses.replace(self.config, port=str(Path(self.config.port).expanduser()))
        self.hardware_id = config.port
        # The timer that checks the lease falls silent when a callback hangs; the thread of the line goes on.
        self._communication = ServoCommunication(config, self.bench, self._publish, lambda: self._lease.check())
        self._controller = self._communication.controller
        self._state = SERVO_STATE.publisher(self)
        self._joint = JOINT_STATES.publisher(self)
        SETPOINT.subscription(self, self._on_setpoint)
        SAMPLES.subscription(self, self._on_samples)
        self._lease = LeaseFollower(self, self.config.lease_timeout, self._emergency_stop, self._rest)
        hear_emergency_stop(self, self._on_emergency_stop)
        services: dict[Service, Callable[[Any], Response]] = {
            SERVO_ENABLE: lambda request: self._enable() if request.data else self._disable(),
            SERVO_HOME: lambda _request: self._home(),
            SERVO_STOP: lambda _request: self._halt(),
            SERVO_REST: lambda _request: self._end(),
            SERVO_EMERGENCY_STOP: lambda _request: self._on_button(),
            SERVO_RESET_FAULT: lambda _request: self._reset_fault(),
        }
        for service, work in services.items():
            service.serve(self, _service_callback(work))
        self._communication.start()

    # Commands

    def _on_setpoint(self, message: Any) -> None:
        if not self._lease.permits(message):
            return
        setpoint = RodSetpoint(seconds(message.header.stamp), message.position, message.velocity, message.acceleration)
        self._controller.follow(setpoint, self.bench.now())

    def _on_samples(self, message: Any) -> None:
        self._controller.add_samples(seconds(message.header.stamp), message.sample_period, message.position)
        self._force = float(np.mean(message.force)) if message.force else math.nan

    def _enable(self) -> Response:
        now = self.bench.now()
        reason = self._lease.reason_not_to_move(now)
        return Response(False, reason) if reason else self._controller.enable(True, now)

    def _home(self) -> Response:
        now = self.bench.now()
        reason = self._lease.reason_not_to_move(now)
        if not reason and self._lease.lease.mode is not Mode.HOMING:
            reason = f"the bench is in mode {self._lease.lease.mode}; call stop first"
        return Response(False, reason) if reason else self._controller.home(now)

    def _disable(self) -> Response:
        now = self.bench.now()
        self._lease.revoke(now)
        return self._controller.enable(False, now)

    def _halt(self) -> Response:
        self._lease.revoke(self.bench.now())
        return self._controller.stop()

    def _end(self) -> Response:
        self._lease.end()
        return self._controller.enable(False, self.bench.now())

    def _rest(self) -> None:
        now = self.bench.now()
        if self._controller.status(now).enabled:
            self._controller.enable(False, now)

    def _reset_fault(self) -> Response:
        now = self.bench.now()
        reason = self._lease.reason_not_to_change(now)
        return Response(False, reason) if reason else self._controller.reset_fault(now)

    def _on_emergency_stop(self, message: Any) -> None:
        if message.data:
            self._emergency_stop("emergency stop")

    def _on_button(self) -> Response:
        # The supervisor, which may be about to reset a stop before this one, must hear of it, too.
        self._lease.revoke(self.bench.now())
        return self._emergency_stop("emergency stop by its service")

    def _emergency_stop(self, reason: str) -> Response:
        self._controller.emergency_stop(self.bench.now(), reason)
        return Response(True, "latched; call reset_fault")

    def _publish(self, status: ServoStatus) -> None:
        """Publish a status. Only the thread of the serial line calls this, so that only it uses these publishers."""
        state = msg.ServoState(**{name: value for name, value in vars(status).items() if name != "time"})
        state.header.stamp = self.stamp(status.time)
        state.halt_time = self._lease.halt_time
        self._state.publish(state)
        # Before it is homed, the encoder counts from where it was switched on. One for each block of samples is enough for
        # plots and visualisations: a recorded message costs a simulated bench more than a millisecond.
        if status.homed and not math.isnan(self._force):
            joint = JointState(name=["rod"], position=[status.position], velocity=[status.velocity], effort=[self._force])
            joint.header = state.header
            self._joint.publish(joint)
            self._force = math.nan
        if status.message != self._published.message and status.message:
            self.get_logger().warning(status.message)
        if status.connected != self._published.connected:
            self.get_logger().info("motor connected" if status.connected else "motor not connected")
        self._published = status

    def warning(self) -> str:
        """Return what was missed or refused since the last call, or that the motor is warm."""
        before, self._missed = self._missed, self._controller.missed_replies
        refused = self._lease.latest_refusal()
        if self._missed > before:
            return f"{self._missed - before} times the motor did not reply; check the line"
        if self._published.temperature > _WARM:
            return f"the motor has {self._published.temperature:.0f} degC; it stops by itself at 85 degC"
        return refused

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return the fault or that the motor is not connected, and the state."""
        controller = self._controller
        status = controller.status(self.bench.now())
        problem = status.message or ("" if status.connected else "looking for the motor")
        counters = {name: getattr(controller, name) for name in ("missed_replies", "ignored_setpoints")}
        values = {"period_s": controller.period, "refused": self._lease.refused}
        return problem, dataclasses.asdict(status) | values | counters

    def close(self) -> None:
        """Bring the rod to rest and switch the drive off."""
        self._communication.close()


def _service_callback(work: Callable[[Any], Response]) -> Callable[[Any, Any], Any]:
    def serve(request: Any, response: Any) -> Any:
        response.success, response.message = work(request)
        return response

    return serve


def main() -> None:
    """Run the node."""
    run_node(ServoNode)
