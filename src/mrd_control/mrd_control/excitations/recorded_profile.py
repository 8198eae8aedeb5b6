"""A recorded profile of a road, or a recorded motion of the base."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from mrd_base import quantity
from mrd_control.excitations.excitation import (
    Array,
    Excitation,
    check_length,
    csv_field,
    csv_text,
    read_columns,
    resolve_file,
    speed_field,
)

OVER_TIME = ("time_s", "position_m")
OVER_DISTANCE = ("distance_m", "elevation_m")


@dataclass(frozen=True)
class RecordedProfile(Excitation):
    """Position of the base from a CSV file, linear between its samples."""

    file: str = quantity(unit="", doc=f"CSV file with the header {','.join(OVER_TIME)} or {','.join(OVER_DISTANCE)}")
    speed: float = speed_field()
    scale: float = quantity(1.0, "", "factor on the recorded position", lower=-1e3, upper=1e3)
    csv: str = csv_field()

    def resolved(self, folder: Path | None) -> Self:
        return self if self.csv else replace(self, file=resolve_file(self.file, folder))

    def complete(self) -> Self:
        return replace(self, csv=csv_text(*read_columns(self.file, self.csv, OVER_TIME, OVER_DISTANCE)))

    def base(self, samples: int, rate: float) -> Array:
        time = np.arange(samples) / rate
        names, place, elevation = read_columns(self.file, self.csv, OVER_TIME, OVER_DISTANCE)
        over_distance = names == OVER_DISTANCE
        along = time * self.speed if over_distance else time
        check_length(float(place[-1]), float(along[-1]), "m" if over_distance else "s", self.file)
        position = self.scale * (np.interp(along, place, elevation) - elevation[0])
        return np.stack([position, np.gradient(position, 1.0 / rate)], axis=1)
