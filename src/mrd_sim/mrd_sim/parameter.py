"""A number on which a model or an effect depends."""

import math
from dataclasses import dataclass, replace
from typing import Literal

from mrd_runs.scales import LARGEST, Scales, extremes, rule

MOST_READING = 10.0 * LARGEST.stroke
"""m, beyond any reading of a position sensor on a bench."""


@dataclass(frozen=True)
class Parameter:
    """A number that identification may choose.

    Default and bounds are those for the reference damper (`mrd_runs.scales.REFERENCE`). For another one they grow with its
    scales, by the unit: a play in m with the stroke, a viscous coefficient in N s/m with force, time and stroke. A number
    that is ``absolute`` stays, for the reason given there. ``log`` asks for a logarithmic scale between the bounds. A
    parameter that is not ``free`` keeps its default unless it is set or freed by name. One whose bounds are its default is a
    constant of the equation, to which other parameters refer; it is never searched, and grows by powers of ten. A ``place``
    on the stroke counts from the one of this name in the scales (`mrd_runs.scales.Scales`), 0 for the reference damper.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    meaning: str
    log: bool = False
    free: bool = True
    absolute: str = ""
    place: Literal["", "mid_stroke", "centre"] = ""

    @property
    def is_constant(self) -> bool:
        """Whether it is a constant of the equation."""
        return self.lower == self.upper

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest value that any damper may have: wider than the bounds where these follow its scales."""
        if self.place:
            return -MOST_READING, MOST_READING
        least, most = (1.0, 1.0) if self.absolute else extremes(self.unit)
        return self.lower * (most if self.lower < 0.0 else least), self.upper * (most if self.upper > 0.0 else least)

    def scaled(self, scales: Scales) -> "Parameter":
        """Return the parameter with default and bounds for a damper of these scales."""
        default, lower, upper = (self.at_scales(value, scales) for value in (self.default, self.lower, self.upper))
        return replace(self, default=default, lower=lower, upper=upper)

    def at_scales(self, value: float, scales: Scales) -> float:
        """Return a value, stated for the reference damper, for a damper of these scales."""
        value *= self.factor(scales)
        return value + float(getattr(scales, self.place)) if self.place else value

    @property
    def rule(self) -> str:
        """Scales of the recordings with which the bounds grow, such as ``force / stroke``; empty where they stay."""
        return "" if self.absolute else rule(self.unit)

    def factor(self, scales: Scales) -> float:
        """Return by how much the parameter is larger for a damper of these scales than for the reference damper."""
        if self.absolute:
            return 1.0
        factor = scales.factor(self.unit)
        # Parameters that refer to a constant can be compared only where it is the same: it keeps its leading digits.
        return 10.0 ** round(math.log10(factor)) if self.is_constant else factor
