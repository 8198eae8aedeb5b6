"""The node ``daq``: it publishes samples in SI units and sets the coil current."""

import array
import math
from typing import Any, ClassVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Temperature
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from mrd_base import InputError
from mrd_base.nodes.bench_node import BenchNode, run_node, seconds
from mrd_base.nodes.graph import (
    ANALOG_INPUT,
    ANALOG_OUTPUT,
    CALIBRATION,
    DAQ_EMERGENCY_STOP,
    DAQ_RESET_FAULT,
    DAQ_STATE,
    DAQ_TARE,
    MEASUREMENT,
    SAMPLES,
    SETPOINT,
    TEMPERATURE,
)
from mrd_base.nodes.lease import LeaseFollower, hear_emergency_stop
from mrd_base.quantities import ZERO_CELSIUS
from mrd_bench_driver.acquisition import ConverterSettings, Simulated, VoltBlock, make_backend
from mrd_bench_driver.acquisition.block_means import BlockMeans, Means
from mrd_bench_driver.acquisition.channels import UNITS, to_si
from mrd_bench_driver.acquisition.config import DaqConfig
from mrd_bench_driver.acquisition.daq import Daq
from mrd_interfaces.msg import AnalogInput, AnalogOutput, BenchSamples, Calibration, Measurement, Setpoint

# Bench time in s between two messages of the temperature, which changes by a fraction of a kelvin meanwhile.
_TEMPERATURE_PERIOD = 0.1


class DaqNode(BenchNode[DaqConfig]):
    """Publishes ``samples``, ``measurement``, ``temperature`` and ``calibration``; follows the coil current of ``setpoint``.

    Current flows only under the supervisor's lease, and none once the lease is no longer renewed. ``daq_state`` tells at
    once when the DAQ has stopped.
    """

    dynamic: ClassVar[frozenset[str]] = frozenset({"rate_hz"})
    alone = True

    def __init__(self) -> None:
        super().__init__("daq", DaqConfig)
        config = self.config
        self._samples, self._measurement = SAMPLES.publisher(self), MEASUREMENT.publisher(self)
        self._means = BlockMeans()
        self._temperature, self._temperature_time = TEMPERATURE.publisher(self), -math.inf
        self._calibration = CALIBRATION.publisher(self)
        self._state = DAQ_STATE.publisher(self)
        wiring = ConverterSettings(config.device, config.channels, config.coil, config.hardware_rate, config.block)
        self._backend = make_backend(config.backend, wiring, self.bench)
        self._daq = Daq(
            config,
            self.bench,
            self._backend,
            self._check_readings,
            self._publish_block,
            self._publish_calibration,
            self._publish_state,
        )
        if isinstance(self._backend, Simulated):
            self._output = ANALOG_OUTPUT.publisher(self)
            self._backend.send = self._send_coil_voltage
            ANALOG_INPUT.subscription(self, self._on_analog_input)
        self._backend.open()
        self.hardware_id = self._backend.product
        self._publish_calibration()
        self._publish_state("")

        self._lost = 0
        self._followed = 0  # number of the lease of the latest setpoint
        self._lease = LeaseFollower(self, config.lease_timeout, self._daq.emergency_stop, self._daq.rest)
        self.accept_parameter("rate_hz", config.rate, self._set_rate)
        DAQ_TARE.serve(self, self._on_tare)
        DAQ_RESET_FAULT.serve(self, self._on_reset_fault)
        DAQ_EMERGENCY_STOP.serve(self, self._on_emergency_stop_service)
        hear_emergency_stop(self, self._on_emergency_stop)
        SETPOINT.subscription(self, self._on_setpoint)
        self.create_bench_timer(0.2 * config.setpoint_timeout, self._daq.check_output)
        self._daq.start()  # last, because the reading thread uses all of the above

    def _check_readings(self, block: VoltBlock) -> None:
        # The timers of both fall silent when a callback hangs. Samples go on then, and nobody else would stop the current.
        self._lease.check()
        self._daq.check_output()
        if self._lease.lease.mode.may_move:
            self._daq.check_inputs(block)
        self._daq.check_coil(block)

    def _publish_block(self, block: VoltBlock) -> None:
        message = BenchSamples(sample_period=1 / self._daq.rate, sequence=block.sequence)
        message.header.stamp = self.stamp(block.time)
        samples = to_si(block.volts, self._daq.channels)
        for (name, _), values in zip(self._daq.channels.items(), samples, strict=True):
            setattr(message, name, array.array("d", values.tobytes()))
        self._samples.publish(message)
        means = self._means.add(block.time, message.sample_period, samples)
        if means is not None:
            scalars = Measurement(**means.values)
            self._publish_temperature(means)
            scalars.header.stamp = self.stamp(means.time)
            self._measurement.publish(scalars)

    def _publish_temperature(self, means: Means) -> None:
        if not self.config.channels.temperature.input or means.time - self._temperature_time < _TEMPERATURE_PERIOD:
            return
        self._temperature_time = means.time
        message = Temperature(temperature=means.values["temperature"] - ZERO_CELSIUS)
        message.header.stamp = self.stamp(means.time)
        self._temperature.publish(message)

    def _publish_calibration(self) -> None:
        quantities, channels = zip(*self._daq.channels.items(), strict=True)
        message = Calibration(
            quantity=quantities,
            unit=[UNITS[name] for name in quantities],
            channel=[channel.input for channel in channels],
            gain=[channel.gain for channel in channels],
            zero=[channel.zero for channel in channels],
            rate=self._daq.rate,
            hardware_rate=self.config.hardware_rate,
            device=self._backend.product,
        )
        message.header.stamp = self.stamp(self._daq.tare_time)
        self._calibration.publish(message)

    def _on_analog_input(self, message: AnalogInput) -> None:
        assert isinstance(self._backend, Simulated)
        volts = np.array(message.voltage, np.float64)
        self._backend.feed(
            message.sequence, seconds(message.header.stamp), message.sample_period, list(message.channels), volts
        )

    def _send_coil_voltage(self, volts: float) -> None:
        message = AnalogOutput(coil_command=volts)
        message.header.stamp = self.stamp()
        self._output.publish(message)

    def _publish_state(self, problem: str) -> None:
        """Tell everyone whether the DAQ works, or why it has stopped; the log comes last, because it may block."""
        level = DiagnosticStatus.ERROR if problem else DiagnosticStatus.OK
        name = f"{self.get_fully_qualified_name().lstrip('/')}: outputs"
        self._state.publish(DiagnosticStatus(level=level, name=name, message=problem or "ok"))
        if problem:
            self._publish_diagnostics()
            self.get_logger().error(problem)

    def _set_rate(self, rate: Any) -> None:
        self._require_no_run()
        self._daq.set_rate(rate)

    def _require_no_run(self) -> None:
        if reason := self._lease.reason_not_to_change(self.bench.now()):
            raise InputError(reason)

    def _on_setpoint(self, setpoint: Setpoint) -> None:
        if not self._lease.permits(setpoint):
            return
        self._followed = setpoint.lease
        self._daq.set_coil_current(setpoint.coil_current, seconds(setpoint.header.stamp))

    def _on_emergency_stop(self, message: Bool) -> None:
        if message.data:
            self._daq.emergency_stop()

    def _on_emergency_stop_service(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        # The supervisor, which may be about to reset a stop before this one, must hear of it, too.
        self._daq.emergency_stop("emergency stop by its service", tell_again=True)
        response.success, response.message = True, "latched; call reset_fault"
        return response

    def _on_tare(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            # The supervisor tares under the lease of its run, before the first setpoint.
            if self._lease.lease.number in (0, self._followed):
                self._require_no_run()
            response.message, response.success = self._daq.tare(), True
        except InputError as error:
            response.message = str(error)
        return response

    def _on_reset_fault(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._require_no_run()
            self._daq.reset_fault()
            response.success = True
        except InputError as error:
            response.message = f"daq: {error}"
        return response

    def warning(self) -> str:
        """Return what was lost or refused since the last call."""
        before, self._lost = self._lost, self._daq.lost
        refused = self._lease.latest_refusal()
        return f"{self._lost - before} readings of the converter were lost" if self._lost > before else refused

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return the state of the DAQ."""
        problem, values = self._daq.health()
        return problem, values | {"refused": self._lease.refused or values["refused"]}

    def close(self) -> None:
        """Set the coil output to 0 V, first and last."""
        self._daq.close()


def main() -> None:
    """Run the node."""
    run_node(DaqNode)


if __name__ == "__main__":
    main()
