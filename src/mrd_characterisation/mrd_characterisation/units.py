"""How results are shown: the units, and the signs of force and motion."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from mrd_base import InputError

INCH, POUND_FORCE = 0.0254, 4.4482216152605
"""m and N, exact by definition."""


@dataclass(frozen=True)
class Unit:
    """A unit in which an SI quantity is shown: shown = factor × (SI + offset)."""

    symbol: str
    factor: float = 1.0
    offset: float = 0.0

    def shown(self, value: float) -> float:
        """Return an SI value in this unit."""
        return self.factor * (value + self.offset)

    def difference(self, value: float) -> float:
        """Return a difference of two SI values, such as a standard deviation, in this unit."""
        return self.factor * value


UNITS: Mapping[str, Mapping[str, Unit]] = {
    "si": {
        "m": Unit("mm", 1e3),
        "m/s": Unit("mm/s", 1e3),
        "N": Unit("N"),
        "N/m": Unit("N/mm", 1e-3),
        "N s/m": Unit("N s/m"),
        "J": Unit("J"),
        "s": Unit("ms", 1e3),
        "K": Unit("°C", 1.0, -273.15),
    },
    "us": {
        "m": Unit("in", 1.0 / INCH),
        "m/s": Unit("in/s", 1.0 / INCH),
        "N": Unit("lbf", 1.0 / POUND_FORCE),
        "N/m": Unit("lbf/in", INCH / POUND_FORCE),
        "N s/m": Unit("lbf s/in", INCH / POUND_FORCE),
        "J": Unit("in lbf", 1.0 / (INCH * POUND_FORCE)),
        "s": Unit("ms", 1e3),
        "K": Unit("°F", 1.8, -459.67 / 1.8),
    },
}
"""Units by system and SI unit; what is not listed is shown in SI."""

_NUMBER = r"[-−]?\d[\d.]*(?:e[+-]?\d+)?"
_SYMBOLS = {unit.symbol: si for si, unit in UNITS["si"].items()}
_STATED = re.compile(
    rf"((?:{_NUMBER}(?: to | and |, ))*{_NUMBER}) "
    rf"({'|'.join(sorted(map(re.escape, _SYMBOLS), key=len, reverse=True))})(?![\w/])"
)
"""Numbers with a unit in a sentence, such as ``50 to 100 mm/s``."""


@dataclass(frozen=True)
class Orientation:
    """Signs of what is shown, relative to those of the bench.

    Attributes
    ----------
    force, motion : float
        1 or -1.
    sentence : str
        What is positive.
    """

    force: float
    motion: float
    sentence: str


ORIENTATIONS: Mapping[str, Orientation] = {
    "bench": Orientation(
        1.0, 1.0, "Position and speed are positive in rebound (extension), a force is positive where it resists rebound."
    ),
    "automotive": Orientation(
        1.0, -1.0, "Position and speed are positive in compression (bump), a force is positive where it resists rebound."
    ),
    "compression": Orientation(
        -1.0,
        -1.0,
        "Position and speed are positive in compression (bump), a force is positive where it resists compression.",
    ),
}
"""Orientations by name."""


@dataclass(frozen=True)
class View:
    """Units and signs in which a characterisation is shown."""

    units: str = "si"
    orientation: str = "bench"

    def __post_init__(self) -> None:
        for name, value, known in (("units", self.units, UNITS), ("orientation", self.orientation, ORIENTATIONS)):
            if value not in known:
                raise InputError(f"--{name} is {value}, expected one of {', '.join(known)}")

    def unit(self, si: str) -> Unit:
        """Return the unit in which quantities of an SI unit are shown."""
        return UNITS[self.units].get(si, Unit(si))

    def restated(self, sentence: str) -> str:
        """Return a sentence whose numbers have the units of the system ``si`` with numbers in the units of this view."""

        def restate(stated: re.Match[str]) -> str:
            numbers, symbol = stated.groups()
            source, unit = UNITS["si"][_SYMBOLS[symbol]], self.unit(_SYMBOLS[symbol])
            if unit == source:
                return stated[0]

            def convert(number: re.Match[str]) -> str:
                value = float(number[0].replace("−", "-")) / source.factor - source.offset
                return f"{unit.shown(value):.3g}"

            return f"{re.sub(_NUMBER, convert, numbers)} {unit.symbol}"

        return _STATED.sub(restate, sentence)

    @property
    def force(self) -> float:
        """Sign and factor of a force in N, with the sign of a direction."""
        return ORIENTATIONS[self.orientation].force * self.unit("N").factor

    @property
    def position(self) -> float:
        """Sign and factor of a position in m."""
        return ORIENTATIONS[self.orientation].motion * self.unit("m").factor

    @property
    def velocity(self) -> float:
        """Sign and factor of a velocity in m/s."""
        return ORIENTATIONS[self.orientation].motion * self.unit("m/s").factor

    @property
    def sentence(self) -> str:
        """What is positive."""
        return ORIENTATIONS[self.orientation].sentence


BENCH = View()
"""mm, mm/s and the signs of the bench."""
