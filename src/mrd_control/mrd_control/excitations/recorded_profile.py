"""A recorded profile of a road, or a recorded motion of the base."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mrd_base import InputError, quantity
from mrd_control.excitations.excitation import Array, Excitation, check_length, read_columns, speed_field

OVER_TIME = ("time_s", "position_m")
OVER_DISTANCE = ("distance_m", "elevation_m")


@dataclass(frozen=True)
class RecordedProfile(Excitation):
    """Position of the base from a CSV file, linear between its samples."""

    file: str = quantity(unit="", doc=f"CSV file with the header {','.join(OVER_TIME)} or {','.join(OVER_DISTANCE)}")
    speed: float = speed_field()
    scale: float = quantity(1.0, "", "factor on the recorded position", lower=-1e3, upper=1e3)

    def base(self, samples: int, rate: float) -> Array:
        time = np.arange(samples) / rate
        try:
            with Path(self.file).expanduser().open(encoding="utf-8-sig") as stream:
                over_distance = OVER_DISTANCE[0] in stream.readline()
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{self.file}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
        place, elevation = read_columns(self.file, OVER_DISTANCE if over_distance else OVER_TIME)
        along = time * self.speed if over_distance else time
        check_length(float(place[-1]), float(along[-1]), "m" if over_distance else "s", self.file)
        position = self.scale * (np.interp(along, place, elevation) - elevation[0])
        return np.stack([position, np.gradient(position, 1.0 / rate)], axis=1)
