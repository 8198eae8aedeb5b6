"""Maps of the excess error over pairs of axes, and a spectrogram of the residual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import spectrogram

from mrd_diagnosis.diagnosis import RunNoise
from mrd_identification.recording import Recording, current_levels

Array = NDArray[np.float64]

MAP_BINS = 24
"""Bins of a map along each axis."""

LEAST_SAMPLES_OF_CELL = 5
"""Samples below which a cell of a map is empty."""

COLUMN_DURATION = 0.5
"""Duration in s of a column of the spectrogram; longer in long runs."""

MOST_COLUMNS, MOST_ROWS = 60, 128
"""Columns and rows of the spectrogram that a picture can show."""


@dataclass(frozen=True)
class Map:
    """Excess error over two axes.

    Attributes
    ----------
    title : str
    x, y : str
        Quantities of the axes, with unit.
    x_edges : ndarray (columns + 1,)
    y_edges : ndarray (rows + 1,)
    values : ndarray (rows, columns)
        Excess in ``unit``; nan where there are too few samples.
    unit : str
    """

    title: str
    x: str
    y: str
    x_edges: Array
    y_edges: Array
    values: Array
    unit: str


def maps(recordings: Sequence[Recording], noise: Sequence[RunNoise], residuals: Sequence[Array]) -> tuple[Map, ...]:
    """Return the rms excess over velocity and position and over velocity and current, and a spectrogram of the worst run.

    Parameters
    ----------
    recordings, noise, residuals
        See `mrd_diagnosis.localisation.localise`.

    Returns
    -------
    tuple of Map
        Excess in N rms, and the spectrogram in N/√Hz. The map over the current is left out where the current never changes.
    """
    velocity = np.concatenate([recording.motion.velocity[recording.counted] for recording in recordings])
    position = np.concatenate([recording.motion.position[recording.counted] for recording in recordings])
    current = np.concatenate([recording.run.current[recording.counted] for recording in recordings])
    excess_of_run = [residual**2 - of_run.sigma**2 for residual, of_run in zip(residuals, noise, strict=True)]
    excess = np.concatenate(excess_of_run)
    drawn = [_excess_map("velocity × position", velocity, "velocity, m/s", position, "position, m", excess)]
    if current_levels([recording.run for recording in recordings])[0] > 1:
        drawn.append(_excess_map("velocity × current", velocity, "velocity, m/s", current, "current, A", excess))
    worst = int(np.argmax([float(np.sum(squares)) for squares in excess_of_run]))
    return (*drawn, _spectrogram(recordings[worst], residuals[worst]))


def _excess_map(title: str, x: Array, x_name: str, y: Array, y_name: str, excess: Array) -> Map:
    edges = [np.linspace(np.quantile(v, 0.001), np.quantile(v, 0.999), MAP_BINS + 1) for v in (x, y)]
    count, _, _ = np.histogram2d(y, x, edges[::-1])
    total, _, _ = np.histogram2d(y, x, edges[::-1], weights=excess)
    enough = count >= LEAST_SAMPLES_OF_CELL
    values = np.where(enough, np.sqrt(np.maximum(total, 0.0) / np.maximum(count, 1)), np.nan)
    return Map(title, x_name, y_name, edges[0], edges[1], values, "N")


def _spectrogram(recording: Recording, residual: Array) -> Map:
    """Return the amplitude density of the residual over time and frequency."""
    run = recording.run
    rate = recording.rate
    length = min(len(residual), max(32, round(COLUMN_DURATION * rate), len(residual) // MOST_COLUMNS))
    frequency, time, density = spectrogram(residual, rate, "hann", length, 0, detrend=False)
    height = -(-len(frequency) // MOST_ROWS)
    rows = np.arange(0, len(frequency), height)
    power = np.add.reduceat(density, rows, axis=0) / np.diff(np.append(rows, len(frequency)))[:, None]
    half, begin = 0.5 * length / rate, float(run.time[recording.counted][0])
    return Map(
        f"spectrum of the error over time, run {run.name}",
        "time, s",
        "frequency, Hz",
        np.append(time - half, time[-1] + half) + begin,
        np.append(frequency[rows], frequency[-1] + frequency[1]),
        np.sqrt(power),
        "N/√Hz",
    )
