"""The DAQ: it turns the readings of a backend into samples, and sets the coil current."""

import collections
import contextlib
import math
import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from mrd_base import BenchClock, InputError
from mrd_base.lease import is_timely
from mrd_bench_driver.acquisition.averaging import Averager, averaging_ratio
from mrd_bench_driver.acquisition.backend import AcquisitionError, Backend, VoltBlock
from mrd_bench_driver.acquisition.channels import ChannelMap, coil_voltage, count_clipped, tare, to_si
from mrd_bench_driver.acquisition.config import DaqConfig
from mrd_bench_driver.acquisition.output import OutputSilentError, OutputWriter

# Wall time in s for the reading thread to notice a fault or the end; a read returns within this time.
_READ_TIMEOUT = 3.0
# Wall time in s for the converter to close; one that hangs must not keep the process from ending.
_CLOSE_TIMEOUT = 1.0
# It comes before the fault, so that nobody cuts it off.
_LIVE_COIL = "the coil may still have current, switch its supply off; "


class Daq:
    """The DAQ. It reads in a thread of its own; all other methods return at once, except `reset_fault` and `close`.

    Where the converter hangs, one of them returns `WRITE_TIMEOUT` later, and the reading thread waits for it.

    Parameters
    ----------
    backend : Backend
        It must be open before `start`; `close` closes it.
    on_readings, on_block : callable
        Receive each block of readings, and each block of averages, in the reading thread.
    on_calibration : callable
        Called when `channels`, `rate` or `tare_time` have changed.
    on_problem : callable
        Receives the fault or the reason of a latched stop when it has changed, and "" after `reset_fault`.

    Attributes
    ----------
    channels : ChannelMap
        Channel map with the zeros of the latest tare.
    rate : float
        Sample rate in Hz.
    tare_time : float
        Bench time in s of the latest tare, or of the start.
    """

    def __init__(
        self,
        config: DaqConfig,
        clock: BenchClock,
        backend: Backend,
        on_readings: Callable[[VoltBlock], None],
        on_block: Callable[[VoltBlock], None],
        on_calibration: Callable[[], None],
        on_problem: Callable[[str], None],
    ) -> None:
        self._config, self._clock, self._backend = config, clock, backend
        self._output = OutputWriter(backend)
        self._on_readings, self._on_block = on_readings, on_block
        self._on_calibration, self._on_problem = on_calibration, on_problem
        # Two threads write the output: without order, the older command could be the last one that the converter gets.
        self._lock = threading.RLock()
        self.channels: ChannelMap = config.channels
        self.rate = config.rate
        self.tare_time = clock.now()

        self._averager = self._make_averager(config.rate)
        self._recent: collections.deque[VoltBlock] = collections.deque()  # readings for a tare
        self._recent_count = 0
        self._quantities = [name for name, _ in config.channels.items()]
        self._clipped = np.zeros(len(self._quantities), np.int64)
        self._lost_before = 0  # readings lost at earlier sample rates

        self._emergency_stop = ""  # reason of the latched stop
        self._tared = False
        self._fault = ""
        self._refused = ""  # why the latest refused setpoint was refused
        self._setpoint_time = -math.inf
        self._told = ""  # the problem that was told last
        self._volts = 0.0  # on the coil output, as last written with success
        self._live = False  # whether the output may have another voltage than 0: a write that failed may have come through
        self._stuck = False  # whether the latest try to set a live output to 0 V failed
        self._commands: collections.deque[tuple[float, float]] = collections.deque([(-math.inf, 0.0)])  # times and A

        self._closing = threading.Event()
        self._paused = threading.Event()  # the reading thread has noticed a fault
        self._resume = threading.Event()
        self._thread = threading.Thread(target=self._read, name="acquisition", daemon=True)

    def start(self) -> None:
        """Start to read."""
        self._thread.start()

    def close(self) -> None:
        """Set the coil output to 0 V, stop reading, and close the backend."""
        with self._lock:
            self._emergency_stop = "the node ends"
            self._told = self.problem  # nobody needs to hear of that
            with contextlib.suppress(Exception):
                self._output.write(0.0)
        self._closing.set()
        self._resume.set()
        self._thread.join(timeout=_READ_TIMEOUT)
        closer = threading.Thread(target=self._close_backend, name="close", daemon=True)
        closer.start()
        closer.join(timeout=_CLOSE_TIMEOUT)

    def _close_backend(self) -> None:
        with contextlib.suppress(Exception):
            self._backend.close()

    # Samples

    def _make_averager(self, rate: float) -> Averager:
        ratio = averaging_ratio(rate, self._config.hardware_rate)
        return Averager(ratio, max(1, round(self._config.block * rate)), self._config.hardware_rate)

    def _read(self) -> None:
        try:
            self._read_until_closed()
        except Exception as error:
            # Without this thread, a process that lives on would look sound.
            try:
                self._fail(f"internal error: {error!r}")
            finally:
                os.kill(os.getpid(), signal.SIGTERM)
            raise

    def _read_until_closed(self) -> None:
        while not self._closing.is_set():
            if self._fault:
                self._paused.set()
                self._resume.wait()
                self._resume.clear()
                continue
            try:
                block = self._backend.read()
            except AcquisitionError as error:
                self._fail(str(error))
                continue
            if block is not None and not self._closing.is_set():
                self._process(block)

    def _process(self, block: VoltBlock) -> None:
        with self._lock:
            self._clipped += count_clipped(block.volts, self.channels)
            self._on_readings(block)
            self._recent.append(block)
            self._recent_count += block.volts.shape[1]
            needed = self._config.tare_duration * self._config.hardware_rate
            while self._recent_count - self._recent[0].volts.shape[1] >= needed:
                self._recent_count -= self._recent.popleft().volts.shape[1]
            for averages in self._averager.push(block):
                self._on_block(averages)

    # The checks see the readings, not their averages: a sample at 25 Hz comes late, and hides the peak that it averages.

    def check_inputs(self, block: VoltBlock) -> None:
        """Stop at an input of a bench in motion that cannot be right, or at too much force; a single reading is none.

        A position, force or current at the end of its range cannot be right.
        """
        # With the reading before it, because a short block may hold a single one.
        volts = np.hstack([*(earlier.volts[:, -1:] for earlier in list(self._recent)[-1:]), block.volts])
        for (name, channel), count in zip(self.channels.items(), count_clipped(volts, self.channels), strict=True):
            # An accelerometer may be overdriven without danger, and of the temperature the supervisor knows the limit.
            if count > 1 and name not in ("acceleration", "temperature"):
                self.emergency_stop(
                    f"{channel.input} ({name}) reads the end of its range, ±{channel.range:g} V; check the sensor, its "
                    "supply and wiring"
                )
        force, limit = to_si(volts, self.channels)[self._quantities.index("force")], self._config.limits.force
        beyond = force[np.abs(force) > limit]
        if len(beyond) > 1:
            self.emergency_stop(
                f"{beyond[0]:.0f} N on the load cell, limit ±{limit:.0f} N; reduce coil current or speed, or check the cell"
            )

    def check_coil(self, block: VoltBlock) -> None:
        """Stop at a coil current that does not follow its command: coil, supply or sensor is broken.

        It is compared with all that was commanded within `coil_response`. Before the first tare, the sensor may be off by
        what a tare may take away.
        """
        current = float(to_si(block.volts, self.channels)[self._quantities.index("coil_current")].mean())
        lowest, highest = self._commanded_since(block.time - self._config.coil_response)
        channel = self._config.channels.coil_current
        untared = abs(channel.gain) * channel.tare_limit if channel.tare and not self._tared else 0.0
        tolerance = self._config.coil_tolerance + 0.1 * highest + untared
        if not lowest - tolerance <= current <= highest + tolerance:
            commanded = f"{lowest:.2f} A" if lowest == highest else f"{lowest:.2f} to {highest:.2f} A"
            self.emergency_stop(
                f"the coil current is {current:.2f} A, commanded {commanded}; check coil, cable, supply and sensor"
            )

    def _commanded_since(self, time: float) -> tuple[float, float]:
        """Return the lowest and the highest coil current in A commanded since a bench time."""
        with self._lock:
            while len(self._commands) > 1 and self._commands[1][0] <= time:
                self._commands.popleft()
            currents = [current for _, current in self._commands]
        return min(currents), max(currents)

    def set_rate(self, rate: Any) -> None:
        """Set the sample rate in Hz; raise InputError unless it divides the rate of the converter."""
        averager = self._make_averager(rate)
        with self._lock:
            self._lost_before += self._averager.lost
            self._averager, self.rate = averager, float(rate)
            self._on_calibration()

    def tare(self) -> str:
        """Set the zeros of the channels marked for a tare; return the message of success, or raise InputError."""
        with self._lock:
            if self._volts != 0:
                raise InputError(f"tare: the coil is driven ({self._volts:.3g} V); stop the setpoints first")
            blocks = [block.volts for block in self._recent] or [np.zeros((len(self._quantities), 0))]
            self.channels = tare(np.hstack(blocks), self._config.channels)
            self._tared = True
            self.tare_time = self._clock.now()
            self._on_calibration()
        zeros = [f"{name} {channel.zero:.4f} V" for name, channel in self.channels.items() if channel.tare]
        return "zero: " + ", ".join(zeros)

    # The coil

    def set_coil_current(self, current: float, time: float) -> None:
        """Set the coil current in A that a timely setpoint of bench time ``time`` asks for, unless the DAQ stopped."""
        now = self._clock.now()
        if not is_timely(time, now, self._config.setpoint_timeout):
            self._refused = f"a setpoint is stamped {now - time:.3g} s before it came"
            return
        # A stamp in the future must not keep the coil on after its sender has stopped.
        self._setpoint_time = min(time, now)
        if not math.isfinite(current):
            self._refused = f"a setpoint asked for {current} A"
        limits = self._config.limits
        allowed = min(max(current, limits.current_min), limits.current_max) if math.isfinite(current) else 0.0
        with self._lock:
            if not self._emergency_stop and not self._fault:
                self._write(coil_voltage(current, self._config.coil, limits), allowed)

    def check_output(self) -> None:
        """Set the coil output to 0 V if no setpoint has come for too long, or if that failed when the DAQ stopped."""
        with self._lock:
            if self.problem or self._clock.now() - self._setpoint_time > self._config.setpoint_timeout:
                self.rest()

    def rest(self) -> None:
        """Set the coil output to 0 V until the next setpoint."""
        with self._lock:
            if self._live:
                self._write(0.0)

    def emergency_stop(self, reason: str = "emergency stop", *, tell_again: bool = False) -> None:
        """Set the coil output to 0 V until `reset_fault`; the first reason stays, and is told again on request."""
        with self._lock:
            self._emergency_stop = self._emergency_stop or reason
            if tell_again:
                self._told = ""
            self._write(0.0)

    def _write(self, volts: float, current: float = 0.0) -> None:
        with self._lock:
            self._live = self._live or volts != 0
            try:
                self._output.write(volts)
            except OutputSilentError as error:
                # No fault, because the inputs are still read.
                self._stuck = self._live
                if str(error) not in self._emergency_stop:
                    self._emergency_stop = "; ".join(filter(None, (self._emergency_stop, str(error))))
            except AcquisitionError as error:
                self._stuck = self._live and volts == 0
                self._fail(str(error))
            else:
                self._note_output(volts, current)
            self._tell()

    def _note_output(self, volts: float, current: float) -> None:
        """Note what is on the output, and the coil current in A that it commands."""
        self._volts, self._live, self._stuck = volts, volts != 0, False
        if current != self._commands[-1][1]:
            self._commands.append((self._clock.now(), current))

    # Faults

    def _fail(self, message: str) -> None:
        with self._lock:
            if self._fault:
                return
            self._fault = message
            self._write(0.0)  # tells then: whoever is told may block

    def _tell(self) -> None:
        """Tell the problem if it has changed; under the lock, so that the latest is told last."""
        if (problem := self.problem) != self._told:
            self._told = problem
            self._on_problem(problem)

    def reset_fault(self) -> None:
        """Release the emergency stop and restart a converter that failed; raise InputError if it does not restart."""
        if not self._fault:
            self.rest()  # after a stop whose 0 V was not taken in time
        if self._output.silent:
            raise InputError("the converter's output does not answer; check it and restart the node")
        if self._fault:
            if not self._paused.wait(timeout=_READ_TIMEOUT):
                raise InputError("the converter does not answer; check it and restart the node")
            self._backend.close()
            self._backend.open()
            self._paused.clear()
            with self._lock:
                self._note_output(0.0, 0.0)  # set by `open`
                self._fault = ""
            self._resume.set()
        with self._lock:
            self._refused = self._emergency_stop = ""
            self._tell()

    @property
    def lost(self) -> int:
        """Number of lost readings of the converter."""
        return self._lost_before + self._averager.lost

    @property
    def problem(self) -> str:
        """The fault, or the reason of a latched stop, or ""."""
        problem = self._fault or (f"{self._emergency_stop}; call reset_fault" if self._emergency_stop else "")
        return f"{_LIVE_COIL}{problem}" if problem and self._stuck else problem

    def health(self) -> tuple[str, dict[str, Any]]:
        """Return the fault or the latched stop, and counts of lost and clipped readings and the latest refused setpoint."""
        values: dict[str, Any] = {
            "device": self._backend.product,
            "rate_hz": self.rate,
            "coil_V": self._volts,
            "lost_readings": self.lost,
            "refused": self._refused,
        }
        clipped = (f"clipped_{name}" for name in self._quantities)
        return self.problem, values | dict(zip(clipped, self._clipped.tolist(), strict=True))
