"""What the files of one rig do not tell, saved once: a YAML file in the place of options of the importer."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mrd_base import InputError
from mrd_base.config import read_yaml, unknown_key
from mrd_runs.importing.finish import Mapped
from mrd_runs.importing.units import COLUMNS, check_quantity, to_si

MAPPINGS = {"map": "columns", "topics": "topics", "units": "units"}
"""Entries that are mappings by quantity, with the field of `Mapped` that each becomes."""

ENTRIES = (*MAPPINGS, "flip", "current", "rate")


def read_rig(file: str | Path) -> Mapped:
    """Read what the files of a rig do not tell.

    Parameters
    ----------
    file : path
        A YAML file with any of the entries `ENTRIES`, which mean what the options of the importer of the same names do::

            map: {time: "Zeit [ms]", position: "Weg [mm]", force: Kanal 2}
            units: {force: 200 N}
            flip: [force]
            current: 0.5

    Raises
    ------
    InputError
        When the file cannot be read, or holds anything else.
    """
    content = read_yaml(file)
    for entry in content:
        if entry not in ENTRIES:
            raise InputError(f"{file}: unknown entry {unknown_key(str(entry), ENTRIES)}")
    fields: dict[str, Any] = {}
    for entry, name in MAPPINGS.items():
        if entry in content:
            fields[name] = _mapping(content[entry], f"{file}: {entry}")
    flip = content.get("flip", [])
    if not isinstance(flip, list):
        raise InputError(f"{file}: flip is {flip!r}, expected a list of quantities")
    fields["flip"] = tuple(check_quantity(str(name), f"{file}: flip") for name in flip)
    for entry in ("current", "rate"):
        if entry in content:
            fields[entry] = _number(content[entry], f"{file}: {entry}")
    mapped = replace(Mapped(), **fields)
    mapped.check(f"{file}: ")
    for quantity, unit in mapped.units.items():
        to_si(quantity, np.zeros(0), unit, f"{file}: units")
    return mapped


def _mapping(value: object, where: str) -> dict[str, str]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where} is {value!r}, expected {{QUANTITY: TEXT}} with some of {', '.join(COLUMNS)}")
    return {check_quantity(str(name), where): str(text) for name, text in value.items()}


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where} is {value!r}, expected a number")
    return float(value)
