"""Quantities of a recording, and the units in which other programs write them."""

import re
import unicodedata
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.config import unknown_key
from mrd_runs.text import one_line

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
_LBF = 0.45359237 * _G
_LENGTHS: Mapping[str, float] = {
    **{"m": 1, "mm": 1e-3, "cm": 1e-2, "dm": 0.1, "km": 1e3, "µm": 1e-6, "nm": 1e-9},
    **{"in": 0.0254, "ft": 0.3048, "mil": 2.54e-5, "thou": 2.54e-5, "mi": 1609.344},
}
_TIMES: Mapping[str, float] = {"s": 1, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60, "h": 3600, "d": 86400}
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": _TIMES,
    "position": _LENGTHS,
    "velocity": {
        f"{length}/{time}": a / b for length, a in _LENGTHS.items() for time, b in _TIMES.items() if 1 <= b <= 3600
    },
    "acceleration": {f"{length}/s2": factor for length, factor in _LENGTHS.items()}
    | {"g": _G, "mg": 1e-3 * _G, "gal": 0.01},
    "force": {
        **{"N": 1, "kN": 1e3, "mN": 1e-3, "MN": 1e6, "daN": 10, "µN": 1e-6, "dyn": 1e-5},
        **{"lbf": _LBF, "klbf": 1e3 * _LBF, "ozf": _LBF / 16, "kgf": _G, "gf": 1e-3 * _G, "tf": 1e3 * _G},
    },
    "current": {"A": 1, "mA": 1e-3, "µA": 1e-6, "kA": 1e3},
    "temperature": {"°C": 1, "K": 1, "°F": 5 / 9},
}
"""Factor from each unit to the unit of the column; the first of each quantity is that unit."""

_ZEROS = {"K": 273.15, "°F": 32.0}  # what 0 °C reads

SYNONYMS: Mapping[str, Mapping[str, str]] = {
    "time": {
        **{"s": "sec secs second seconds", "ms": "msec msecs millisecond milliseconds", "ns": "nsec nanosecond nanoseconds"},
        **{
            "µs": "usec µsec microsecond microseconds",
            "min": "mins minute minutes",
            "h": "hr hrs hour hours",
            "d": "day days",
        },
    },
    "position": {
        **{"m": "meter meters metre metres", "mm": "millimeter millimeters millimetre millimetres"},
        **{"cm": "centimeter centimeters centimetre centimetres", "µm": "micron microns micrometer micrometers micrometre"},
        **{"in": 'inch inches " ″', "ft": "foot feet", "mil": "mils", "mi": "mile miles"},
    },
    "velocity": {
        "in/s": "ips",
        "ft/s": "fps",
        "mi/h": "mph",
        "km/h": "kph kmh kmph",
        "mm/s": "mmps",
        "m/s": "mps",
        "in/min": "ipm",
    },
    "acceleration": {"m/s2": "mps2 mpss", "mm/s2": "mmps2", "g": "gn g's gs", "gal": "gals"},
    "force": {
        **{
            "N": "newton newtons",
            "kN": "kilonewton kilonewtons",
            "lbf": "lb lbs lbsf pound pounds pound-force",
            "ozf": "oz",
        },
        **{"klbf": "kip kips klb klbs kipf", "kgf": "kg kp kilogram kilograms", "tf": "tonnef", "dyn": "dyne dynes"},
    },
    "current": {"A": "amp amps ampere amperes", "mA": "milliamp milliamps milliampere milliamperes"},
    "temperature": {"°C": "c degc deg_c celsius", "K": "kelvin", "°F": "f degf deg_f fahrenheit"},
}
"""Other ways to write a unit, in lower case."""

_OTHER_WORDS = (
    "v mv µv kv volt volts mv/v v/v count counts digit digits lsb adc bit bits % percent bar mbar psi pa kpa mpa "
    "rad deg ° degree degrees rpm rev/min rad/s deg/s hz khz w kw nm n·m n*m ohm ω n/mm n/m n·s/m µe strain"
)
_OTHERS = frozenset(_OTHER_WORDS.split())
"""Units of other quantities, in lower case."""
_RATIO = re.compile(r"[^\s/]+(/|_per_)(s|sec|ms|min|h|hr|m|mm|rev|v)\^?[23]?", re.IGNORECASE)


def si_unit(quantity: str) -> str:
    """Return the unit of the column of a quantity."""
    return next(iter(UNITS[quantity]))


def find_unit(quantity: str, text: str) -> str | None:
    """Return the unit of a quantity that a text names, however it is written; None where it names none."""
    plain = re.sub(r"[\s·*^.]", "", unicodedata.normalize("NFKC", text)).replace("μ", "µ").replace("−", "-")
    plain = re.sub(r"_?per_?|_", "/", plain, flags=re.IGNORECASE) if quantity in ("velocity", "acceleration") else plain
    plain = re.sub(r"/?s(?:ec)?-([12])$|/s(?:ec)?/s(?:ec)?$|/sec(?=2?$)", lambda m: _rate(m[1], m[0]), plain)
    plain = plain.replace("/hr", "/h")
    forms = [plain, re.sub(r"^[uU](?=[A-Za-z])", "µ", plain)]
    spoken = {form: unit for unit, words in SYNONYMS[quantity].items() for form in words.split()}
    known = {unit: unit for unit in UNITS[quantity]}
    lower = {unit.lower(): unit for unit in reversed(list(UNITS[quantity]))}
    of_form = (table.get(form) for table in (known, spoken) for form in forms)
    of_lower = (table.get(form.lower()) for table in (lower, spoken) for form in forms)
    return next((unit for unit in (*of_form, *of_lower) if unit), None)


def _rate(power: str | None, text: str) -> str:
    """Return ``/s`` or ``/s2`` for what stands for it."""
    return "/s2" if power == "2" or text.count("/s") == 2 else "/s"


def is_unit(text: str) -> bool:
    """Return whether a text names a unit of any quantity of a recording."""
    return any(find_unit(quantity, text) for quantity in UNITS)


def looks_like_unit(text: str) -> bool:
    """Return whether a text names a unit of any kind, known or not."""
    plain = unicodedata.normalize("NFKC", text).strip().replace("μ", "µ")
    return is_unit(plain) or plain.lower() in _OTHERS or bool(_RATIO.fullmatch(plain))


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
    if found and (scale == 0 or not np.isfinite(scale)):
        raise InputError(f"{where}: one unit of the {quantity} is {one_line(unit)}, expected another number than {scale:g}")
    if found is None:
        raise InputError(
            f"{where}: the {quantity} is in {one_line(unit) or 'no unit'}, expected {', '.join(list(UNITS[quantity])[:9])}; "
            f"name its unit with --units {quantity}=UNIT, or what one unit of the file means with "
            f'--units {quantity}="NUMBER UNIT"'
        )
    factor, zero = UNITS[quantity][found], _ZEROS.get(found, 0.0)
    if zero:
        return (values * scale - zero) * factor
    return values if scale * factor == 1 else values * (scale * factor)


def check_quantity(name: str, option: str) -> str:
    """Return the name of a quantity; raise InputError for another one."""
    if name not in COLUMNS:
        raise InputError(f"{option}: unknown quantity {unknown_key(name, COLUMNS)}")
    return name
