"""What every excitation of an emulated system has."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from mrd_base import InputError, quantity
from mrd_base.table import check_columns, read_csv

Array = NDArray[np.float64]


class Excitation(ABC):
    """A motion of the base with its parameters; a frozen dataclass. The same seed gives the same motion."""

    @abstractmethod
    def base(self, samples: int, rate: float) -> Array:
        """Return position in m and velocity in m/s of the base (samples, 2), at ``rate`` in Hz.

        Raises
        ------
        InputError
            When the excitation is shorter than the run, or its file cannot be used.
        """


def speed_field() -> Any:
    """Declare the speed of a vehicle."""
    return quantity(20.0, "m/s", "of the vehicle", lower=0.1, upper=150)


def seed_field() -> Any:
    """Declare the seed of a random excitation."""
    return quantity(1, "", "of the random numbers", lower=0, upper=2**31 - 1)


def read_columns(file: str, names: tuple[str, str]) -> tuple[Array, Array]:
    """Read two columns of a CSV file, of which the first increases from zero.

    Raises
    ------
    InputError
        When the file cannot be read or its columns cannot be used.
    """
    table = read_csv(Path(file).expanduser(), names)
    first, second = (table.columns[name] for name in names)
    check_columns({"time_s": first, names[1]: second}, 3, file, table.place)
    return first - first[0], second


def check_length(found: float, needed: float, unit: str, file: str) -> None:
    """Refuse a recording that is shorter than the run."""
    if found < needed * (1.0 - 1e-9):
        raise InputError(f"{file}: is {found:.6g} {unit} long, expected at least {needed:.6g} {unit} for this run")


def motion_of_acceleration(acceleration: Array, rate: float, lowest: float) -> Array:
    """Return position and velocity (n, 2) of an acceleration in m/s², without what is slower than ``lowest`` in Hz.

    Integration turns the least offset into a drift; a high-pass filter without phase before it is the usual correction.
    """
    sections = butter(2, lowest, "highpass", fs=rate, output="sos")
    velocity = cumulative_trapezoid(sosfiltfilt(sections, acceleration), dx=1.0 / rate, initial=0.0)
    velocity = sosfiltfilt(sections, velocity)
    position = cumulative_trapezoid(velocity, dx=1.0 / rate, initial=0.0)
    return np.stack([position - position[0], velocity], axis=1)
