"""Summary of a run: its length, its ranges and its noise."""

from dataclasses import dataclass

import numpy as np

from mrd_runs.run import Run
from mrd_runs.signals.motion import smooth_motion


@dataclass(frozen=True)
class Summary:
    """Figures of a run.

    Attributes
    ----------
    duration : float
        Duration in s.
    rate : float
        Mean sampling rate in Hz.
    samples, lost : int
        Number of samples, and number of samples missing by their sequence numbers.
    stroke : float
        Stroke in m, peak to peak.
    peak_speed : float
        Largest speed in m/s.
    reversals : int
        Number of changes of direction.
    force, current : tuple of float
        Smallest and largest value, in N and A.
    position_noise : float
        Standard deviation of the position readings, m.
    """

    duration: float
    rate: float
    samples: int
    lost: int
    stroke: float
    peak_speed: float
    reversals: int
    force: tuple[float, float]
    current: tuple[float, float]
    position_noise: float


def summarise(run: Run) -> Summary:
    """Return the summary of a run."""
    smoothed = smooth_motion(run.time, run.position, run.acceleration)
    return Summary(
        run.duration,
        run.rate,
        len(run),
        int(run.info.get("lost", 0)),
        float(np.ptp(run.position)),
        float(np.abs(smoothed.velocity).max()),
        count_reversals(smoothed.velocity),
        (float(run.force.min()), float(run.force.max())),
        (float(run.current.min()), float(run.current.max())),
        smoothed.position_noise,
    )


def count_reversals(velocity: np.ndarray) -> int:
    """Return the number of changes of direction.

    Samples slower than a fiftieth of the peak speed do not count: noise changes the sign of the velocity at standstill.
    """
    slow = np.abs(velocity).max() / 50
    direction = np.sign(velocity[np.abs(velocity) > slow])
    return int(np.count_nonzero(np.diff(direction)))
