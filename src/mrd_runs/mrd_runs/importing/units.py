"""Quantities of a recording, and the units in which other programs write them."""

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key

Array = NDArray[np.float64]

COLUMNS: Mapping[str, str] = {
    "time": "time_s",
    "position": "position_m",
    "velocity": "velocity_mps",
    "acceleration": "acceleration_mps2",
    "force": "force_N",
    "current": "current_A",
    "temperature": "temperature_C",
}
"""The column of a `Run` that each quantity becomes."""

_G = 9.80665  # m/s²
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1, "ms": 1e-3, "µs": 1e-6, "us": 1e-6, "ns": 1e-9, "sec": 1, "seconds": 1, "min": 60, "h": 3600},
    "position": {"m": 1, "mm": 1e-3, "cm": 1e-2, "µm": 1e-6, "um": 1e-6, "in": 0.0254, "inch": 0.0254},
    "velocity": {"m/s": 1, "mps": 1, "mm/s": 1e-3, "cm/s": 1e-2, "in/s": 0.0254},
    "acceleration": {"m/s2": 1, "mps2": 1, "mm/s2": 1e-3, "g": _G},
    "force": {"N": 1, "kN": 1e3, "mN": 1e-3, "MN": 1e6, "daN": 10, "lbf": 0.45359237 * _G, "kgf": _G},
    "current": {"A": 1, "mA": 1e-3, "µA": 1e-6, "uA": 1e-6},
    "temperature": {"°C": 1, "C": 1, "degC": 1, "K": 1, "°F": 5 / 9, "degF": 5 / 9},
}
"""Factor from each unit to the unit of the column; the first of each quantity is that unit."""

_ZEROS = {"K": 273.15, "°F": 32.0, "degF": 32.0}  # what 0 °C reads


def si_unit(quantity: str) -> str:
    """Return the unit of the column of a quantity."""
    return next(iter(UNITS[quantity]))


def find_unit(quantity: str, text: str) -> str | None:
    """Return the unit of a quantity that a text names, however it is written; None where it names none."""
    known = UNITS[quantity]
    plain = re.sub(r"[\s·*^]", "", text).replace("²", "2").replace("μ", "µ").replace("m/s/s", "m/s2").replace("s-1", "/s")
    same = [unit for unit in known if unit == plain] or [unit for unit in known if unit.lower() == plain.lower()]
    return same[0] if same else None


def is_unit(text: str) -> bool:
    """Return whether a text names a unit of any quantity."""
    return any(find_unit(quantity, text) for quantity in UNITS)


def to_si(quantity: str, values: Array, unit: str, where: str) -> Array:
    """Convert a series to the unit of its column.

    Parameters
    ----------
    quantity : str
    values : ndarray (n,)
    unit : str
        A unit of `UNITS`; or a number and a unit, such as ``200 N`` for a sensor of 200 N/V that is recorded in V.
    where : str
        Prefix of the error message.

    Raises
    ------
    InputError
        For another unit.
    """
    number, name = re.fullmatch(r"([+-]?[\d.]+(?:[eE][+-]?\d+)?)?\s*(.*)", unit, re.DOTALL).groups()  # type: ignore[union-attr]
    found = find_unit(quantity, name)
    try:
        scale = 1.0 if number is None else float(number)
    except ValueError:
        found = None
    if found is None:
        raise InputError(
            f"{where}: the {quantity} is in {unit or 'no unit'}, expected {', '.join(UNITS[quantity])}; name its unit with "
            f'--units {quantity}=UNIT, or what one unit of the file means with --units {quantity}="NUMBER UNIT"'
        )
    factor = scale * UNITS[quantity][found]
    zero = _ZEROS.get(found, 0.0)
    return values if factor == 1 and not zero else (values - zero) * factor


def check_quantity(name: str, option: str) -> str:
    """Return the name of a quantity; raise InputError for another one."""
    if name not in COLUMNS:
        raise InputError(f"{option}: unknown quantity {unknown_key(name, COLUMNS)}")
    return name
