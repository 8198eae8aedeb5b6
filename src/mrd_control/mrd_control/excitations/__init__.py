"""The catalogue of excitations: one file and one line each."""

from pathlib import Path
from types import MappingProxyType
from typing import Any

from mrd_base import InputError, read_yaml
from mrd_control.catalogue import build_entry
from mrd_control.excitations.bump import Bump
from mrd_control.excitations.excitation import Excitation
from mrd_control.excitations.ground_motion import GroundMotion
from mrd_control.excitations.recorded_profile import RecordedProfile
from mrd_control.excitations.road import Road
from mrd_control.excitations.sine_sweep import SineSweep

EXCITATIONS: MappingProxyType[str, type[Excitation]] = MappingProxyType(
    {"road": Road, "bump": Bump, "sine_sweep": SineSweep, "ground_motion": GroundMotion, "recorded_profile": RecordedProfile}
)


def read_excitation(path: str | Path) -> Excitation:
    """Read an excitation from a YAML file: its name after ``excitation:``, and its parameters.

    Raises
    ------
    InputError
        With one line: file, field, what was found and what was expected.
    """
    return build_excitation(read_yaml(path), str(path), Path(path).resolve().parent)


def build_excitation(mapping: Any, where: str, folder: Path | None) -> Excitation:
    """Build the excitation of a YAML mapping; ``where`` is the prefix of error messages.

    Parameters
    ----------
    folder : Path or None
        That of the YAML file, to which the file of a recorded excitation is relative; None where there is no such file.

    Raises
    ------
    InputError
        As `read_excitation`.
    """
    excitation = build_entry(EXCITATIONS, "excitation", mapping, where)
    try:
        return excitation.resolved(folder)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


__all__ = [
    "EXCITATIONS",
    "Bump",
    "Excitation",
    "GroundMotion",
    "RecordedProfile",
    "Road",
    "SineSweep",
    "build_excitation",
    "read_excitation",
]
