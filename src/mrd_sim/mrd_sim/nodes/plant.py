"""The simulated bench: the motor on a serial port, everything else on the terminals of the simulated DAQ."""

import array
import math
import threading
import time
from pathlib import Path
from typing import ClassVar

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from mrd_base.barrier import Barrier
from mrd_base.barrier_clock import BarrierClock
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import ANALOG_INPUT, ANALOG_OUTPUT, CLOCK, TRUE_STATE
from mrd_base.quantities import ZERO_CELSIUS
from mrd_interfaces.msg import AnalogInput, AnalogOutput
from mrd_sim.motor import MotorSerialPort
from mrd_sim.plant import Block, Plant, PlantConfig, check_fault

_SWITCHED_ON = 1.0  # bench seconds before the start


class PlantNode(BenchNode[PlantConfig]):
    """Simulates the plant, and owns the bench time: it goes on as soon as all nodes have done their work."""

    dynamic: ClassVar[frozenset[str]] = frozenset({"fault"})

    def __init__(self) -> None:
        super().__init__("plant", PlantConfig)
        self.hardware_id = "simulated"
        # The very first run compiles for seconds; that must not happen while anything moves.
        Plant(self.config).advance(self.config.block)
        # Everything was switched on a moment before the bench time begins: the motor has booted, the filters have settled.
        self.plant = Plant(self.config, self.bench.now() - _SWITCHED_ON)
        self.plant.advance(self.bench.now())
        self.port = MotorSerialPort(self.plant.motor, self.config.port_link)
        self._time_topic = CLOCK.publisher(self)
        self._analog_input = ANALOG_INPUT.publisher(self)
        # True values, which no real bench has; tests read them. The rod's effort is the force, the coil's the current.
        self._true_state = TRUE_STATE.publisher(self)
        ANALOG_OUTPUT.subscription(self, self._on_analog_output)
        self.accept_parameter("fault", "", self._set_fault)
        self._set_fault(self.config.fault)
        self._published_blocks = 0
        self._closing = threading.Event()
        self._stepper = threading.Thread(target=self._run, name="plant", daemon=True)
        self._stepper.start()

    def make_clock(self, clock: str) -> BarrierClock:
        """Make the owner of the bench time, by default beside the serial port; return a clock that follows it."""
        config = self.config
        path = Path(clock or f"{config.port_link}.clock").expanduser().absolute()
        participants = [*filter(None, config.participants.split(",")), "plant"]
        self._barrier = Barrier(path, participants, float(int(time.time())), config.pace or math.inf, self._report)
        barrier_clock = BarrierClock(path, "plant")
        barrier_clock.on_loss = self._report
        return barrier_clock

    def _report(self, message: str) -> None:
        self.get_logger().error(message)

    def _set_fault(self, fault: str) -> None:
        check_fault(fault)
        with self.port.lock:
            self.plant.set_fault(fault, self.bench.now())
        if fault == "unplug":
            self.port.unplug()
        else:
            self.port.plug()

    def _on_analog_output(self, message: AnalogOutput) -> None:
        with self.port.lock:
            self.plant.command_coil(message.coil_command, seconds(message.header.stamp))

    def _run(self) -> None:
        try:
            self._barrier.run(self, self._closing)
        finally:
            self._barrier.close()

    # What the owner of the time calls.

    def next_event(self) -> float:
        """Return the bench time of the next block, or of an event on the serial line before it."""
        return min(self.plant.time + self.config.block, self.plant.motor.next_event())

    def read_line(self, count: int, now: float) -> None:
        """Receive what was sent to the motor."""
        self.port.read(count, now)

    def advance_line(self, now: float, awaited: bool) -> bool:
        """Let the motor answer; return whether it did."""
        return self.port.exchange(now, awaited)

    def advance(self, now: float) -> bool:
        """Simulate and publish the next block once it is due; return whether it was."""
        # Half of the tolerance of `Plant.advance`: a block that came earlier would lack a reading, and shift all later ones.
        if now < self.plant.time + self.config.block - 5e-4 / self.config.hardware_rate:
            return False
        with self.port.lock:
            block = self.plant.advance(now)
        if block is not None:
            self._publish(block)
        return True

    def _publish(self, block: Block) -> None:
        fault = self.plant.fault
        self._published_blocks += 1
        if fault != "freeze_daq" and (fault != "drop_blocks" or self._published_blocks % 3):
            gone = fault == "lose_daq"
            message = AnalogInput(
                sample_period=block.sample_period,
                sequence=block.sequence,
                channels=[] if gone else block.channels,
                voltage=array.array("d", b"" if gone else block.voltage.tobytes()),
            )
            message.header.stamp = self.stamp(block.time)
            self._analog_input.publish(message)
        state = JointState(
            name=["rod", "coil"],
            position=[float(block.position[-1]), 0.0],
            velocity=[float(block.velocity[-1]), 0.0],
            effort=[float(block.force[-1]), float(block.current[-1])],
        )
        state.header.stamp = self.stamp(self.plant.time)
        self._true_state.publish(state)
        self._time_topic.publish(Clock(clock=state.header.stamp))

    def health(self) -> tuple[str, dict[str, object]]:
        """Return a problem, the port, and the temperatures of motor and damper."""
        problem = ""
        if not self._stepper.is_alive():
            problem = "the simulation has stopped; its error is on stderr"
        elif self.plant.fault:
            problem = f"fault on purpose: {self.plant.fault}"
        return problem, {
            "port": self.port.link,
            "temperature, degC": round(self.plant.motor.axis.temperature, 1),
            "damper, degC": round(self.plant.temperature - ZERO_CELSIUS, 1),
        }

    def close(self) -> None:
        """Stop the simulation and remove the serial port."""
        self._closing.set()
        self._stepper.join()
        self.port.close()


def main() -> None:
    """Run the node."""
    run_node(PlantNode)
