"""Recordings of a simulator, in the place of the simulator: for one that is closed, or slow."""

import shlex
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs import Run
from mrd_sim.simulators.simulator import Signals, Simulator, SimulatorParameter

Array = NDArray[np.float64]

MOST_DEVIATION = 0.05
"""Share of the stroke by which the motion of a simulator's recording may differ (rms) from that of the run it belongs to."""

MOST_MISSING = 0.02
"""s that a simulator's recording may begin later or end earlier than the run."""


class RecordedSimulator(Simulator):
    """Recordings of a simulator that had the motion and the current of the runs.

    Parameters
    ----------
    runs : sequence of Run
        One for each run of the analysis; which belongs to which, the motion tells. Their rate may be another one.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        self.runs = tuple(runs)
        self.name = "of the recordings" if len(runs) > 1 else f"of {runs[0].name}"
        self.source = " ".join(shlex.quote(str(run.info.get("source", run.name))) for run in runs)
        self.parameters: Mapping[str, SimulatorParameter] = {}

    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the recorded force (n,) in N at the times of ``signals``; see `Simulator.force`."""
        if values:
            raise InputError("a recorded simulator has no parameters; give the simulator itself, or record it once more")
        stroke = max(float(np.ptp(signals.position)), np.finfo(float).tiny)
        deviations = [_deviation(run, signals) / stroke for run in self.runs]
        best = int(np.argmin(deviations))
        if not deviations[best] <= MOST_DEVIATION:
            off = f"the nearest, {self.runs[best].name}, is off by {100 * deviations[best]:.2g} % of the stroke"
            how = "none is as long" if np.isinf(deviations[best]) else off
            raise InputError(
                f"recordings of the simulator: none has the motion of the run of {signals.time[-1] - signals.time[0]:.4g} s "
                f"({how}); let the simulator run along the recorded position and current of each run, from its first sample"
            )
        run = self.runs[best]
        return np.asarray(np.interp(signals.time - signals.time[0], run.time - run.time[0], run.force))


def _deviation(run: Run, signals: Signals) -> float:
    """Return the rms difference of position in m; infinite where the recording is too short."""
    time = signals.time - signals.time[0]
    if time[-1] > run.time[-1] - run.time[0] + MOST_MISSING:
        return np.inf
    difference = np.interp(time, run.time - run.time[0], run.position) - signals.position
    return float(np.std(difference))
