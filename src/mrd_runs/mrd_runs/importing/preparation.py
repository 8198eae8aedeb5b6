"""Preparation of a recording on import, where it is asked for: a part of it, fewer samples, a low-pass filter."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, resample_poly, sosfiltfilt

from mrd_base import InputError
from mrd_base.table import check_columns
from mrd_runs.formats import Recording
from mrd_runs.run import FEWEST_SAMPLES

Array = NDArray[np.float64]

ORDER = 2
"""Order of the low-pass filter; it runs forward and backward, so that nothing is delayed and the order counts twice."""

LONGEST_GAP = 5.0
"""Gap in usual intervals from which samples are not filtered as if they were evenly spaced."""

HIGHEST = 0.45
"""Share of the sampling rate below which the corner frequency must lie."""


@dataclass(frozen=True)
class Preparation:
    """What is done to a recording, in this order.

    Attributes
    ----------
    start, end : float
        Part that is kept, in s from the first sample.
    low_pass : float or None
        Corner frequency in Hz of a filter of all signals alike.
    every : int
        One of so many samples is kept, behind a filter against aliasing.
    """

    start: float = 0.0
    end: float = np.inf
    low_pass: float | None = None
    every: int = 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.start < self.end:
            raise InputError(f"--crop is {self.start:g}:{self.end:g}, expected FROM:TO in s with FROM before TO")
        if self.low_pass is not None and not self.low_pass > 0.0:
            raise InputError(f"--low-pass is {self.low_pass:g}, expected a frequency in Hz")
        if self.every < 1:
            raise InputError(f"--decimate is {self.every}, expected a whole number from 1")


def prepare(recording: Recording, wanted: Preparation, where: str) -> Recording:
    """Return a recording as it is wanted; its notes say what was done.

    Raises
    ------
    InputError
        When too little is left, the filter has no effect at this rate, or there is a gap in what is to be filtered;
        ``where`` names the file.
    """
    if wanted == Preparation():
        return recording
    check_columns(recording.columns, FEWEST_SAMPLES, where, recording.place)
    columns, notes, first = dict(recording.columns), [], 0
    time = columns["time_s"]
    since = time - time[0]
    if wanted.start > 0.0 or np.isfinite(wanted.end):
        inside = np.flatnonzero((since >= wanted.start) & (since <= wanted.end))
        if len(inside) < FEWEST_SAMPLES:
            raise InputError(
                f"{where}: --crop leaves {len(inside)} of {len(time)} samples; it lasts {since[-1]:.4g} s, expected at "
                f"least {FEWEST_SAMPLES} samples"
            )
        first = int(inside[0])
        columns = {name: series[inside] for name, series in columns.items()}
        notes.append(f"kept from {since[inside[0]]:.4g} to {since[inside[-1]]:.4g} s")
    time = columns["time_s"]
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if wanted.low_pass is not None or wanted.every > 1:
        _check_gaps(time, where, lambda index: recording.place(first + index))
    signals = [name for name in columns if name != "time_s"]
    if wanted.low_pass is not None:
        highest = HIGHEST * rate
        if wanted.low_pass >= highest:
            raise InputError(
                f"{where}: --low-pass is {wanted.low_pass:g} Hz, expected less than {highest:.4g} Hz at its rate"
            )
        sections = butter(ORDER, wanted.low_pass, fs=rate, output="sos")
        columns |= {name: sosfiltfilt(sections, columns[name]) for name in signals}
        notes.append(f"all signals filtered alike, forward and backward, by a low-pass of {wanted.low_pass:g} Hz")
    if wanted.every > 1:
        if len(time) // wanted.every < FEWEST_SAMPLES:
            raise InputError(f"{where}: --decimate {wanted.every} leaves {len(time) // wanted.every} samples, expected more")
        columns |= {name: resample_poly(columns[name], 1, wanted.every, padtype="line") for name in signals}
        columns["time_s"] = time[:: wanted.every]
        notes.append(f"one of {wanted.every} samples kept, behind a filter against aliasing")
    of_file = recording.place
    return replace(
        recording,
        columns={name: np.ascontiguousarray(series) for name, series in columns.items()},
        info={**recording.info, "notes": [*recording.info.get("notes", ()), *notes]},
        place=lambda index: of_file(first + index * wanted.every),
    )


def _check_gaps(time: Array, where: str, place: Callable[[int], str]) -> None:
    """Refuse to filter over a gap."""
    steps = np.diff(time)
    index = int(np.argmax(steps))
    if steps[index] > LONGEST_GAP * np.median(steps):
        begin, end = (time[k] - time[0] for k in (index, index + 1))
        raise InputError(
            f"{where}: {place(index + 1)}: there are no samples between {begin:.6g} and {end:.6g} s of what is kept, and no "
            "filter goes over a gap; keep what is before or after it with --crop, or leave out --low-pass and --decimate"
        )
