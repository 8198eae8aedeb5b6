"""The mains' phase in a recording: where in its period a hum on the force stands when the recording starts."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from mrd_runs.run import Run
from mrd_runs.signals.current import current_noise

Array = NDArray[np.float64]

MAINS = (50.0, 60.0)
"""Hz."""

ROUNDS = 10
"""Of fits to a hum, each with weights from the one before."""

LOUD = 0.04
"""s around a switch of the current in which the force says nothing of a hum."""


def mains_phase(run: Run, current: Array) -> Array:
    """Phase (2,) in rad of the force at 50 and at 60 Hz at the start of a recording.

    Recordings start at any moment, so each has a phase of its own. The force, less its mean over a period of the mains,
    twice so that motion leaves little, is fitted by a cosine and a sine where the current does not switch. 0 where the rate
    is too low to see the mains. ``current`` (n,) is the run's current in A without sensor noise.
    """
    change = np.abs(np.diff(current, prepend=run.current[0]))
    near = maximum_filter1d(change, 2 * int(LOUD * run.rate) + 1)
    calm = near <= max(3.0 * current_noise(run.current), 1e-3)
    return np.array([_phase(run, calm.copy(), frequency) for frequency in MAINS])


def _phase(run: Run, calm: NDArray[np.bool_], frequency: float) -> float:
    period = run.rate / frequency
    if period < 2.2 or len(run) < 10 * period:
        return 0.0
    rest = run.force
    for _ in range(2):
        rest = rest - _mean(rest, period)
    calm[: int(2 * period)] = calm[-int(2 * period) :] = False
    if calm.sum() < 5 * period:
        return 0.0
    angle = 2 * np.pi * frequency * run.time[calm]
    wave, rest, weight = np.stack([np.cos(angle), np.sin(angle)], axis=1), rest[calm], np.ones(int(calm.sum()))
    # Reversals leave peaks, which count the less the farther out they are (Cauchy's loss).
    for _ in range(ROUNDS):
        cosine, sine = np.linalg.solve(wave.T @ (weight[:, None] * wave), wave.T @ (weight * rest))
        out = np.abs(rest - wave @ np.array([cosine, sine]))
        weight = 1.0 / (1.0 + (out / max(2.0 * float(np.median(out)), np.finfo(float).tiny)) ** 2)
    return float(np.arctan2(-sine, cosine))


def _mean(series: Array, samples: float) -> Array:
    """Running mean over a number of samples that need not be whole."""
    whole = int(samples)
    share = samples - whole
    less, more = (uniform_filter1d(series, size, mode="nearest") for size in (max(whole, 1), whole + 1))
    # Windows of a whole number of samples weigh as many; the mean over the fractional one lies between them.
    weights = np.array([(1 - share) * whole, share * (whole + 1)])
    return np.asarray((weights[0] * less + weights[1] * more) / weights.sum())
