"""The NI USB-6216, through the Python package nidaqmx and NI's driver NI-DAQmx."""

import contextlib
from typing import Any

import numpy as np

from mrd_base import BenchClock, InputError
from mrd_bench_driver.acquisition.backend import AcquisitionError, ConverterSettings, VoltBlock
from mrd_bench_driver.acquisition.channels import OUTPUT_RANGE

# Blocks that NI's driver buffers before it overruns: a second of them at the default of 20 ms.
_BUFFERED_BLOCKS = 50

# Share of the deviation of a block's arrival by which the time of the readings is corrected. The clock of the converter
# deviates from ours by about 50 ppm, while single reads come milliseconds late.
_CLOCK_CORRECTION = 0.01

_REMEDIES = {
    -200220: "there is no such device; set `device` to a name of NI's hardware configuration, and check the cable",
    -200170: "there is no such terminal; correct the channel map",
    -50103: "another program uses the device; close it",
    -200022: "another program uses the device; close it",
    -200284: "no readings came in time; check the cable and the device's lamp",
    -200279: "the readings were not fetched in time; lower hardware_rate_hz or the load on this machine",
    -200361: "the device's memory overflowed; lower hardware_rate_hz or use a USB port of its own",
    -200324: "the device is gone; plug it in",
    -201003: "the device is gone; plug it in",
    -200045: "the device is gone; plug it in",
    -200081: "too fast for so many channels; lower hardware_rate_hz",
    -200561: "the coil's voltage is not one that the output can give; correct the section coil",
}


class NiUsb6216:
    """Backend of the real converter, with continuous clocked input and a static output."""

    def __init__(self, wiring: ConverterSettings, clock: BenchClock) -> None:
        self.product = ""
        self._wiring = wiring
        self._clock = clock
        self._input: Any = None
        self._output: Any = None
        self._reader: Any = None
        self._errors: Any = None
        self._buffer = np.zeros((0, 0))
        self._sequence = 0
        self._time: float | None = None  # of the next block's first reading

    def open(self) -> None:
        """Set the coil output to 0 V and start sampling."""
        try:
            import nidaqmx
            import nidaqmx.errors
        except ImportError:
            raise InputError(
                "backend ni_usb_6216 needs the Python package nidaqmx: install it with `pip install nidaqmx`, and "
                "NI-DAQmx from NI, or set backend: simulated"
            ) from None
        self._errors = nidaqmx.errors
        try:
            self._start(nidaqmx)
        except nidaqmx.errors.Error as error:
            self.close()
            raise InputError(self._message(error)) from None
        except BaseException:
            self.close()
            raise

    def _start(self, nidaqmx: Any) -> None:
        from nidaqmx import constants, stream_readers, system

        wiring = self._wiring
        device = system.System.local().devices[wiring.device]
        device.reset_device()  # a program that was killed may have left a voltage on the output
        self.product = f"{device.product_type} {device.serial_num:X}"
        self._output = nidaqmx.Task()
        self._output.ao_channels.add_ao_voltage_chan(
            f"{wiring.device}/{wiring.coil.output}", min_val=-OUTPUT_RANGE, max_val=OUTPUT_RANGE
        )
        self._output.write(0.0)

        self._input = nidaqmx.Task()
        for name, channel in wiring.channels.items():
            self._input.ai_channels.add_ai_voltage_chan(
                f"{wiring.device}/{channel.input}",
                name_to_assign_to_channel=name,
                terminal_config=constants.TerminalConfiguration[channel.terminal],
                min_val=-channel.range,
                max_val=channel.range,
            )
        count = wiring.block_samples
        self._input.timing.cfg_samp_clk_timing(
            wiring.hardware_rate, sample_mode=constants.AcquisitionType.CONTINUOUS, samps_per_chan=_BUFFERED_BLOCKS * count
        )
        actual = float(self._input.timing.samp_clk_rate)
        if abs(actual / wiring.hardware_rate - 1) > 1e-4:
            raise InputError(
                f"{wiring.device} can sample at {actual:g} Hz, not at {wiring.hardware_rate:g}; set hardware_rate_hz "
                "to a whole fraction of 20 MHz"
            )
        self._buffer = np.zeros((len(list(wiring.channels.items())), count))
        self._reader = stream_readers.AnalogMultiChannelReader(self._input.in_stream)
        # The numbers start again. The averager sees the step back and infers the lost readings from the time.
        self._sequence, self._time = 0, None
        self._input.start()

    def read(self) -> VoltBlock | None:
        """Wait for the next block."""
        count = self._buffer.shape[1]
        try:
            self._reader.read_many_sample(self._buffer, count, timeout=1.0 + 5 * self._wiring.block)
        except self._errors.Error as error:
            raise AcquisitionError(self._message(error)) from None
        length = count / self._wiring.hardware_rate
        arrived = self._clock.now() - length
        self._time = arrived if self._time is None else self._time + _CLOCK_CORRECTION * (arrived - self._time)
        block = VoltBlock(self._sequence, self._time, self._buffer.copy())
        self._time += length
        self._sequence += count
        return block

    def write(self, volts: float) -> None:
        """Set the voltage of the coil output."""
        if self._output is None:
            raise AcquisitionError(f"{self._wiring.device} is not open; call daq/reset_fault")
        try:
            self._output.write(volts)
        except self._errors.Error as error:
            raise AcquisitionError(self._message(error)) from None

    def close(self) -> None:
        """Set the output to 0 V and close all tasks. A step that fails does not prevent the next ones."""
        output, reading, self._output, self._input = self._output, self._input, None, None
        if output is not None:
            # An output keeps its last voltage when its task ends.
            with contextlib.suppress(Exception):
                output.write(0.0)
            with contextlib.suppress(Exception):
                output.close()
        if reading is not None:
            with contextlib.suppress(Exception):
                reading.close()

    def _message(self, error: Any) -> str:
        """Return one line with a remedy for an error of NI's driver."""
        if isinstance(error, self._errors.DaqNotFoundError):
            return (
                "NI-DAQmx is not installed: install it from NI (on Linux check that it supports the USB-6216), or set "
                "backend: simulated"
            )
        code = getattr(error, "error_code", None)
        remedy = _REMEDIES.get(code) if code is not None else None
        if remedy is None:
            first = (str(error).strip().splitlines() or [type(error).__name__])[0]
            remedy = f"{first} Look the code up in NI's documentation"
        return f"{self._wiring.device}: error {code}: {remedy}"
