"""A recorded trace from a CSV file."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import scipy

from mrd_base import InputError, quantity
from mrd_base.table import check_columns, read_csv
from mrd_trajectory.waveforms.waveform import Array, Samples, Waveform

# A cubic spline needs four points.
_FEWEST_SAMPLES = 4


@dataclass(frozen=True)
class Trace(Waveform):
    """Follow a column of a CSV file over its column ``time_s``, both in SI units."""

    file: str = quantity(unit="", doc="CSV with a header; relative to the experiment's file")
    column: str = quantity("", "", "of the levels; default position_m (m) for the rod, current_A (A) for the coil")
    scale: float = quantity(1.0, "", "factor on the levels", lower=-1e6, upper=1e6)
    cutoff: float = quantity(0.0, "Hz", "of a zero-phase low-pass against noise; 0: none", lower=0, upper=1e4)

    def resolved(self, folder: Path | None, column: str) -> Self:
        if folder is None and not Path(self.file).is_absolute():
            raise InputError(f"file {self.file} is relative, and its folder is not known here; give the full path")
        return dataclasses.replace(self, file=str((folder or Path()) / self.file), column=self.column or column)

    def shape(self, duration: float) -> Samples:
        table = read_csv(self.file, ("time_s", self.column))
        check_columns(table.columns, _FEWEST_SAMPLES, self.file, table.place)
        times, levels = table.columns["time_s"] - table.columns["time_s"][0], table.columns[self.column]
        if times[-1] < duration * (1 - 1e-9):
            raise InputError(f"{self.file}: lasts {times[-1]:.6g} s, less than duration_s {duration:g}; reduce duration_s")
        if self.cutoff:
            times, levels = _low_pass(times, levels, self.cutoff, self.file)
        return Samples(times, self.scale * levels)


def _low_pass(times: Array, levels: Array, cutoff: float, name: str) -> tuple[Array, Array]:
    step = float(np.median(np.diff(times)))
    if cutoff >= 0.5 / step:
        raise InputError(f"{name}: cutoff_hz {cutoff:g} is not below half the sample rate, {0.5 / step:g} Hz")
    uniform = np.linspace(0, times[-1], max(round(times[-1] / step) + 1, 4))
    filter_ = scipy.signal.butter(2, cutoff * step * 2, output="sos")
    pad = min(len(uniform) - 1, int(3 / (cutoff * step)))
    return uniform, scipy.signal.sosfiltfilt(filter_, scipy.interpolate.CubicSpline(times, levels)(uniform), padlen=pad)
