"""What a recording is, wherever it came from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """One recording: equally long, finite series in SI units.

    Two runs are equal only when they are the same object.

    Attributes
    ----------
    name : str
        Short name, unique among the runs of one analysis.
    time : ndarray (n,)
        s, strictly increasing, first sample at 0.
    position : ndarray (n,)
        m, as measured; > 0 extends the damper.
    velocity : ndarray (n,)
        m/s; the recorded velocity where there is one, else that of the smoothed motion.
    current : ndarray (n,)
        A, through the coil.
    force : ndarray (n,)
        N, as measured; > 0 resists extension.
    acceleration : ndarray (n,) or None
        m/s², of the rod, as measured.
    temperature : ndarray (n,) or None
        K, of the damper.
    info : mapping
        What is known beside the samples: source, checksum, experiment, calibration, versions, seed, notes.
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
        """Mean sample rate in Hz."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def duration(self) -> float:
        """From the first to the last sample, in s."""
        return float(self.time[-1] - self.time[0])
