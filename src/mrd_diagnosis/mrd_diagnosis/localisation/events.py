"""Events of a recording from which places are counted: reversals of the rod, steps of the current, ends of the stroke."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.recording import Recording
from mrd_sim.path import Path

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

STEP_DURATION = 0.01
"""Duration in s within which a current changes at a step, and before which it was still."""

LEAST_STEP = 0.1
"""Least change of the current at a step, over the largest current."""

STILL = 0.02
"""Change of the current over the largest one up to which it was still."""

SPAN = (0.002, 0.998)
"""Quantiles of the position between which the rod strokes, so that outliers do not move the ends."""


def reversals(path: Path) -> Indices:
    """Return the vertices of a path at which the rod reverses."""
    step = np.diff(path.position)
    moves = np.flatnonzero(step)
    return np.asarray(moves[1:][step[moves[1:]] * step[moves[:-1]] < 0])


def travel_since_reversal(path: Path) -> Array:
    """Return the travel in m since the rod last reversed, or since the recording began, at each sample."""
    turns = reversals(path)
    travel = np.append(0.0, np.cumsum(np.abs(np.diff(path.position))))
    at_reversal = np.zeros_like(travel)
    at_reversal[turns] = travel[turns]
    return np.asarray((travel - np.maximum.accumulate(at_reversal))[path.samples])


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


def time_since_step(recording: Recording, scale: float) -> Array:
    """Return the time in s since the current last stepped at each sample; infinite before the first step."""
    time = recording.run.time
    steps = current_steps(recording.smoothed.current, recording.run.rate, scale)
    at_step = np.full(len(time), -np.inf)
    at_step[steps] = time[steps]
    return np.asarray(time - np.maximum.accumulate(at_step))


def span_of_positions(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the ends in m between which the rod strokes in all recordings together."""
    low, high = np.quantile(np.concatenate([recording.motion.position for recording in recordings]), SPAN)
    return float(low), float(high)


def distance_to_end(position: Array, span: tuple[float, float]) -> Array:
    """Return the distance in m of positions (n,) to the nearer end of a span."""
    return np.maximum(np.minimum(position - span[0], span[1] - position), 0.0)
