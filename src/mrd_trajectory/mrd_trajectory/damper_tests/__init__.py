"""The catalogue of damper tests. A new one is a file and a line in `DAMPER_TESTS`."""

import dataclasses
from types import MappingProxyType
from typing import NamedTuple

from mrd_base import InputError
from mrd_base.config import closest_key, yaml_key
from mrd_trajectory.damper_tests.damper_test import DamperTest
from mrd_trajectory.damper_tests.endurance import Endurance
from mrd_trajectory.damper_tests.gas_force import GasForce
from mrd_trajectory.damper_tests.response_time import ResponseTime
from mrd_trajectory.damper_tests.seal_drag import SealDrag
from mrd_trajectory.damper_tests.speed_sweep import SpeedSweep
from mrd_trajectory.damper_tests.warm_up import WarmUp

DAMPER_TESTS: MappingProxyType[str, type[DamperTest]] = MappingProxyType(
    {
        "warm_up": WarmUp,
        "gas_force": GasForce,
        "seal_drag": SealDrag,
        "speed_sweep": SpeedSweep,
        "response_time": ResponseTime,
        "endurance": Endurance,
    }
)


def damper_test_type(name: object) -> type[DamperTest]:
    """Return the class of a damper test by its name in the catalogue."""
    if not isinstance(name, str) or name not in DAMPER_TESTS:
        raise InputError(f"unknown test {name}{closest_key(name, DAMPER_TESTS)} (known: {', '.join(DAMPER_TESTS)})")
    return DAMPER_TESTS[name]


class ParameterRow(NamedTuple):
    """A row of the table of all parameters."""

    test: str
    key: str
    default: str
    meaning: str


def damper_test_table() -> list[ParameterRow]:
    """Return every parameter of every damper test with its YAML key."""
    return [
        ParameterRow(name, yaml_key(field)[0], _default(field), field.metadata["doc"])
        for name, cls in DAMPER_TESTS.items()
        for field in dataclasses.fields(cls)
    ]


def _default(field: "dataclasses.Field[object]") -> str:
    if field.default is dataclasses.MISSING:
        return "required"
    return "" if field.default is None else str(field.default)


__all__ = ["DAMPER_TESTS", "DamperTest", "ParameterRow", "damper_test_table", "damper_test_type"]
