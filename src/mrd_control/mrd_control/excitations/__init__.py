"""The catalogue of excitations: one file and one line each."""

from pathlib import Path
from types import MappingProxyType

from mrd_base import read_yaml
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
    return build_entry(EXCITATIONS, "excitation", read_yaml(path), str(path))


__all__ = ["EXCITATIONS", "Bump", "Excitation", "GroundMotion", "RecordedProfile", "Road", "SineSweep", "read_excitation"]
