"""The node ``servo``: setpoints in, motor commands out, the rod's state back."""

import dataclasses
import math
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED, BenchNode, run_node, seconds
from mrd_bench_driver.drive import Setpoint
from mrd_bench_driver.servo import Answer
from mrd_bench_driver.servo_config import ServoConfig, ServoReport
from mrd_bench_driver.servo_loop import ServoLoop
from mrd_interfaces import msg

_FIELDS = [field.name for field in dataclasses.fields(ServoReport) if field.name != "time"]


class ServoNode(BenchNode[ServoConfig]):
    """Follows ``setpoint``; tells ``servo_state`` and ``joint_states``."""

    def __init__(self) -> None:
        super().__init__("servo", ServoConfig)
        self._said = ServoReport()
        self._loop = ServoLoop(self.config, self.bench, self._tell)
        self._servo = servo = self._loop.servo
        self._state = self.create_publisher(msg.ServoState, "servo_state", RECORDED)
        self._joint = self.create_publisher(JointState, "joint_states", RECORDED)
        self.create_subscription(msg.Setpoint, "setpoint", self._on_setpoint, COMMAND)
        self.create_subscription(msg.BenchSamples, "samples", self._on_samples, RECORDED)
        self.create_subscription(Bool, "emergency_stop", self._on_emergency_stop, LATCHED)
        now = self.bench.now
        self.create_service(SetBool, "servo/enable", lambda ask, reply: _answer(reply, servo.enable(ask.data, now())))
        self.create_service(Trigger, "servo/home", lambda _, reply: _answer(reply, servo.home(now())))
        self.create_service(Trigger, "servo/stop", lambda _, reply: _answer(reply, servo.stop()))
        self.create_service(Trigger, "servo/reset_fault", lambda _, reply: _answer(reply, servo.reset_fault(now())))
        self._loop.start()

    def _on_setpoint(self, message: Any) -> None:
        setpoint = Setpoint(seconds(message.header.stamp), message.position, message.velocity, message.acceleration)
        self._servo.setpoint(setpoint, self.bench.now())

    def _on_samples(self, message: Any) -> None:
        self._servo.samples(seconds(message.header.stamp), message.sample_period, message.position)

    def _on_emergency_stop(self, message: Any) -> None:
        if message.data:
            self._servo.emergency_stop(self.bench.now())

    def _tell(self, report: ServoReport) -> None:
        """Publish the state; called in the loop's thread, the only one that uses these publishers."""
        state = msg.ServoState(**{name: getattr(report, name) for name in _FIELDS})
        state.header.stamp = self.stamp(report.time)
        self._state.publish(state)
        if not math.isnan(report.position):
            joint = JointState(name=["rod"], position=[report.position], velocity=[report.velocity])
            joint.header = state.header
            self._joint.publish(joint)
        if report.message != self._said.message and report.message:
            self.get_logger().warning(report.message)
        if report.connected != self._said.connected:
            self.get_logger().info("motor connected" if report.connected else "motor not connected")
        self._said = report

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """Fault or lost line, and the state."""
        report = self._servo.report(self.bench.now())
        problem = report.message or ("" if report.connected else "looking for the motor")
        counters = {name: getattr(self._servo, name) for name in ("missed_replies", "ignored_setpoints")}
        return problem, dataclasses.asdict(report) | {"period_s": self._servo.period} | counters

    def close(self) -> None:
        """Bring the rod to rest and let it go."""
        self._loop.close()


def _answer(reply: Any, answer: Answer) -> Any:
    reply.success, reply.message = answer
    return reply


def main() -> None:
    """Run the node."""
    run_node(ServoNode)
