"""Instruments: what is read of a channel, at which times, and with which noise."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrueInstruments:
    """Instruments of a bench, and the scatter between its runs.

    Attributes
    ----------
    rate : float
        Sample rate in Hz.
    averaged : bool
        Whether a sample is the mean over the sampling period around its time, or the value at that instant.
    position, force, current, acceleration : float
        Standard deviation of the white noise of each channel in SI units.
    jitter : float
        Standard deviation in s of the time at which a sample is truly taken.
    gain_scatter : float
        Relative standard deviation of the damper's force from run to run.
    offset_scatter : float
        Standard deviation in N of the load cell's zero from run to run.
    """

    rate: float
    averaged: bool = True
    position: float = 8e-6
    force: float = 1.5
    current: float = 4e-3
    acceleration: float = 0.05
    jitter: float = 15e-6
    gain_scatter: float = 0.01
    offset_scatter: float = 2.0

    def __post_init__(self) -> None:
        noises = (
            self.position,
            self.force,
            self.current,
            self.acceleration,
            self.jitter,
            self.gain_scatter,
            self.offset_scatter,
        )
        if not 0.0 < self.rate < np.inf or not all(0.0 <= noise < np.inf for noise in noises):
            raise ValueError(f"instruments {self}: expected a positive rate and no negative noise")

    def without_noise(self) -> "TrueInstruments":
        """Return the instruments without noise and jitter; runs scatter as before."""
        return replace(self, position=0.0, force=0.0, current=0.0, acceleration=0.0, jitter=0.0)


@dataclass(frozen=True)
class Readings:
    """The readings of one run at even times from 0; all arrays have the shape (samples,).

    Attributes
    ----------
    time : ndarray
        Time in s.
    position, current, acceleration, force : ndarray
        Readings in m, A, m/s² and N.
    """

    time: Array
    position: Array
    current: Array
    acceleration: Array
    force: Array


def sample_signal(instruments: TrueInstruments, time: Array, jitter: Array, step: float, signal: Array) -> Array:
    """Return a signal, given every ``step`` from 0, as it is read at ``time``, without noise."""
    given = np.arange(len(signal)) * step
    taken = time + jitter
    if not instruments.averaged:
        return np.interp(taken, given, signal)
    half = min(0.5 / instruments.rate, 0.5 * given[-1])
    middle = np.clip(taken, half, given[-1] - half)  # the averaging window stays inside the signal
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (signal[1:] + signal[:-1]))])
    return np.asarray((np.interp(middle + half, given, area) - np.interp(middle - half, given, area)) / (2 * half))
