"""The run: one recording from any source."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

Array = NDArray[np.float64]

LEAST_LEFT = 0.1
"""s, the least that is left of a run; what can be learned from so little, the checks of a recording say."""


@dataclass(frozen=True, eq=False)
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
            When less than a tenth of a second would be left.
        """
        if seconds == 0.0:
            return self
        if not 0.0 < seconds < self.duration - LEAST_LEFT:
            raise InputError(f"{self.name}: skip is {seconds:g} s, expected from 0 to less than its {self.duration:.3g} s")
        first = int(np.searchsorted(self.time, self.time[0] + seconds))

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
