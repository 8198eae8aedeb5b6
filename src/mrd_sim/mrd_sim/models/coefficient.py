"""A coefficient of a damper model and how it depends on the coil current."""

from dataclasses import dataclass
from typing import Literal

from mrd_sim.current import LAWS
from mrd_sim.effects.effect import VISCOUS, YIELD
from mrd_sim.parameter import Parameter

SATURATION_CURRENT = (1.5, 0.1, 10.0)
"""A. Default and bounds of the current at which a law saturates, for the reference damper: some saturate from 1 to 2.5 A."""


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of a model's equation and how it depends on the lagged coil current.

    Parameters
    ----------
    name, symbol, unit, meaning : str
        ``symbol`` as in the equation.
    default, lower, upper : float
        At 0 A.
    per_ampere : (default, lower, upper), optional
        Slope over current at 0 A; None for a coefficient that does not depend on current.
    log, free
        See `Parameter`.
    multiplies : str
        What it multiplies, where the force is linear in it: position ``x``, velocity ``v``, one ``1``, or ``term``, a term
        that only the kernel knows. Empty for a coefficient in which the force is not linear; whatever its law, such a
        coefficient never falls below the least value that any damper may have.
    absolute, place : str
        See `Parameter`.
    part : str
        Part of the force that is in proportion to it: ``viscous``, ``yield``, or empty for neither. ``by unit`` takes what
        is in N s/m or Pa s for viscous and what is in N, but for a constant force, for yield.
    law : str
        Id of its current law (`mrd_sim.current.LAWS`); without a slope the law is "constant".
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    default: float
    lower: float
    upper: float
    per_ampere: tuple[float, float, float] | None = None
    log: bool = False
    free: bool = True
    multiplies: Literal["", "x", "v", "1", "term"] = ""
    law: str = "affine"
    absolute: str = ""
    place: Literal["", "mid_stroke", "centre"] = ""
    part: Literal["", "viscous", "yield", "by unit"] = "by unit"

    @property
    def part_code(self) -> int:
        """`VISCOUS`, `YIELD`, or 0 for neither part of the force."""
        part = self.part
        if part == "by unit":
            of_yield = self.unit == "N" and self.multiplies != "1"
            part = "viscous" if self.unit in ("N s/m", "Pa s") else "yield" if of_yield else ""
        return {"viscous": VISCOUS, "yield": YIELD}.get(part, 0)

    @property
    def code(self) -> int:
        """Number of its current law."""
        return LAWS[self.law].code if self.per_ampere else 0

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the law's parameters: value at 0 A, slope there and, where the law has one, a third parameter."""
        bounds = self.default, self.lower, self.upper
        at_zero = Parameter(self.name, self.unit, *bounds, self.meaning, self.log, self.free, self.absolute, self.place)
        if self.per_ampere is None or self.law == "constant":
            return (at_zero,)
        default, lower, upper = self.per_ampere
        unit = f"{self.unit}/A" if self.unit else "1/A"
        slope = Parameter(
            f"{self.name}_per_A",
            unit,
            default,
            lower,
            upper,
            f"{self.meaning}, slope over current at 0 A",
            free=self.free,
            absolute=self.absolute,
        )
        suffix = LAWS[self.law].third
        if not suffix:
            return (at_zero, slope)
        if suffix == "_per_A2":
            most = max(abs(lower), abs(upper))
            third = Parameter(
                self.name + suffix, f"{unit}²", 0.0, -most, most, f"{self.meaning}, square term over current", free=self.free
            )
        else:
            meaning = f"{self.meaning}, current at which it saturates"
            third = Parameter(self.name + suffix, "A", *SATURATION_CURRENT, meaning, log=True, free=self.free)
        return (at_zero, slope, third)
