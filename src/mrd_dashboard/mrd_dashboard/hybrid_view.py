"""What the page shows of a hybrid test under way: its latest cycles, how well the rod follows, and how the system rides."""

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrd_control.experiment import ControlExperiment
from mrd_control.recording import loop_of_cycles
from mrd_control.ride import METRICS, ride_metrics
from mrd_control.tracking import tracking

WINDOW = 8.0
"""s of the latest cycles, of which the metrics are taken."""
SHOWN = 5.0
"""s of them that the plots show."""
MOST_POINTS = 300
"""Points of each curve."""
LEAST = 2.0
"""s without which there are no metrics: a wheel and a body have moved by then."""

COLUMNS = ("time_s", "wanted_mm", "rod_mm", "error_mm", "force_N", "commanded_mA", "current_mA")


class CycleHistory:
    """Keeps the latest cycles of the controller, messages `control_cycle`; one thread adds, any thread reads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cycles: deque[Any] = deque()

    def add(self, cycle: Any) -> None:
        """Add a cycle. One that does not continue the others begins a test anew."""
        with self._lock:
            if self._cycles and cycle.number != self._cycles[-1].number + len(self._cycles[-1].travel):
                self._cycles.clear()
            self._cycles.append(cycle)
            while (cycle.number - self._cycles[0].number) * cycle.sample_period > WINDOW:
                self._cycles.popleft()

    def latest(self) -> list[Any]:
        """Return the cycles of the last `WINDOW` s."""
        with self._lock:
            return list(self._cycles)


@dataclass(frozen=True)
class LiveMetrics:
    """Metrics of the last `WINDOW` s of a hybrid test.

    Attributes
    ----------
    rows : tuple of (str, str)
        Title with unit, and value, of tracking and ride.
    elapsed : float
        Time of the test in s.
    missed : int
        Deadlines missed so far.
    """

    rows: tuple[tuple[str, str], ...] = ()
    elapsed: float = 0.0
    missed: int = 0


def live_metrics(experiment: ControlExperiment | None, cycles: list[Any]) -> LiveMetrics:
    """Return the metrics of consecutive cycles; those of the ride only where the experiment is known."""
    if not cycles:
        return LiveMetrics()
    last = cycles[-1]
    elapsed = (last.number + len(last.travel)) * last.sample_period
    if (last.number - cycles[0].number) * last.sample_period < LEAST:
        return LiveMetrics((), elapsed, int(last.missed))
    followed = tracking(_series(cycles, "travel"), _series(cycles, "position"), last.sample_period)
    rows = [
        ("delay of the rod (negative: it leads), ms", f"{1e3 * followed.delay:.2f}"),
        ("NRMS of the tracking, %", f"{100 * followed.nrms:.2f}"),
        ("peak error of the tracking, %", f"{100 * followed.peak:.2f}"),
    ]
    if experiment is not None:
        ride = ride_metrics(experiment.system.linear(), loop_of_cycles(experiment, cycles), experiment.data_sheet, 0.0)
        for name, (title, factor) in METRICS.items():
            value = factor * getattr(ride, name)
            if np.isfinite(value):
                rows.append((title, f"{value:.4g}"))
    return LiveMetrics(tuple(rows), elapsed, int(last.missed))


def hybrid_frame(cycles: list[Any]) -> dict[str, list[float]]:
    """Return the columns of the table that the plots of a hybrid test draw; time counts back from the latest sample."""
    if not cycles:
        return {name: [] for name in COLUMNS}
    first, period = cycles[0].number, cycles[0].sample_period
    wanted, rod = 1e3 * _series(cycles, "travel"), 1e3 * _series(cycles, "position")
    force, current = _series(cycles, "force"), 1e3 * _series(cycles, "coil_current")
    commanded = 1e3 * _series(cycles, "current")
    count = min(len(wanted), round(SHOWN / period))
    stride = -(-round(SHOWN / period) // MOST_POINTS)
    number = first + np.arange(len(wanted))
    drawn = np.flatnonzero(number % stride == 0)
    drawn = drawn[drawn >= len(wanted) - count]
    time = (number - number[-1]) * period
    columns = (time, wanted, rod, rod - wanted, force, commanded, current)
    return {name: np.round(column[drawn], 3).tolist() for name, column in zip(COLUMNS, columns, strict=True)}


def _series(cycles: list[Any], name: str) -> Any:
    return np.concatenate([getattr(cycle, name) for cycle in cycles])
