"""Calibration of the analog channels: volts to SI units and back, tare, clipping."""

import dataclasses
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError, quantity
from mrd_base.quantities import ZERO_CELSIUS
from mrd_trajectory.limits import Limits

Array = NDArray[np.float64]

# Quantities in the order of the channel map, with their SI units. A bench may have no temperature, which is the last.
UNITS = {"position": "m", "force": "N", "coil_current": "A", "acceleration": "m/s^2", "temperature": "K"}
# Terminal configurations and input ranges (± V) of the USB-6216.
TERMINALS = ("DIFF", "RSE", "NRSE")
INPUT_RANGES = (10.0, 5.0, 1.0, 0.2)
# Range (± V) of its analog outputs.
OUTPUT_RANGE = 10.0
# Least number of samples of a tare: fewer determine the zero poorly and do not average out mains hum.
MIN_TARE_SAMPLES = 20
# Share of the range, from either end, in which a reading may have been clipped.
CLIPPING_MARGIN = 1e-3


@dataclass(frozen=True)
class InputChannel:
    """One analog input: value = gain · (voltage − zero)."""

    input: str = quantity("ai0", doc="terminal of the converter")
    terminal: str = quantity("DIFF", doc="DIFF, RSE or NRSE")
    range: float = quantity(10.0, "V", "input range, ±; the USB-6216 has 10, 5, 1 and 0.2 V")
    gain: float = quantity(1.0, doc="SI units per volt: m/V, N/V, A/V or (m/s2)/V")
    zero: float = quantity(0.0, "V", "voltage at which the quantity is zero", lower=-10, upper=10)
    tare: bool = quantity(False, doc="whether daq/tare sets the zero to the voltage at rest")
    rest: float = quantity(0.02, "V", "standard deviation above which the signal is not at rest", lower=1e-6, upper=10)
    tare_limit: float = quantity(0.02, "V", "largest distance of a tared zero from zero_V", lower=1e-4, upper=10)

    def __post_init__(self) -> None:
        _check_input(self.input, self.terminal, self.range, self.gain)


@dataclass(frozen=True)
class TemperatureChannel:
    """The analog input of the damper's temperature, behind the amplifier of a thermocouple or an RTD.

    The temperature is 0 °C + gain · (voltage − zero_celsius). It is never tared.
    """

    input: str = quantity("", doc="terminal of the converter; empty where there is no sensor")
    terminal: str = quantity("DIFF", doc="DIFF, RSE or NRSE")
    range: float = quantity(5.0, "V", "input range, ±; the USB-6216 has 10, 5, 1 and 0.2 V")
    gain: float = quantity(200.0, "K/V", "kelvins per volt; 200 of an AD8495 with 5 mV/K")
    zero_celsius: float = quantity(1.25, "V", "voltage at 0 degC", lower=-10, upper=10)
    tare: ClassVar[bool] = False
    rest: ClassVar[float] = math.inf
    tare_limit: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        _check_input(self.input or "ai0", self.terminal, self.range, self.gain)

    @property
    def zero(self) -> float:
        """Voltage at 0 K, so that value = gain · (voltage − zero) in K as for every channel."""
        return self.zero_celsius - ZERO_CELSIUS / self.gain


def _check_input(terminal_name: str, terminal: str, voltage_range: float, gain: float) -> None:
    if not re.fullmatch(r"ai\d+", terminal_name):
        raise InputError(f"input is {terminal_name!r}, expected a terminal such as ai0")
    if terminal not in TERMINALS:
        raise InputError(f"terminal is {terminal!r}, expected one of {', '.join(TERMINALS)}")
    if voltage_range not in INPUT_RANGES:
        raise InputError(f"range_V is {voltage_range:g}, expected one of {', '.join(f'{r:g}' for r in INPUT_RANGES)}")
    if gain == 0:
        raise InputError("gain is 0, expected the unit of the quantity per volt")


AnyChannel = InputChannel | TemperatureChannel


@dataclass(frozen=True)
class ChannelMap:
    """The analog input of each quantity, in the order in which blocks of samples carry them."""

    # LVDT of ±50 mm behind a conditioner of ±10 V.
    position: InputChannel = InputChannel("ai0", gain=5e-3)
    # 100 kg cell of 2 mV/V, excitation 10 V, amplifier 250.
    force: InputChannel = InputChannel("ai1", gain=196.133)
    # ACS714-05B, 185 mV/A around half of its 5 V supply.
    coil_current: InputChannel = InputChannel("ai2", range=5.0, gain=5.405405405405405, zero=2.5, tare=True)
    # MMA7361L, 800 mV/g around half of its 3.3 V supply. Mounted upright, it reads 1 g at rest.
    acceleration: InputChannel = InputChannel(
        "ai4", range=5.0, gain=12.2583125, zero=1.65, tare=True, rest=0.03, tare_limit=1.0
    )
    temperature: TemperatureChannel = TemperatureChannel()

    def __post_init__(self) -> None:
        inputs = [channel.input for _, channel in self.items()]
        duplicates = {entry for entry in inputs if inputs.count(entry) > 1}
        if duplicates:
            raise InputError(f"input {', '.join(sorted(duplicates))} is given to two quantities, expected one terminal each")

    def items(self) -> Iterator[tuple[str, AnyChannel]]:
        """Iterate over quantities and channels in the order of the blocks; without the temperature where it has no input."""
        for field in dataclasses.fields(self):
            channel = getattr(self, field.name)
            if channel.input:
                yield field.name, channel


@dataclass(frozen=True)
class CoilOutput:
    """The analog output that sets the coil current: current = current_per_volt · (voltage ∓ dead_zone), 0 A at 0 V."""

    output: str = quantity("ao0", doc="terminal of the converter")
    current_per_volt: float = quantity(0.2, "A", "gain of the coil supply: current per volt at its control input")
    dead_zone: float = quantity(0.0, "V", "largest voltage, ±, at which the supply gives no current", lower=0, upper=5)

    def __post_init__(self) -> None:
        if self.current_per_volt == 0:
            raise InputError("current_per_volt_A is 0, expected the gain of the coil supply")


def to_si(volts: Array, channels: ChannelMap) -> Array:
    """Convert volts (channels, n) to position in m, force in N, coil current in A, acceleration in m/s², temperature in K.

    The temperature is nan where its voltage is at an end of the range: unlike a force that is too large, it tells nothing.
    """
    gain = np.array([channel.gain for _, channel in channels.items()])
    zero = np.array([channel.zero for _, channel in channels.items()])
    si: Array = gain[:, None] * (volts - zero[:, None])
    if channels.temperature.input:
        si[-1, np.abs(volts[-1]) >= channels.temperature.range * (1 - CLIPPING_MARGIN)] = math.nan
    return si


def count_clipped(volts: Array, channels: ChannelMap) -> NDArray[np.int64]:
    """Count the readings per channel (channels,) at an end of the input range; their true values may lie beyond it."""
    ends = np.array([channel.range * (1 - CLIPPING_MARGIN) for _, channel in channels.items()])
    clipped: NDArray[np.int64] = np.count_nonzero(np.abs(volts) >= ends[:, None], axis=1)
    return clipped


def tare(volts: Array, configured: ChannelMap) -> ChannelMap:
    """Return the channel map with the mean of ``volts`` (channels, n) as zero of each channel that is marked for a tare.

    Raises
    ------
    InputError
        If there are too few samples, the rod or a signal marked for a tare is not at rest, or the new zero is further than
        `tare_limit` from the configured one: what flows or pulls at rest must not be called zero.
    """
    count = volts.shape[1]
    if count < MIN_TARE_SAMPLES:
        raise InputError(f"tare: {count} samples, expected {MIN_TARE_SAMPLES} or more; let the DAQ sample for a while")
    # A moving rod changes the other signals. So the position must rest even if it is not tared itself.
    for (name, channel), signal in zip(configured.items(), volts, strict=True):
        deviation = float(np.std(signal))
        if (channel.tare or name == "position") and not deviation <= channel.rest:
            raise InputError(
                f"tare: {name} is not at rest (standard deviation {1e3 * deviation:.3g} mV, at most "
                f"{1e3 * channel.rest:.3g} mV); stop rod and coil, or check the wiring"
            )
        shift = float(np.mean(signal)) - channel.zero
        if channel.tare and not abs(shift) <= channel.tare_limit:
            raise InputError(
                f"tare: {name} reads {channel.gain * shift:.3g} {UNITS[name]} by its zero_V, {1e3 * shift:+.3g} mV (limit "
                f"±{1e3 * channel.tare_limit:.3g} mV); make sure that it is zero now, or correct zero_V"
            )
    zeros: dict[str, Any] = {
        name: dataclasses.replace(channel, zero=float(np.mean(signal)))
        for (name, channel), signal in zip(configured.items(), volts, strict=True)
        if isinstance(channel, InputChannel) and channel.tare
    }
    return dataclasses.replace(configured, **zeros)


def coil_voltage(current: float, coil: CoilOutput, limits: Limits) -> float:
    """Return the control voltage in V for a coil current in A, clipped to the limits, and 0 V if it is not finite."""
    if not math.isfinite(current):
        return 0.0
    allowed = min(max(current, limits.current_min), limits.current_max)
    if allowed == 0:
        return 0.0
    volts = allowed / coil.current_per_volt
    return float(min(max(volts + math.copysign(coil.dead_zone, volts), -OUTPUT_RANGE), OUTPUT_RANGE))
