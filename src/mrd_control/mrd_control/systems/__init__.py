"""The catalogue of emulated mechanical systems: one file and one line each."""

from pathlib import Path
from types import MappingProxyType

from mrd_base import read_yaml
from mrd_control.catalogue import build_entry
from mrd_control.systems.quarter_car import QuarterCar
from mrd_control.systems.shear_building import ShearBuilding
from mrd_control.systems.single_mass import SingleMass
from mrd_control.systems.system import System

SYSTEMS: MappingProxyType[str, type[System]] = MappingProxyType(
    {"quarter_car": QuarterCar, "single_mass": SingleMass, "shear_building": ShearBuilding}
)


def read_system(path: str | Path) -> System:
    """Read an emulated system from a YAML file: its name after ``system:``, and its parameters.

    Raises
    ------
    InputError
        With one line: file, field, what was found and what was expected.
    """
    return build_entry(SYSTEMS, "system", read_yaml(path), str(path))


__all__ = ["SYSTEMS", "QuarterCar", "ShearBuilding", "SingleMass", "System", "read_system"]
