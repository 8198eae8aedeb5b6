"""Events of a recording from which places are counted: reversals of the rod, and the ends of the stroke."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_identification.recording import Recording
from mrd_sim.path import Path

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

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


def span_of_positions(recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the ends in m between which the rod strokes in all recordings together."""
    low, high = np.quantile(np.concatenate([recording.motion.position for recording in recordings]), SPAN)
    return float(low), float(high)


def distance_to_end(position: Array, span: tuple[float, float]) -> Array:
    """Return the distance in m of positions (n,) to the nearer end of a span."""
    return np.maximum(np.minimum(position - span[0], span[1] - position), 0.0)
