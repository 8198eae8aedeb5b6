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
"""of a map, along each axis."""


@dataclass(frozen=True)
class Map:
    """A picture of the excess.

    Attributes
    ----------
    title : str
    x, y : str
        What the axes are, with unit.
    x_edges, y_edges : ndarray (columns + 1,), (rows + 1,)
    values : ndarray (rows, columns)
        In ``unit``; nan where there are too few samples.
    unit : str
    """

    title: str
    x: str
    y: str
    x_edges: Array
    y_edges: Array
    values: Array
    unit: str


def maps(recordings: Sequence[Recording], noises: Sequence[RunNoise], residuals: Sequence[Array]) -> tuple[Map, ...]:
    """Excess rms over velocity and position, over velocity and current, and a spectrogram of the run with most excess.

    Parameters
    ----------
    recordings, noises, residuals
        As of `where`.

    Returns
    -------
    tuple of Map
        Excess in N rms; the spectrogram in N/√Hz. Without that over current where the current never changes.
    """
    moved = [r.motion for r in recordings]
    velocity = np.concatenate([m.velocity[r.counted] for m, r in zip(moved, recordings, strict=True)])
    position = np.concatenate([m.position[r.counted] for m, r in zip(moved, recordings, strict=True)])
    current = np.concatenate([r.run.current[r.counted] for r in recordings])
    excess = np.concatenate([r**2 - n.sigma**2 for r, n in zip(residuals, noises, strict=True)])
    found = [_grid("velocity × position", velocity, "velocity, m/s", position, "position, m", excess)]
    if current_levels([r.run for r in recordings])[0] > 1:
        found.append(_grid("velocity × current", velocity, "velocity, m/s", current, "current, A", excess))
    energies = [float(np.sum(r**2 - n.sigma**2)) for r, n in zip(residuals, noises, strict=True)]
    return (*found, _spectrogram(recordings[(worst := int(np.argmax(energies)))], residuals[worst]))


def _grid(title: str, x: Array, x_name: str, y: Array, y_name: str, excess: Array) -> Map:
    edges = [np.linspace(np.quantile(v, 0.001), np.quantile(v, 0.999), MAP_BINS + 1) for v in (x, y)]
    count, _, _ = np.histogram2d(y, x, edges[::-1])
    total, _, _ = np.histogram2d(y, x, edges[::-1], weights=excess)
    enough = count >= 5
    values = np.where(enough, np.sqrt(np.maximum(total, 0.0) / np.maximum(count, 1)), np.nan)
    return Map(title, x_name, y_name, edges[0], edges[1], values, "N")


def _spectrogram(recording: Recording, residual: Array) -> Map:
    """Amplitude density of the residual, half a second a column (longer for long runs)."""
    run = recording.run
    length = min(len(residual), max(32, round(0.5 * run.rate), len(residual) // 60))
    frequency, time, density = spectrogram(residual, run.rate, "hann", length, 0, detrend=False)
    height = -(-len(frequency) // 128)  # rows that a picture can show
    rows = np.arange(0, len(frequency), height)
    power = np.add.reduceat(density, rows, axis=0) / np.diff(np.append(rows, len(frequency)))[:, None]
    half, begin = 0.5 * length / run.rate, float(run.time[recording.counted][0])
    return Map(
        f"run {run.name}",
        "time, s",
        "frequency, Hz",
        np.append(time - half, time[-1] + half) + begin,
        np.append(frequency[rows], frequency[-1] + frequency[1]),
        np.sqrt(power),
        "N/√Hz",
    )
