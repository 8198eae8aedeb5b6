"""What a run is, in a dozen figures."""

from dataclasses import dataclass

import numpy as np

from mrd_runs.run import Run
from mrd_runs.signals.motion import smooth_motion


@dataclass(frozen=True)
class Summary:
    """Figures of a run, in SI units.

    Attributes
    ----------
    duration : float
        s.
    rate : float
        Hz.
    samples, lost : int
        Present; missing by their sequence numbers.
    stroke : float
        m, peak to peak.
    peak_speed : float
        m/s.
    reversals : int
        Changes of the direction of motion.
    force, current : tuple of float
        Smallest and largest, N and A.
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
    """Figures of a run."""
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
    """Changes of direction, between stretches faster than a fiftieth of the peak speed: standstill has no direction."""
    slow = np.abs(velocity).max() / 50
    direction = np.sign(velocity[np.abs(velocity) > slow])
    return int(np.count_nonzero(np.diff(direction)))
