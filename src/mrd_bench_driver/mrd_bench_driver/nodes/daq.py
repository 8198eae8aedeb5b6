"""The DAQ: publishes samples in SI units and sets the coil's current."""

import array
import collections
import contextlib
import threading
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from mrd_base import InputError, quantity
from mrd_base.config import bench_time_scale
from mrd_base.nodes.bench_node import COMMAND, LATCHED, RECORDED, BenchNode, run_node, seconds
from mrd_bench_driver.acquisition import (
    AcquisitionError,
    Averager,
    Simulated,
    VoltBlock,
    Wiring,
    averaging_ratio,
    make_backend,
)
from mrd_bench_driver.channels import UNITS, Channels, Coil, coil_voltage, count_clipped, tared, to_si
from mrd_interfaces.msg import AnalogInput, AnalogOutput, BenchSamples, Calibration, Setpoint
from mrd_trajectory.limits import Limits


@dataclass(frozen=True)
class DaqConfig:
    """The section ``daq`` of bench.yaml."""

    time_scale: float = bench_time_scale()
    limits: Limits = Limits()
    backend: str = quantity("simulated", doc="simulated or ni_usb_6216")
    device: str = quantity("Dev1", doc="name of the converter in NI's configuration")
    hardware_rate: float = quantity(2000.0, "Hz", "of the converter, for each channel", lower=25, upper=50_000)
    rate: float = quantity(1000.0, "Hz", "of the samples, means of hardware_rate/rate readings", lower=25, upper=2000)
    block: float = quantity(0.02, "ms", "of samples in one message, at least one sample", lower=0.001, upper=0.05)
    setpoint_timeout: float = quantity(0.1, "ms", "age of a setpoint that stops the coil", lower=0.01, upper=1)
    tare_duration: float = quantity(1.0, "s", "of the readings that a tare averages", lower=0.05, upper=60)
    channels: Channels = Channels()
    coil: Coil = Coil()


class Daq(BenchNode[DaqConfig]):
    """Reads in a thread of its own; commands, services and the coil's watchdog run in the executor."""

    dynamic: ClassVar[frozenset[str]] = frozenset({"rate_hz"})

    def __init__(self) -> None:
        super().__init__("daq", DaqConfig)
        config = self.config
        self._lock = threading.RLock()
        self._channels = config.channels
        self._rate = config.rate
        self._averager = self._make_averager(config.rate)
        self._recent: collections.deque[VoltBlock] = collections.deque()
        self._recent_count = 0
        self._clipped = np.zeros(len(UNITS), np.int64)
        self._tared = self.bench.now()
        self._lost_before = 0

        self._stopped = False  # the emergency stop, latched
        self._fault = ""
        self._refused = ""
        self._heard = -np.inf  # bench time up to which the setpoint counts as fresh, less the timeout
        self._volts = 0.0

        self._samples = self.create_publisher(BenchSamples, "samples", RECORDED)
        self._calibration = self.create_publisher(Calibration, "calibration", LATCHED)
        self._backend = make_backend(
            config.backend,
            Wiring(config.device, config.channels, config.coil, config.hardware_rate, config.block),
            self.bench,
        )
        if isinstance(self._backend, Simulated):
            self._output = self.create_publisher(AnalogOutput, "analog_output", LATCHED)
            self._backend.send = self._send
            self.create_subscription(AnalogInput, "analog_input", self._on_analog_input, RECORDED)
        self._backend.open()
        self._publish_calibration()

        self._closing = threading.Event()
        self._parked = threading.Event()  # the reading thread waits until a fault is reset
        self._resume = threading.Event()
        self._thread = threading.Thread(target=self._acquire, name="acquisition", daemon=True)
        self.accept_parameter("rate_hz", config.rate, self._set_rate)
        self.create_service(Trigger, "daq/tare", self._tare)
        self.create_service(Trigger, "daq/reset_fault", self._reset_fault)
        self.create_subscription(Bool, "emergency_stop", self._on_emergency_stop, LATCHED)
        self.create_subscription(Setpoint, "setpoint", self._on_setpoint, COMMAND)
        self.create_bench_timer(0.2 * config.setpoint_timeout, self._watch_setpoint)
        self._thread.start()

    # Samples

    def _make_averager(self, rate: float) -> Averager:
        ratio = averaging_ratio(rate, self.config.hardware_rate)
        return Averager(ratio, max(1, round(self.config.block * rate)), self.config.hardware_rate)

    def _on_analog_input(self, message: AnalogInput) -> None:
        assert isinstance(self._backend, Simulated)
        volts = np.array(message.voltage, np.float64)
        self._backend.feed(
            message.sequence, seconds(message.header.stamp), message.sample_period, list(message.channels), volts
        )

    def _acquire(self) -> None:
        while not self._closing.is_set():
            if self._fault:
                self._parked.set()
                self._resume.wait()
                self._resume.clear()
                continue
            try:
                block = self._backend.read()
            except AcquisitionError as error:
                self._fail(str(error))
                continue
            if block is not None and not self._closing.is_set():
                self._take(block)

    def _take(self, block: VoltBlock) -> None:
        with self._lock:
            self._clipped += count_clipped(block.volts, self._channels)
            self._recent.append(block)
            self._recent_count += block.volts.shape[1]
            wanted = self.config.tare_duration * self.config.hardware_rate
            while self._recent_count - self._recent[0].volts.shape[1] >= wanted:
                self._recent_count -= self._recent.popleft().volts.shape[1]
            for averages in self._averager.push(block):
                self._publish(averages)

    def _publish(self, block: VoltBlock) -> None:
        message = BenchSamples(sample_period=1 / self._rate, sequence=block.sequence)
        message.header.stamp = self.stamp(block.time)
        for name, values in zip(UNITS, to_si(block.volts, self._channels), strict=True):
            setattr(message, name, array.array("d", values.tobytes()))
        self._samples.publish(message)

    def _set_rate(self, rate: Any) -> None:
        averager = self._make_averager(rate)
        with self._lock:
            self._lost_before += self._averager.lost
            self._averager, self._rate = averager, float(rate)
            self._publish_calibration()

    def _tare(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            try:
                if self._volts != 0:
                    raise InputError(f"tare: the coil is driven ({self._volts:.3g} V); stop the setpoints first")
                blocks = [block.volts for block in self._recent] or [np.zeros((len(UNITS), 0))]
                self._channels = tared(np.hstack(blocks), self._channels)
            except InputError as error:
                response.message = str(error)
                return response
            self._tared = self.bench.now()
            self._publish_calibration()
        response.success = True
        response.message = "zero: " + ", ".join(
            f"{name} {channel.zero:.4f} V" for name, channel in self._channels.items() if channel.tare
        )
        return response

    def _publish_calibration(self) -> None:
        channels = [channel for _, channel in self._channels.items()]
        message = Calibration(
            quantity=list(UNITS),
            unit=list(UNITS.values()),
            channel=[channel.input for channel in channels],
            gain=[channel.gain for channel in channels],
            zero=[channel.zero for channel in channels],
            rate=self._rate,
            hardware_rate=self.config.hardware_rate,
            device=self._backend.product,
        )
        message.header.stamp = self.stamp(self._tared)
        self._calibration.publish(message)

    # Coil

    def _send(self, volts: float) -> None:
        message = AnalogOutput(coil_command=volts)
        message.header.stamp = self.stamp()
        self._output.publish(message)

    def _write(self, volts: float) -> None:
        try:
            self._backend.write(volts)
            self._volts = volts
        except AcquisitionError as error:
            self._fail(str(error))

    def _fail(self, line: str) -> None:
        """Latch a fault of the converter."""
        with self._lock:
            if self._fault:
                return
            self._fault = line
        self.get_logger().error(line)
        with contextlib.suppress(AcquisitionError):
            self._backend.write(0.0)
        self._volts = 0.0

    def _on_setpoint(self, setpoint: Setpoint) -> None:
        now = self.bench.now()
        stamp = seconds(setpoint.header.stamp)
        if now - stamp > self.config.setpoint_timeout:
            self._refused = f"a setpoint was {now - stamp:.3g} s old"
            return
        # A stamp in the future must not keep the coil on when its sender is gone.
        self._heard = min(stamp, now)
        if not np.isfinite(setpoint.coil_current):
            self._refused = f"a setpoint asked for {setpoint.coil_current} A"
        if not self._stopped and not self._fault:
            self._write(coil_voltage(setpoint.coil_current, self.config.coil, self.config.limits))

    def _watch_setpoint(self) -> None:
        if self._volts != 0 and self.bench.now() - self._heard > self.config.setpoint_timeout:
            self._write(0.0)

    def _on_emergency_stop(self, message: Bool) -> None:
        if message.data:
            self._stopped = True
            self._write(0.0)

    def _reset_fault(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._fault:
            try:
                if not self._parked.wait(timeout=3.0):
                    raise InputError("the converter does not answer; check it and start the node anew")
                self._backend.close()
                self._backend.open()
            except InputError as error:
                response.message = f"daq: {error}"
                return response
            self._parked.clear()
            self._fault = ""
            self._resume.set()
        self._refused = ""
        self._stopped = False
        response.success = True
        return response

    def diagnose(self) -> tuple[str, dict[str, Any]]:
        """Fault or latched stop; what was lost, clipped or refused."""
        problem = self._fault or ("the emergency stop is latched; call reset_fault" if self._stopped else "")
        values: dict[str, Any] = {
            "device": self._backend.product,
            "rate_hz": self._rate,
            "coil_V": self._volts,
            "lost_readings": self._lost_before + self._averager.lost,
            "refused": self._refused,
        }
        return problem, values | dict(zip((f"clipped_{name}" for name in UNITS), self._clipped.tolist(), strict=True))

    def close(self) -> None:
        """Put the coil at 0 V, first and last."""
        self._stopped = True
        with contextlib.suppress(Exception):
            self._backend.write(0.0)
        self._closing.set()
        self._resume.set()
        self._thread.join(timeout=3.0)
        with contextlib.suppress(Exception):
            self._backend.close()


def main() -> None:
    """Run the node."""
    run_node(Daq)


if __name__ == "__main__":
    main()
