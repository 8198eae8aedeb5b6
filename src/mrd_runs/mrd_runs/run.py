"""The run: one recording from any source."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from html import escape
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = NDArray[np.float64]

FEWEST_SAMPLES = 50
"""Samples of a run; with fewer, a recording is too short to identify a model from."""


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """One recording: equally long, finite series in SI units.

    Two runs are equal only when they are the same object.

    Attributes
    ----------
    name : str
        Short name, unique among the runs of one analysis.
    time : ndarray (n,)
        Time in s, strictly increasing from 0.
    position : ndarray (n,)
        Measured position in m; > 0 extends the damper.
    velocity : ndarray (n,)
        Velocity in m/s: the recorded one where there is one, else that of the smoothed motion.
    current : ndarray (n,)
        Coil current in A.
    force : ndarray (n,)
        Measured force in N; > 0 resists extension.
    acceleration : ndarray (n,) or None
        Measured acceleration of the rod in m/s².
    temperature : ndarray (n,) or None
        Temperature of the damper in K.
    info : mapping
        Facts about the recording: source, checksum, experiment, calibration, versions, seed, clocks, notes (see `read_run`).
    """

    name: str
    time: Array
    position: Array
    velocity: Array
    current: Array
    force: Array
    acceleration: Array | None = None
    temperature: Array | None = None
    info: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return f"<Run {self.name}: {self.duration:.4g} s at {self.rate:.4g} Hz>"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in self._facts().items())
        return f"<table>{rows}</table>"

    def summary(self) -> str:
        """Return origin, length, ranges and noise of the run as text."""
        facts = self._facts()
        width = max(map(len, facts))
        return "\n".join(f"{name:{width}}  {text}" for name, text in facts.items())

    def plot(self) -> "go.Figure":
        """Return the figure of force, position and current over time, which a notebook shows."""
        # Plotly is slow to import, and only few runs are drawn.
        from mrd_runs.figure import signals_over_time

        return signals_over_time(self)

    def _facts(self) -> dict[str, str]:
        from mrd_runs.summary import summarise

        return {"name": self.name, **summarise(self)}

    @property
    def rate(self) -> float:
        """Mean sampling rate in Hz."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def clocks(self) -> Mapping[str, str]:
        """What the times of each channel were of, by quantity, such as ``force``; empty where all are of one clock."""
        clocks: Mapping[str, str] = self.info.get("clocks", {})
        return clocks

    def clocks_agree(self, *quantities: str) -> bool:
        """Return whether the times of some channels, by default of all, are known to be of one clock.

        Channels of one table, one message or one DAQ are; channels of two devices that stamp by themselves are not.
        """
        return len({clock for quantity, clock in self.clocks.items() if not quantities or quantity in quantities}) < 2

    @property
    def duration(self) -> float:
        """Time from the first to the last sample, in s."""
        return float(self.time[-1] - self.time[0])

    def without_start(self, seconds: float) -> "Run":
        """Return the run without its first ``seconds``; the time begins at 0 again.

        Raises
        ------
        InputError
            When fewer than 50 samples would be left.
        """
        if seconds == 0.0:
            return self
        if not 0.0 < seconds < self.duration:
            raise InputError(f"{self.name}: skip is {seconds:g} s, expected from 0 to less than its {self.duration:.3g} s")
        first = int(np.searchsorted(self.time, self.time[0] + seconds))
        if len(self) - first < FEWEST_SAMPLES:
            raise InputError(
                f"{self.name}: skip is {seconds:g} s, which leaves {len(self) - first} of {len(self)} samples; expected at "
                f"least {FEWEST_SAMPLES}"
            )
        return replace(
            self,
            time=self.time[first:] - self.time[first],
            position=self.position[first:],
            velocity=self.velocity[first:],
            current=self.current[first:],
            force=self.force[first:],
            acceleration=None if self.acceleration is None else self.acceleration[first:],
            temperature=None if self.temperature is None else self.temperature[first:],
            info={**self.info, "skipped_s": seconds},
        )


def same_samples(run: Run, other: Run) -> bool:
    """Return whether two runs hold the same positions and forces; either may miss a part at its start."""
    count = min(len(run), len(other))
    return run is other or all(
        # The last samples alone tell most runs apart.
        mine[-1] == its[-1] and np.array_equal(mine[-count:], its[-count:])
        for mine, its in ((run.force, other.force), (run.position, other.position))
    )


def checked_runs(runs: object, name: str = "runs", least: int = 1) -> list[Run]:
    """Return the runs of an argument of a public function as a list.

    Parameters
    ----------
    runs : sequence of Run
        A single run stands for a list of one.
    name : str
        Of the argument.
    least : int
        Number of runs that are needed.

    Raises
    ------
    InputError
        For anything else; says what was found and what was expected.
    """
    if isinstance(runs, Run):
        return [runs]
    if isinstance(runs, str | PathLike):
        raise InputError(f"{name} is the path {runs}, expected runs: read_runs({str(runs)!r})")
    if not isinstance(runs, Iterable):
        raise InputError(f"{name} is {type(runs).__name__}, expected a list of runs")
    listed = list(runs)
    for entry in listed:
        if not isinstance(entry, Run):
            found = f"the path {entry}" if isinstance(entry, str | PathLike) else type(entry).__name__
            raise InputError(f"{name} holds {found}, expected runs, as read_runs gives them")
    if len(listed) < least:
        raise InputError(f"{name} is empty, expected at least one run")
    return listed
