"""What every excitation of an emulated system has."""

import os
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from mrd_base import InputError, quantity
from mrd_base.config import named_path
from mrd_base.table import check_columns, parse_csv
from mrd_base.text_file import read_text_file

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

    def resolved(self, folder: Path | None) -> Self:
        """Return the same with the full path of its file, which is relative to a folder.

        Raises
        ------
        InputError
            For a relative path without a folder.
        """
        return self

    def complete(self) -> Self:
        """Return the same with the content of its file in it, so that it needs no file.

        Raises
        ------
        InputError
            When the file cannot be used.
        """
        return self


def speed_field() -> Any:
    """Declare the speed of a vehicle."""
    return quantity(20.0, "m/s", "of the vehicle", lower=0.1, upper=150)


def seed_field() -> Any:
    """Declare the seed of a random excitation."""
    return quantity(1, "", "of the random numbers", lower=0, upper=2**31 - 1)


def csv_field() -> Any:
    """Declare the content of a file in its place."""
    return quantity("", "", "lines of the file in its place, as the recording of a test keeps them")


def resolve_file(file: str, folder: Path | None) -> str:
    """Return the full path of a file that a YAML file in a folder names.

    Raises
    ------
    InputError
        For a relative path without a folder.
    """
    path = Path(os.path.expanduser(file))
    if folder is None and not path.is_absolute():
        raise InputError(f"file {file} is relative, and its folder is not known here; give the full path")
    return str((folder or Path()) / path)


def read_columns(file: str, csv: str, *headers: tuple[str, str]) -> tuple[tuple[str, str], Array, Array]:
    """Read two columns of a CSV file, or of its content ``csv``; the first one increases from zero.

    Parameters
    ----------
    headers : tuple of str
        Names of the two columns. Where there are several possible pairs, the first line of the file decides.

    Returns
    -------
    names : tuple of str
    first, second : ndarray (n,)

    Raises
    ------
    InputError
        When the file cannot be read or its columns cannot be used.
    """
    text = csv or read_text_file(named_path(file), "a CSV file")
    header = text.partition("\n")[0]
    names = next((names for names in headers if names[0] in header), headers[0])
    table = parse_csv(text, file, names)
    first, second = (table.columns[name] for name in names)
    check_columns({"time_s": first, names[1]: second}, 3, file, table.place)
    return names, first - first[0], second


def csv_text(names: tuple[str, str], first: Array, second: Array) -> str:
    """Return the CSV text that `read_columns` reads back exactly."""
    rows = [f"{a!r},{b!r}" for a, b in zip(first.tolist(), second.tolist(), strict=True)]
    return "\n".join([",".join(names), *rows]) + "\n"


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
