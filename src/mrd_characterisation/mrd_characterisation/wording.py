"""How acceptance, batch and sheet write numbers, their conditions and their limits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from mrd_characterisation.limits import Limit


class Conditions(Protocol):
    """What holds for a value, a limit, or a number of a batch; None where it does not apply."""

    @property
    def direction(self) -> str | None:
        """Direction of the motion."""

    @property
    def current(self) -> float | None:
        """A; that after a step."""

    @property
    def current_before(self) -> float | None:
        """A, before a step."""

    @property
    def speed(self) -> float | None:
        """m/s."""

    @property
    def stroke(self) -> float | None:
        """m."""


@dataclass(frozen=True)
class Units:
    """Units of a page: by SI unit the name of another one, the factor to it, and what is added."""

    name: str
    of: Mapping[str, tuple[str, float, float]] = field(default_factory=dict)

    def convert(self, value: float, unit: str) -> tuple[float, str]:
        """Return a number in SI in the unit of the page, and this unit."""
        shown, factor, offset = self.of.get(unit, (unit, 1.0, 0.0))
        return value * factor + offset, shown


SI = Units("si", {"m/s": ("mm/s", 1e3, 0.0), "m": ("mm", 1e3, 0.0), "s": ("ms", 1e3, 0.0), "K": ("°C", 1.0, -273.15)})


def four_figures(value: float) -> str:
    """Format a number with four significant figures, those before the point in full: 123456 rather than 1.235e+05."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"


def number_text(value: float, unit: str, units: Units = SI) -> str:
    """Return a number in SI with four significant figures, in the unit of the page."""
    shown, name = units.convert(value, unit)
    return f"{four_figures(shown)} {name}".rstrip()


def range_text(lower: float, upper: float, unit: str, units: Units = SI) -> str:
    """Return the ends of a range in SI, with the unit of the page once."""
    low, high = (units.convert(end, unit)[0] for end in (lower, upper))
    return f"{four_figures(low)} to {four_figures(high)} {units.convert(0.0, unit)[1]}".rstrip()


def _three_figures(value: float, unit: str, units: Units) -> str:
    """Return a condition, which never holds to more than three figures."""
    shown, name = units.convert(value, unit)
    return f"{shown:.3g} {name}"


def conditions_text(item: Conditions, units: Units = SI) -> str:
    """Return the conditions of a value or a limit."""
    step = "" if item.current_before is None else f"{item.current_before:.3g} to "
    parts = [
        item.direction or "",
        "" if item.speed is None else _three_figures(item.speed, "m/s", units),
        "" if item.current is None else f"{step}{item.current:.3g} A",
        "" if item.stroke is None else f"stroke {_three_figures(item.stroke, 'm', units)}",
    ]
    return ", ".join(filter(None, parts))


def band_text(limit: Limit, units: Units = SI) -> str:
    """Return the limits in words."""
    if math.isinf(limit.upper):
        return f"at least {number_text(limit.lower, limit.unit, units)}"
    if math.isinf(limit.lower):
        return f"at most {number_text(limit.upper, limit.unit, units)}"
    return range_text(limit.lower, limit.upper, limit.unit, units)
