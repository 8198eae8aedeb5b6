"""The simulated bench: the motor on a serial port, everything else on the terminals of the simulated DAQ."""

import array
import threading
from typing import ClassVar

from sensor_msgs.msg import JointState

from mrd_base.nodes.bench_node import LATCHED, RECORDED, BenchNode, run_node, seconds
from mrd_interfaces.msg import AnalogInput, AnalogOutput
from mrd_sim.motor import MotorSerialPort
from mrd_sim.plant import Block, Plant, PlantConfig, check_fault

_BLOCK = 0.01  # bench seconds
_SHORTEST_PERIOD = 0.004  # wall seconds between blocks, for a bench that runs much faster than real time
_LONGEST_BLOCK = 0.1  # bench seconds, after the machine was busy with other work


class PlantNode(BenchNode[PlantConfig]):
    """Advances the plant with the bench clock. It may fall behind, but it never skips samples.

    A thread steps the plant, because an executor's timer costs more than the whole simulation.
    """

    dynamic: ClassVar[frozenset[str]] = frozenset({"fault"})

    def __init__(self) -> None:
        super().__init__("plant", PlantConfig)
        # The very first run compiles for seconds; that must not happen while anything moves.
        Plant(self.config).advance(_BLOCK)
        self.plant = Plant(self.config, self.bench.now())
        self.port = MotorSerialPort(self.plant.motor, self.bench, self.config.port_link)
        self._slowest = 0.0
        self._analog_input = self.create_publisher(AnalogInput, "analog_input", RECORDED)
        # True values, which no real bench has; tests read them.
        self._true_state = self.create_publisher(JointState, "plant/true_state", 10)
        self.create_subscription(AnalogOutput, "analog_output", self._on_analog_output, LATCHED)
        self.accept_parameter("fault", "", self._set_fault)
        self._set_fault(self.config.fault)
        self._closing = threading.Event()
        self._stepper = threading.Thread(target=self._run, name="plant", daemon=True)
        self._stepper.start()

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
        period = max(self.bench.wall(_BLOCK), _SHORTEST_PERIOD)
        while not self._closing.wait(max(period - self.bench.wall(self.bench.now() - self.plant.time), 0.0)):
            self._step()

    def _step(self) -> None:
        now = self.bench.now()
        self._slowest = max(self._slowest, now - self.plant.time)
        while now - self.plant.time >= 1.0 / self.config.hardware_rate:
            with self.port.lock:
                block = self.plant.advance(min(now, self.plant.time + _LONGEST_BLOCK))
            if block is None:
                break
            self._publish(block)

    def _publish(self, block: Block) -> None:
        if self.plant.fault != "freeze_daq":
            message = AnalogInput(
                sample_period=block.sample_period,
                sequence=block.sequence,
                channels=block.channels,
                voltage=array.array("d", block.voltage.tobytes()),
            )
            message.header.stamp = self.stamp(block.time)
            self._analog_input.publish(message)
        state = JointState(
            name=["rod"],
            position=[float(block.position[-1])],
            velocity=[float(block.velocity[-1])],
            effort=[float(block.force[-1])],
        )
        state.header.stamp = self.stamp(self.plant.time)
        self._true_state.publish(state)

    def health(self) -> tuple[str, dict[str, object]]:
        """Return a problem, and port, largest delay against the bench clock, and temperature."""
        problem = ""
        if not self._stepper.is_alive():
            problem = "the simulation has stopped; its error is on stderr"
        elif self.plant.fault:
            problem = f"fault on purpose: {self.plant.fault}"
        elif not self.port.plugged:
            problem = "the serial port has stopped; its error is on stderr"
        slowest, self._slowest = self._slowest, 0.0
        return problem, {
            "port": self.port.link,
            "worst delay, s": round(slowest, 4),
            "temperature, degC": round(self.plant.motor.axis.temperature, 1),
        }

    def close(self) -> None:
        """Stop the simulation and remove the serial port."""
        self._closing.set()
        self._stepper.join()
        self.port.close()


def main() -> None:
    """Run the node."""
    run_node(PlantNode)
