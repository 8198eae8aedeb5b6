"""Instruments: what is read of a channel, when, and with which noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Instruments:
    """How a bench reads.

    Attributes
    ----------
    rate : float
        Hz.
    averaged : bool
        Whether a sample is the mean over the sampling period around its time, or the value at that instant.
    position, force, current, acceleration : float
        Standard deviation of white noise on each sample, SI.
    jitter : float
        s, standard deviation of when a sample is truly taken.
    gain_scatter : float
        Standard deviation of the damper's force from run to run, relative.
    offset_scatter : float
        N, standard deviation of the load cell's zero from run to run.
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


@dataclass(frozen=True)
class Recorded:
    """One recording, at even times from 0; arrays of (samples,).

    Attributes
    ----------
    time : ndarray
        s.
    position, current, acceleration, force : ndarray
        m, A, m/s² and N, as they are read.
    """

    time: Array
    position: Array
    current: Array
    acceleration: Array
    force: Array


def sampled(instruments: Instruments, time: Array, jitter: Array, step: float, signal: Array) -> Array:
    """A signal given every ``step`` from 0, as it is read at ``time``, without noise."""
    given = np.arange(len(signal)) * step
    at = time + jitter
    if not instruments.averaged:
        return np.interp(at, given, signal)
    half = min(0.5 / instruments.rate, 0.5 * given[-1])
    middle = np.clip(at, half, given[-1] - half)  # at the ends the window stays inside
    area = np.concatenate([[0.0], np.cumsum(0.5 * step * (signal[1:] + signal[:-1]))])
    return np.asarray((np.interp(middle + half, given, area) - np.interp(middle - half, given, area)) / (2 * half))
