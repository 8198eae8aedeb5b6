"""How acceptance, batch and sheet write numbers, their conditions and their limits."""

import math
from typing import Protocol

from mrd_base.quantities import four_figures, range_figures
from mrd_characterisation.units import BENCH, View


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


def number_text(value: float, unit: str, view: View = BENCH) -> str:
    """Return a number in SI with four significant figures, in the unit shown."""
    shown = view.unit(unit)
    return f"{four_figures(shown.shown(value))} {shown.symbol}".rstrip()


def difference_text(value: float, unit: str, view: View = BENCH) -> str:
    """Return a difference of two numbers in SI, which has no zero of its own: of temperatures, kelvins."""
    shown = view.unit(unit)
    return f"{four_figures(shown.difference(value))} {shown.symbol}".rstrip()


def range_text(lower: float, upper: float, unit: str, view: View = BENCH) -> str:
    """Return the ends of a range in SI, with the unit shown once."""
    shown = view.unit(unit)
    return f"{range_figures(shown.shown(lower), shown.shown(upper))} {shown.symbol}".rstrip()


def conditions_text(item: Conditions, view: View = BENCH) -> str:
    """Return the conditions of a value or a limit."""
    parts = [item.direction or ""]
    for name, number, unit in (("", item.speed, "m/s"), ("stroke ", item.stroke, "m")):
        if number is not None:
            parts.append(f"{name}{view.unit(unit).shown(number):.3g} {view.unit(unit).symbol}")
    if item.current is not None:
        step = "" if item.current_before is None else f"{_amperes(item.current_before)} to "
        parts.insert(2, f"{step}{_amperes(item.current)} A")
    return ", ".join(filter(None, parts))


def _amperes(current: float) -> str:
    """Return a current to a milliampere, so that the noise of the sensor is no current."""
    return f"{round(current, 3) + 0.0:g}"


def band_text(lower: float, upper: float, unit: str, view: View = BENCH) -> str:
    """Return limits in SI, of which one or both may be infinite, in words."""
    if math.isinf(lower) and math.isinf(upper):
        return "–"
    if math.isinf(upper):
        return f"at least {number_text(lower, unit, view)}"
    if math.isinf(lower):
        return f"at most {number_text(upper, unit, view)}"
    return range_text(lower, upper, unit, view)
