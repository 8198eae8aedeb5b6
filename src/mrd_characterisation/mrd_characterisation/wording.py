"""How acceptance, batch and sheet write numbers, their conditions and their limits."""

import math
from dataclasses import dataclass, field
from collections.abc import Mapping

from mrd_base.quantities import four_figures
from mrd_characterisation.characterisation import Value
from mrd_characterisation.limits import Limit


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


def number_text(value: float, unit: str, units: Units = SI) -> str:
    """Return a number in SI with four significant figures, in the unit of the page."""
    shown, name = units.convert(value, unit)
    return f"{four_figures(shown)} {name}".rstrip()


def conditions_text(item: Value | Limit, units: Units = SI) -> str:
    """Return the conditions of a value or a limit."""
    step = "" if item.current_before is None else f"{item.current_before:.3g} to "
    parts = [
        item.direction or "",
        "" if item.speed is None else number_text(item.speed, "m/s", units),
        "" if item.current is None else f"{step}{item.current:.3g} A",
        "" if item.stroke is None else f"stroke {number_text(item.stroke, 'm', units)}",
    ]
    return ", ".join(filter(None, parts))


def band_text(limit: Limit, units: Units = SI) -> str:
    """Return the limits in words."""
    if math.isinf(limit.upper):
        return f"at least {number_text(limit.lower, limit.unit, units)}"
    if math.isinf(limit.lower):
        return f"at most {number_text(limit.upper, limit.unit, units)}"
    return f"{number_text(limit.lower, limit.unit, units)} to {number_text(limit.upper, limit.unit, units)}"
