"""Phase of the mains hum on the force at the start of a recording."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from mrd_runs.run import Run
from mrd_runs.signals.current import current_noise

Array = NDArray[np.float64]

# Mains frequencies in Hz.
MAINS = (50.0, 60.0)

# Iterations of the robust fit, each with weights from the residual of the one before; ten of them converge.
_ITERATIONS = 10

# Time in s around a switch of the current in which the transient of the force hides the hum.
_TRANSIENT = 0.04

# A change of the current between samples is a switch above this multiple of its noise, and above this size in A.
_SWITCH_NOISE, _SMALLEST_SWITCH = 3.0, 1e-3

# Fewest samples in a mains period that show its phase, and fewest mains periods in a recording.
_FEWEST_SAMPLES, _FEWEST_PERIODS = 2.2, 10


def mains_phase(run: Run, current: Array) -> Array:
    """Return the phase (2,) in rad of the hum on the force at 50 and at 60 Hz at the start of a recording.

    Recordings start at any moment, so the phase differs between them. A cosine and a sine are fitted to the force where the
    current does not switch. The mean over a mains period is subtracted before, twice, because it removes most of the force
    that the motion causes. The phase is 0 where the sampling rate is too low.

    Parameters
    ----------
    run : Run
    current : ndarray (n,)
        Current of the run in A without sensor noise.
    """
    change = np.abs(np.diff(current, prepend=run.current[0]))
    largest_change_nearby = maximum_filter1d(change, 2 * int(_TRANSIENT * run.rate) + 1)
    usable = largest_change_nearby <= max(_SWITCH_NOISE * current_noise(run.current), _SMALLEST_SWITCH)
    return np.array([_phase(run, usable.copy(), frequency) for frequency in MAINS])


def _phase(run: Run, usable: NDArray[np.bool_], frequency: float) -> float:
    period = run.rate / frequency
    if period < _FEWEST_SAMPLES or len(run) < _FEWEST_PERIODS * period:
        return 0.0
    residual = run.force
    for _ in range(2):
        residual = residual - _running_mean(residual, period)
    usable[: int(2 * period)] = usable[-int(2 * period) :] = False
    if usable.sum() < _FEWEST_PERIODS / 2 * period:
        return 0.0
    angle = 2 * np.pi * frequency * run.time[usable]
    waves, residual = np.stack([np.cos(angle), np.sin(angle)], axis=1), residual[usable]
    weight = np.ones(len(residual))
    # Reversals of the motion leave peaks in the residual. Cauchy's loss gives large residuals little weight.
    for _ in range(_ITERATIONS):
        cosine, sine = np.linalg.solve(waves.T @ (weight[:, None] * waves), waves.T @ (weight * residual))
        misfit = np.abs(residual - waves @ np.array([cosine, sine]))
        weight = 1.0 / (1.0 + (misfit / max(2.0 * float(np.median(misfit)), np.finfo(float).tiny)) ** 2)
    return float(np.arctan2(-sine, cosine))


def _running_mean(series: Array, samples: float) -> Array:
    """Return the running mean over a number of samples that need not be whole."""
    whole = int(samples)
    fraction = samples - whole
    shorter, longer = (uniform_filter1d(series, size, mode="nearest") for size in (max(whole, 1), whole + 1))
    # The mean over the fractional window lies between those over the next shorter and the next longer window.
    weights = np.array([(1 - fraction) * whole, fraction * (whole + 1)])
    return np.asarray((weights[0] * shorter + weights[1] * longer) / weights.sum())
