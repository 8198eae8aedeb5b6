"""Steps of a coil current, and the time since the last one."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STEP_DURATION = 0.01
"""Duration in s within which a current changes at a step, and before which it was still."""

LEAST_STEP = 0.1
"""Least change of the current at a step, over the largest current."""

STILL = 0.02
"""Change of the current over the largest one up to which it was still."""


def current_steps(current: Array, rate: float, scale: float) -> Indices:
    """Return the samples at which a current has begun to step.

    A step is a change of at least `LEAST_STEP` of ``scale`` within `STEP_DURATION`, of a current that was still before. So a
    current that varies smoothly has none.

    Parameters
    ----------
    current : ndarray (n,)
        A, without the noise of its sensor.
    rate : float
        Hz.
    scale : float
        Largest current in A.
    """
    width = max(2, round(STEP_DURATION * rate))
    if len(current) <= 2 * width:
        return np.empty(0, dtype=np.intp)
    change = np.abs(current[width:] - current[:-width])
    large = change >= LEAST_STEP * scale
    begins = np.flatnonzero(large[1:] & ~large[:-1]) + 1
    half = width // 2
    begins = begins[begins >= half]
    still = np.abs(current[begins] - current[begins - half]) <= STILL * scale
    return np.asarray(begins[still] + width)  # the sample that has changed first


def time_since_step(time: Array, current: Array, scale: float) -> Array:
    """Return the time in s since a current last stepped at each sample; infinite before the first step.

    ``time`` in s (n,) is evenly spaced; ``current`` and ``scale`` are as in `current_steps`.
    """
    steps = current_steps(current, (len(time) - 1) / (time[-1] - time[0]), scale)
    at_step = np.full(len(time), -np.inf)
    at_step[steps] = time[steps]
    return np.asarray(time - np.maximum.accumulate(at_step))
