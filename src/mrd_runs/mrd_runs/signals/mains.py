"""Lines of the mains on the force of a recording: their frequency, size and phase."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_runs.run import Run
from mrd_runs.signals.current import current_noise

Array = NDArray[np.float64]

# Frequencies in Hz of mains hum: the mains and their doubles.
MAINS_LINES = (50.0, 60.0, 100.0, 120.0)

# Largest relative deviation of the mains (0.2 Hz at 50 Hz) and of the sample clock.
_DEVIATION = 0.004

# Gain of the logarithmic likelihood from which another than the nominal frequency is taken: half the logarithm of a few
# thousand samples (Schwarz 1978).
_LEAST_GAIN = 4.0

# Steps of the frequency over one period of the recording's length.
_FREQUENCY_STEPS = 8

# Lowest frequency in Hz at which a line may appear after sampling. Below, it lies among the harmonics of the motion.
_LOWEST_FOLDED = 30.0

# Iterations of the robust fit, each with weights from the residual of the one before; ten of them converge.
_ITERATIONS = 10

# Time in s around a switch of the current in which the transient of the force hides the hum.
_TRANSIENT = 0.04

# A change of the current between samples is a switch above this multiple of its noise, and above this size in A.
_SWITCH_NOISE, _SMALLEST_SWITCH = 3.0, 1e-3

# Fewest mains periods in a recording that show a line.
_FEWEST_PERIODS = 10

# Eigenvalue of the normal equations, over the largest, below which sampling does not show cosine and sine apart: at half the
# sampling rate, every sample falls on the same two phases.
_INDISTINCT = 1e-3


@dataclass(frozen=True)
class Line:
    """An oscillation in a channel, ``amplitude * cos(2 pi frequency t + phase)``.

    Attributes
    ----------
    frequency : float
        Hz, before sampling.
    amplitude : float
        In the unit of the channel; 0 where the recording cannot show the line.
    phase : float
        rad at the time 0.
    """

    frequency: float
    amplitude: float = 0.0
    phase: float = 0.0

    def at(self, time: Array) -> Array:
        """Return the oscillation (n,) at times in s."""
        return np.asarray(self.amplitude * np.cos(2 * np.pi * self.frequency * time + self.phase))


def folded_frequency(frequency: float, rate: float) -> float:
    """Return the frequency in Hz at which an oscillation appears after sampling at a rate in Hz."""
    return abs(frequency - rate * round(frequency / rate))


def shows_line(frequency: float, rate: float) -> bool:
    """Whether a recording at a rate in Hz shows an oscillation of this frequency in Hz beside the motion."""
    return folded_frequency(frequency, rate) >= _LOWEST_FOLDED


def mains_lines(run: Run, current: Array) -> list[Line]:
    """Return the hum on the force near each of `MAINS_LINES`.

    Recordings start at any moment, so the phase differs between them. It is estimated where the current does not switch.

    Parameters
    ----------
    run : Run
    current : ndarray (n,)
        Current of the run in A without sensor noise.
    """
    change = np.abs(np.diff(current, prepend=run.current[0]))
    largest_change_nearby = scipy.ndimage.maximum_filter1d(change, 2 * int(_TRANSIENT * run.rate) + 1)
    usable = largest_change_nearby <= max(_SWITCH_NOISE * current_noise(run.current), _SMALLEST_SWITCH)
    return [find_line(run.force, run.time, frequency, usable) for frequency in MAINS_LINES]


def without_mains(values: Array, time: Array) -> Array:
    """Return a channel (n,) sampled at times in s without the lines near `MAINS_LINES`."""
    for frequency in MAINS_LINES:
        values = values - find_line(values, time, frequency).at(time)
    return values


def find_line(values: Array, time: Array, nominal: float, usable: NDArray[np.bool_] | None = None) -> Line:
    """Estimate the oscillation in a channel near a nominal frequency.

    A cosine and a sine are fitted. The mean over a period is subtracted before, twice, because it removes most of what is
    slower, such as the force that the motion causes.

    Parameters
    ----------
    values : ndarray (n,)
    time : ndarray (n,)
        s.
    nominal : float
        Hz.
    usable : ndarray (n,) of bool, optional
        Samples that count.
    """
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if not shows_line(nominal, rate):
        return Line(nominal)
    period = rate / folded_frequency(nominal, rate)
    usable = np.ones(len(time), np.bool_) if usable is None else usable.copy()
    usable[: int(2 * period)] = usable[-int(2 * period) :] = False
    if len(time) < _FEWEST_PERIODS * period or usable.sum() < _FEWEST_PERIODS / 2 * period:
        return Line(nominal)
    fast = _without_slow(values, period)
    frequency = _strongest_frequency(fast, usable, rate, nominal)
    fast = fast[usable]
    angle = 2 * np.pi * frequency * time
    waves = np.stack([_without_slow(wave, period)[usable] for wave in (np.cos(angle), np.sin(angle))], axis=1)
    weight = np.ones(len(fast))
    # Reversals of the motion leave peaks in the residual. Cauchy's loss gives large residuals little weight.
    for _ in range(_ITERATIONS):
        normal = waves.T @ (weight[:, None] * waves)
        size = np.linalg.pinv(normal, _INDISTINCT, hermitian=True) @ (waves.T @ (weight * fast))
        misfit = np.abs(fast - waves @ size)
        weight = 1.0 / (1.0 + (misfit / max(2.0 * float(np.median(misfit)), np.finfo(float).tiny)) ** 2)
    cosine, sine = map(float, size)
    return Line(frequency, math.hypot(cosine, sine), math.atan2(-sine, cosine))


def _strongest_frequency(values: Array, usable: NDArray[np.bool_], rate: float, nominal: float) -> float:
    """Return the frequency in Hz near a nominal one at which an oscillation fits usable samples of a channel (n,) best.

    The energy of the best cosine and sine follows from the spectrum of the samples and, because the two are not orthogonal
    near half the sampling rate, from that of the window at twice the frequency (Lomb 1976).
    """
    # Peaks are cut off, as a reversal of the motion leaves them.
    limit = 4.0 * float(np.median(np.abs(values[usable])))
    values = np.clip(values, -limit, limit) * usable
    reach, count = _DEVIATION * nominal, int(usable.sum())
    steps = math.ceil(reach * len(values) / rate * _FREQUENCY_STEPS)
    ends = np.array([nominal - reach, nominal + reach])
    spectrum, window = (
        scipy.signal.zoom_fft(series, limits, 2 * steps + 1, fs=rate, endpoint=True)
        for series, limits in ((values, ends), (usable.astype(float), 2 * ends))
    )
    cosine, sine = ((1 + _INDISTINCT) * count + sign * window.real for sign in (1, -1))
    energy = (sine * spectrum.real**2 + cosine * spectrum.imag**2 - 2 * window.imag * spectrum.real * spectrum.imag) / (
        0.5 * (cosine * sine - window.imag**2)
    )
    peak = int(energy.argmax())
    variance = float(values @ values - energy[peak]) / count
    if energy[peak] <= energy[steps] + 2 * _LEAST_GAIN * variance or not 0 < peak < 2 * steps:
        return nominal
    below, at, above = energy[peak - 1 : peak + 2]
    vertex = 0.5 * (below - above) / (below - 2 * at + above)
    return nominal + (peak - steps + float(vertex)) * reach / steps


def _without_slow(series: Array, period: float) -> Array:
    """Return a series without its running mean over a period in samples, twice."""
    for _ in range(2):
        series = series - _running_mean(series, period)
    return series


def _running_mean(series: Array, samples: float) -> Array:
    """Return the running mean over a number of samples that need not be whole."""
    whole = int(samples)
    fraction = samples - whole
    shorter, longer = (scipy.ndimage.uniform_filter1d(series, size, mode="nearest") for size in (max(whole, 1), whole + 1))
    # The mean over the fractional window lies between those over the next shorter and the next longer window.
    weights = np.array([(1 - fraction) * whole, fraction * (whole + 1)])
    return np.asarray((weights[0] * shorter + weights[1] * longer) / weights.sum())
