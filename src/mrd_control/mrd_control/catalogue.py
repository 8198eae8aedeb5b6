"""Choice of an entry of a catalogue by name, with its parameters from YAML."""

import sys
from collections.abc import Mapping
from typing import Any, TypeVar

from mrd_base import InputError, from_mapping
from mrd_base.config import unknown_key

T = TypeVar("T")


def build_entry(catalogue: Mapping[str, type[T]], kind: str, mapping: Any, where: str) -> T:
    """Build the entry of a catalogue that ``mapping[kind]`` names; its other keys are the parameters in SI.

    Parameters
    ----------
    catalogue : mapping
        Frozen dataclasses by name, with fields declared by `mrd_base.quantity`.
    kind : str
        What the catalogue holds, and the key of the name: ``"system"``.
    mapping : mapping
        Content of the YAML file.
    where : str
        Prefix of error messages.

    Raises
    ------
    InputError
        For a missing or unknown name, and as `mrd_base.from_mapping`.
    """
    if not isinstance(mapping, Mapping) or kind not in mapping:
        raise InputError(f"{where}: {kind} is missing, expected one of {', '.join(catalogue)}")
    name = mapping[kind]
    if not isinstance(name, str) or name not in catalogue:
        raise InputError(f"{where}: unknown {kind} {unknown_key(name, catalogue)}")
    return from_mapping(catalogue[name], {key: value for key, value in mapping.items() if key != kind}, where)


def require_number(value: Any, name: str) -> float:
    """Return a value from YAML that has to be a number.

    Raises
    ------
    InputError
        For anything else, also for a truth value, and for a number that is not finite.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InputError(f"{name} is {value!r:.60}, expected a finite number")
    return float(value)
