"""The measuring chain: from position, force, current and acceleration to the volts that the converter reads.

Each sensor is a transducer (SI to volts), a first-order lag, noise and output rails; then comes the converter. A good bench
has the same anti-alias filter on all channels whose samples are compared with each other, because a difference of their lags
opens the loops. Position, force and current have 250 Hz by default; the accelerometer has another filter.

Figures: table 2 of the source paper with the corrections and data-sheet values of the parts (class figures of LVDTs and load
cells, Allegro ACS714, Freescale MMA7361L, NI USB-6216).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import InputError, quantity
from mrd_base.quantities import ZERO_CELSIUS
from mrd_sim.named import named_row

Array = NDArray[np.float64]

_G = 9.80665  # m/s²


class Sensor(Protocol):
    """A sensor as `MeasuringChain` uses it."""

    @property
    def channel(self) -> str:
        """Terminal of the converter to which the sensor is wired."""

    @property
    def converter_range(self) -> float:
        """± V, range to which that terminal is set."""

    @property
    def bandwidth(self) -> float:
        """Hz, -3 dB."""

    @property
    def noise_volts(self) -> float:
        """V rms on the output, within the bandwidth."""

    @property
    def rails(self) -> tuple[float, float]:
        """Lowest and highest V that the output can reach."""

    def volts(self, value: Array) -> Array:
        """Return the output in V at rest with ``value`` (SI)."""


@dataclass(frozen=True)
class Lvdt:
    """Position: LVDT with conditioner, ± 10 V over the travel.

    Class figures of 100 mm LVDTs: linearity 0.1-0.5 % of full scale, bandwidth 100-250 Hz, noise 5-10 µm. The curve error is
    odd (cubic), zero in the middle.
    """

    channel: str = quantity("ai0", "", "terminal")
    converter_range: float = quantity(10.0, "V", "± range of the terminal", lower=0.2, upper=10)
    travel: float = quantity(0.1, "mm", "of the core, end to end", lower=1e-3, upper=1)
    gain_error: float = quantity(0.0, "", "relative", lower=-0.5, upper=0.5)
    linearity: float = quantity(0.001, "", "curve error at the ends, relative to half the travel", lower=-0.05, upper=0.05)
    offset: float = quantity(0.002, "V", "at mid-stroke", lower=-5, upper=5)
    noise: float = quantity(5e-6, "mm", "rms", lower=0, upper=1e-3)
    bandwidth: float = quantity(250.0, "Hz", "-3 dB", lower=1, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Rails of the conditioner in V."""
        return -11.0, 11.0

    @property
    def noise_volts(self) -> float:
        """Noise in V rms."""
        return 10.0 * self.noise / (self.travel / 2)

    def volts(self, value: Array) -> Array:
        """Return the output in V for a position in m."""
        share = np.clip(value / (self.travel / 2), -1.1, 1.1)
        return self.offset + 10.0 * ((1.0 + self.gain_error) * share + self.linearity * share**3)


@dataclass(frozen=True)
class LoadCell:
    """Force: strain-gauge cell of 100 kg (980.665 N), 2 mV/V, with bridge amplifier: 5 V at rated load.

    The combined error of such cells is 0.02-0.05 % of full scale; the gain tolerance is 10 %, of which a calibration
    leaves 0.2 %. Noise of the bridge amplifier about 0.3 N rms.
    """

    channel: str = quantity("ai1", "", "terminal")
    converter_range: float = quantity(10.0, "V", "± range of the terminal", lower=0.2, upper=10)
    capacity: float = quantity(980.665, "N", "rated load", lower=1, upper=1e6)
    rated_output: float = quantity(0.002, "mV/V", "at rated load", lower=1e-4, upper=0.01)
    excitation: float = quantity(10.0, "V", "of the bridge", lower=0.1, upper=20)
    amplification: float = quantity(250.0, "", "of the amplifier", lower=1, upper=10000)
    gain_error: float = quantity(0.002, "", "relative", lower=-0.9, upper=10)
    offset: float = quantity(0.005, "V", "of amplifier and mounting, left after calibration", lower=-5, upper=5)
    noise: float = quantity(0.3, "N", "rms", lower=0, upper=100)
    bandwidth: float = quantity(250.0, "Hz", "-3 dB", lower=1, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Rails of the amplifier in V."""
        return -10.0, 10.0

    @property
    def _volts_per_newton(self) -> float:
        return self.amplification * self.excitation * self.rated_output / self.capacity

    @property
    def noise_volts(self) -> float:
        """Noise in V rms."""
        return self.noise * self._volts_per_newton

    def volts(self, value: Array) -> Array:
        """Return the output in V for a force in N."""
        return self.offset + (1.0 + self.gain_error) * self._volts_per_newton * value


@dataclass(frozen=True)
class CurrentSensor:
    """Coil current: Allegro ACS714-05B, 185 mV/A around half its supply, both in proportion to the supply; ±1.5 %.

    Its 21 mV peak to peak at 2 kHz are about 19 mA rms; filtered to 250 Hz, sqrt(250/2000) of that remains: 6.7 mA.
    """

    channel: str = quantity("ai2", "", "terminal")
    converter_range: float = quantity(5.0, "V", "± range of the terminal", lower=0.2, upper=10)
    sensitivity: float = quantity(0.185, "mV/A", "at 5 V supply", lower=1e-3, upper=1)
    supply: float = quantity(5.0, "V", "of the sensor", lower=4, upper=6)
    gain_error: float = quantity(0.005, "", "relative", lower=-0.5, upper=0.5)
    offset: float = quantity(0.008, "V", "beyond half the supply", lower=-1, upper=1)
    noise: float = quantity(0.0067, "mA", "rms", lower=0, upper=1)
    bandwidth: float = quantity(250.0, "Hz", "-3 dB", lower=1, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Ground and supply in V."""
        return 0.0, self.supply

    @property
    def noise_volts(self) -> float:
        """Noise in V rms."""
        return self.noise * self.sensitivity * self.supply / 5.0

    def volts(self, value: Array) -> Array:
        """Return the output in V for a current in A."""
        slope = (1.0 + self.gain_error) * self.sensitivity * self.supply / 5.0
        return self.supply / 2 + self.offset + slope * value


@dataclass(frozen=True)
class SupplyMonitor:
    """Supply voltage of the current sensor, which scales its readings."""

    channel: str = quantity("ai3", "", "terminal")
    converter_range: float = quantity(10.0, "V", "± range of the terminal (5 V clips at ± 5 V)", lower=0.2, upper=10)
    noise: float = quantity(0.001, "V", "rms", lower=0, upper=1)
    bandwidth: float = quantity(250.0, "Hz", "-3 dB", lower=1, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Rails in V, beyond any supply of the sensor."""
        return 0.0, 6.0

    @property
    def noise_volts(self) -> float:
        """Noise in V rms."""
        return self.noise

    def volts(self, value: Array) -> Array:
        """Return the supply voltage itself."""
        return value


@dataclass(frozen=True)
class Accelerometer:
    """Acceleration of the rod: Freescale MMA7361L, 800 mV/g around 1.65 V at 3.3 V (±1.5 g), one-pole filter.

    400 Hz in its plane, 300 Hz across; 350 µg/√Hz, over the noise bandwidth (pi/2) 400 Hz: 8.8 mg rms. Gain ±7.5 %.
    """

    channel: str = quantity("ai4", "", "terminal")
    converter_range: float = quantity(5.0, "V", "± range of the terminal", lower=0.2, upper=10)
    sensitivity: float = quantity(0.8 / _G, "mV/g", "206 in the ± 6 g range", lower=1e-4, upper=1)
    zero: float = quantity(1.65, "V", "at rest", lower=0, upper=5)
    gain_error: float = quantity(0.02, "", "relative", lower=-0.5, upper=0.5)
    offset: float = quantity(0.01, "V", "beyond the zero", lower=-1, upper=1)
    density_ug_per_sqrt_hz: float = quantity(350.0, "", "of the noise", lower=0, upper=1e5)
    bandwidth: float = quantity(400.0, "Hz", "-3 dB", lower=1, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Ground and supply in V."""
        return 0.0, 2 * self.zero

    @property
    def noise_volts(self) -> float:
        """Noise in V rms. A one-pole filter passes the noise of pi/2 times its bandwidth."""
        rms_g = self.density_ug_per_sqrt_hz * 1e-6 * math.sqrt(math.pi / 2 * self.bandwidth)
        return rms_g * _G * self.sensitivity

    def volts(self, value: Array) -> Array:
        """Return the output in V for an acceleration in m/s²."""
        return self.zero + self.offset + (1.0 + self.gain_error) * self.sensitivity * value


@dataclass(frozen=True)
class Thermometer:
    """Temperature of the damper's body: type K thermocouple behind an AD8495, 5 mV/K around 1.25 V at 0 °C.

    Initial error 1 to 3 °C (grades A and C), gain 0.3 %; the time constant of a glued junction is about a second.
    """

    channel: str = quantity("ai5", "", "terminal; empty where there is no sensor")
    converter_range: float = quantity(5.0, "V", "± range of the terminal", lower=0.2, upper=10)
    sensitivity: float = quantity(0.005, "mV/K", "of the amplifier", lower=1e-5, upper=1)
    zero: float = quantity(1.25, "V", "at 0 degC", lower=-10, upper=10)
    gain_error: float = quantity(0.003, "", "relative", lower=-0.5, upper=0.5)
    offset: float = quantity(0.002, "V", "beyond the zero", lower=-1, upper=1)
    noise: float = quantity(0.2, "K", "rms", lower=0, upper=10)
    bandwidth: float = quantity(1.0, "Hz", "-3 dB", lower=0.01, upper=1e5)

    @property
    def rails(self) -> tuple[float, float]:
        """Ground and supply in V."""
        return 0.0, 5.0

    @property
    def noise_volts(self) -> float:
        """Noise in V rms."""
        return self.noise * self.sensitivity

    def volts(self, value: Array) -> Array:
        """Return the output in V for a temperature in K."""
        return self.zero + self.offset + (1.0 + self.gain_error) * self.sensitivity * (value - ZERO_CELSIUS)


@dataclass(frozen=True)
class SensorsConfig:
    """All sensors of the bench, in the order in which `MeasuringChain.read` takes their values."""

    position: Lvdt = field(default_factory=Lvdt)
    force: LoadCell = field(default_factory=LoadCell)
    current: CurrentSensor = field(default_factory=CurrentSensor)
    supply: SupplyMonitor = field(default_factory=SupplyMonitor)
    acceleration: Accelerometer = field(default_factory=Accelerometer)
    temperature: Thermometer = field(default_factory=Thermometer)

    def wired(self) -> dict[str, Sensor]:
        """Return the sensors that are there, by quantity."""
        sensors = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: sensor for name, sensor in sensors.items() if name != "temperature" or sensor.channel}


_CONVERTER_NOISE = {0.2: 12e-6, 1.0: 26e-6, 5.0: 118e-6, 10.0: 229e-6}
"""V rms of the USB-6216's random noise, by ± range (NI 621x specifications)."""
_CODES = 65536.0
"""Codes of 16 bits."""
_OVERRANGE = 1.05
"""Relative. The converter's codes spread 5 % beyond the range."""


class _Channel(NamedTuple):
    """Constants of a sensor and its terminal that `_measure` needs."""

    keep: float
    """Share of a deviation from the lagged value that a step of the input leaves."""
    mean: float
    """Mean share of a deviation over such a step."""
    fade: float
    """Share of the noise that is left from one sample of the converter to the next."""
    noise: float
    low: float
    high: float
    code: float
    """V between two codes."""
    converter_noise: float


class MeasuringChain:
    """All sensors with their filters, noise and the converter; carries its state from block to block.

    Parameters
    ----------
    sensors : sequence of Sensor
    rate : float
        Hz, of the input values.
    decimation : int
        Input values for each sample of the converter.
    random : numpy Generator
        Source of the noise. The same seed gives the same noise, however the time is cut into blocks.

    Raises
    ------
    InputError
        For two sensors on one terminal, or a range that the converter does not have.
    """

    def __init__(self, sensors: Sequence[Sensor], rate: float, decimation: int, random: np.random.Generator) -> None:
        self.sensors = tuple(sensors)
        self.channels = tuple(sensor.channel for sensor in sensors)
        if len(set(self.channels)) < len(self.channels):
            raise InputError(f"sensors: two are wired to one terminal ({', '.join(self.channels)})")
        self._decimation = decimation
        self._random = random
        channels = [_channel(sensor, rate, decimation) for sensor in sensors]
        self._rows = np.array(channels)
        self._lag: Array | None = None
        self._noise = np.array([channel.noise for channel in channels]) * random.standard_normal(len(sensors))

    def read(self, values: Array) -> Array:
        """Return the volts (sensors, n) that the converter reads over a block of SI values (sensors, n * decimation)."""
        driven = np.stack([sensor.volts(row) for sensor, row in zip(self.sensors, values, strict=True)])
        if driven.shape[1] % self._decimation:
            raise ValueError(f"{driven.shape[1]} values are not a multiple of {self._decimation}")
        if self._lag is None:  # before the first value the input had that value
            self._lag = np.stack([driven[:, 0], driven[:, 0]])
        # Drawn sample by sample, so that the cut into blocks does not change which number meets which sample.
        drawn = self._random.standard_normal((driven.shape[1] // self._decimation, 2, len(self.sensors)))
        volts: Array = _measure(driven, self._rows, self._lag, self._noise, drawn, self._decimation)
        return volts


def _channel(sensor: Sensor, rate: float, decimation: int) -> _Channel:
    if sensor.converter_range not in _CONVERTER_NOISE:
        known = ", ".join(f"{span:g}" for span in _CONVERTER_NOISE)
        raise InputError(
            f"sensors: converter_range_V of {sensor.channel} is {sensor.converter_range:g}, expected one of {known}"
        )
    step = 2.0 * math.pi * sensor.bandwidth / rate
    keep = math.exp(-step)
    low, high = sensor.rails
    return _Channel(
        keep=keep,
        mean=(1.0 - keep) / step,
        fade=keep**decimation,
        noise=sensor.noise_volts,
        low=low,
        high=high,
        code=2.0 * _OVERRANGE * sensor.converter_range / _CODES,
        converter_noise=_CONVERTER_NOISE[sensor.converter_range],
    )


@njit(cache=True, nogil=True)
def _measure(driven: Array, rows: Array, lag: Array, noise: Array, drawn: Array, decimation: int) -> Array:
    """Apply lag, sensor noise, rails, converter noise and quantisation; ``lag`` and ``noise`` are carried on.

    The lag is exact for an input that is linear between samples (ramp-invariant). The noise has the bandwidth of the lag
    and its exact correlation between the converter's samples (Ornstein-Uhlenbeck).
    """
    channels, count = driven.shape
    volts = np.empty((channels, count // decimation))
    for i in range(channels):
        channel = named_row(_Channel, rows, i)
        spread = channel.noise * math.sqrt(1.0 - channel.fade * channel.fade)
        before, lagged, deviation = lag[0, i], lag[1, i], noise[i]
        for k in range(count):
            now = driven[i, k]
            lagged = channel.keep * lagged + (1.0 - channel.mean) * now + (channel.mean - channel.keep) * before
            before = now
            if (k + 1) % decimation == 0:
                sample = k // decimation
                deviation = channel.fade * deviation + spread * drawn[sample, 0, i]
                output = min(max(lagged + deviation, channel.low), channel.high)
                code = np.rint((output + channel.converter_noise * drawn[sample, 1, i]) / channel.code)
                volts[i, sample] = channel.code * min(max(code, -_CODES / 2), _CODES / 2 - 1.0)
        lag[0, i], lag[1, i], noise[i] = before, lagged, deviation
    return volts
