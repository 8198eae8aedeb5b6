"""Recordings of a simulator, in the place of the simulator: for one that is closed, or slow."""

import shlex
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs import Run
from mrd_sim.simulators.simulator import Signals, Simulator, SimulatorParameter

Array = NDArray[np.float64]

OF_RECORDINGS = "of the recordings"
"""Name of every recorded simulator: recordings of other runs are of the same one."""

MOST_DEVIATION = 0.05
"""Share of the stroke by which the motion of a simulator's recording may differ (rms) from that of the run it belongs to."""

MOST_OF_CURRENT = 0.1
"""Share of the largest current by which the current of a simulator's recording may differ (rms over `SEGMENTS`)."""

SEGMENTS = 20
"""Parts of a run in which the mean currents are compared: noise and the lag of a supply hardly change them."""

FAR_BETTER = 0.3
"""Ratio of the differences of position below which a recording is shifted in time."""

MOST_MISSING = 0.02
"""s that a simulator's recording may begin later or end earlier than the run."""


class RecordedSimulator(Simulator):
    """Recordings of a simulator that had the motion and the current of the runs.

    Parameters
    ----------
    runs : sequence of Run
        One for each run of the analysis; which belongs to which, the motion tells. Their rate may be another one.
    """

    answers_anew = False

    def __init__(self, runs: Sequence[Run]) -> None:
        self.runs = tuple(runs)
        self.name = OF_RECORDINGS
        self.source = " ".join(shlex.quote(str(run.info.get("source", run.name))) for run in runs)
        self.parameters: Mapping[str, SimulatorParameter] = {}

    def force(self, signals: Signals, values: Mapping[str, float] | None = None) -> Array:
        """Return the recorded force (n,) in N at the times of ``signals``; see `Simulator.force`."""
        if values:
            raise InputError("a recorded simulator has no parameters; give the simulator itself, or record it once more")
        shifts = [_shift(run, signals) if _is_as_long(run, signals) else np.nan for run in self.runs]
        off = [
            np.inf if np.isnan(shift) else _off(run, signals, shift) for run, shift in zip(self.runs, shifts, strict=True)
        ]
        alike = [place for place, deviation in enumerate(off) if deviation <= MOST_DEVIATION]
        if not alike:
            nearest = int(np.argmin(off))
            much = f"the nearest, {self.runs[nearest].name}, is off by {100 * off[nearest]:.2g} % of the stroke"
            how = "none is as long" if np.isinf(off[nearest]) else much
            raise InputError(
                f"recordings of the simulator: none has the motion of the run of {signals.time[-1] - signals.time[0]:.4g} s "
                f"({how}); let the simulator run along the recorded position and current of each run, from its first sample"
            )
        # Of several with the motion, such as a sine at several currents, the current tells.
        best = min(alike, key=lambda place: (_of_current(self.runs[place], signals, shifts[place]), off[place]))
        simulated = _along(self.runs[best], signals, shifts[best], self.runs[best].current)
        largest = max(float(np.abs(series).max()) for series in (signals.current, *(run.current for run in self.runs)))
        parts = np.array_split(simulated - signals.current, min(SEGMENTS, len(signals)))
        if np.sqrt(np.mean([part.mean() ** 2 for part in parts])) > MOST_OF_CURRENT * largest:
            raise InputError(
                f"recordings of the simulator: {self.runs[best].name} has the motion of a run, but another current: "
                f"{simulated.mean():.3g} A in the mean, {signals.current.mean():.3g} A in the run; let the simulator run "
                "along the recorded current of each run as well"
            )
        return _along(self.runs[best], signals, shifts[best], self.runs[best].force)


def _along(run: Run, signals: Signals, shift: float, series: Array) -> Array:
    """Return a series (n,) of a recording that begins ``shift`` s later, at the times of ``signals``."""
    return np.asarray(np.interp(signals.time - signals.time[0], run.time - run.time[0] + shift, series))


def _off(run: Run, signals: Signals, shift: float) -> float:
    """Return the rms difference of position over the stroke."""
    stroke = max(float(np.ptp(signals.position)), np.finfo(float).tiny)
    return float(np.std(_along(run, signals, shift, run.position) - signals.position)) / stroke


def _shift(run: Run, signals: Signals) -> float:
    """Return by how many s a recording begins later than the run: 0 unless another time fits the motion far better."""
    step = (run.time[-1] - run.time[0]) / (len(run) - 1)
    shifts = np.arange(-MOST_MISSING, MOST_MISSING + 0.25 * step, 0.5 * step)
    best = float(min(shifts, key=lambda shift: _off(run, signals, float(shift))))
    return best if _off(run, signals, best) < FAR_BETTER * _off(run, signals, 0.0) else 0.0


def _is_as_long(run: Run, signals: Signals) -> bool:
    return bool(signals.time[-1] - signals.time[0] <= run.time[-1] - run.time[0] + MOST_MISSING)


def _of_current(run: Run, signals: Signals, shift: float) -> float:
    """Return the rms difference of current in A."""
    return float(np.sqrt(np.mean((_along(run, signals, shift, run.current) - signals.current) ** 2)))
