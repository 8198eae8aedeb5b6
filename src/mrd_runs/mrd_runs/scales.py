"""Scales of recordings: how large force, stroke, speed and current of a damper are, and where its mid-stroke is.

The ranges of parameters are stated in these scales.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mrd_base import InputError
from mrd_runs.run import Run

_BASE = {  # exponents of force, length, current and time
    "": (0, 0, 0, 0),
    "1": (0, 0, 0, 0),
    "rad": (0, 0, 0, 0),
    "N": (1, 0, 0, 0),
    "m": (0, 1, 0, 0),
    "mm": (0, 1, 0, 0),
    "A": (0, 0, 1, 0),
    "s": (0, 0, 0, 1),
    "Hz": (0, 0, 0, -1),
    "kg": (1, -1, 0, 2),
    "J": (1, 1, 0, 0),
    "W": (1, 1, 0, -1),
    "Pa": (1, -2, 0, 0),
    "Ohm": (1, 1, -2, -1),
    "K": (0, 0, 0, 0),
}
_POWERS = {"": 1, "²": 2, "³": 3, "^2": 2, "^3": 3, "^4": 4}
_NAMES = ("force", "stroke", "current", "time")


@dataclass(frozen=True)
class Scales:
    """Sizes by which recordings of one damper differ from those of another, and the zero of its positions.

    Attributes
    ----------
    force : float
        N, half the span of the force.
    stroke : float
        m, half the span of the position.
    speed : float
        m/s, of the fast strokes.
    current : float
        A, the largest.
    mid_stroke : float
        Reading of the position in m that counts as mid-stroke.
    centre : float
        m from there to the middle of the recorded strokes; 0 where these are about mid-stroke.
    """

    force: float
    stroke: float
    speed: float
    current: float
    mid_stroke: float = 0.0
    centre: float = 0.0

    @property
    def acceleration(self) -> float:
        """Acceleration in m/s² of a sine of these scales."""
        return self.speed**2 / self.stroke

    @property
    def time(self) -> float:
        """Time in s of half a stroke at the speed of the fast strokes."""
        return self.stroke / self.speed

    def counted_from(self, mid_stroke: float) -> "Scales":
        """Return the scales with another reading of the position in m as mid-stroke."""
        return replace(self, mid_stroke=mid_stroke, centre=self.mid_stroke + self.centre - mid_stroke)

    def factor(self, unit: str) -> float:
        """Return by how much a quantity of this SI unit is larger here than with the reference damper."""
        reference = REFERENCE
        ratios = (
            self.force / reference.force,
            self.stroke / reference.stroke,
            self.current / reference.current,
            self.time / reference.time,
        )
        return float(np.prod([ratio**power for ratio, power in zip(ratios, exponents(unit), strict=True)]))


REFERENCE = Scales(force=1200.0, stroke=0.02, speed=0.1, current=1.0)
"""Scales of the reference damper, for which ranges and start values are stated: a LORD RD-8040-1 in usual recordings."""


SMALLEST = Scales(force=1.0, stroke=2e-4, speed=1e-3, current=5e-3)
LARGEST = Scales(force=2e6, stroke=1.0, speed=10.0, current=50.0)
"""Scales beyond those of any damper on a bench."""
FAR_FROM_ZERO, NEAR_ZERO = 1.5, 0.1
"""Times half the recorded stroke. Where its middle is farther from zero, a position of zero cannot be mid-stroke; where it
is nearer, the strokes are about zero."""

FASTEST, SLOWEST = 1e-3, 1e3
"""Times of the fastest and of the slowest recordings over those of the reference damper."""


def extremes(unit: str) -> tuple[float, float]:
    """Return by how much a quantity of this unit is smaller or larger with any damper than with the reference damper."""
    least = most = 1.0
    ends = [
        (getattr(SMALLEST, name) / getattr(REFERENCE, name), getattr(LARGEST, name) / getattr(REFERENCE, name))
        for name in _NAMES[:3]
    ]
    for (low, high), power in zip([*ends, (FASTEST, SLOWEST)], exponents(unit), strict=True):
        least *= min(low**power, high**power)
        most *= max(low**power, high**power)
    return least, most


def scales_of(runs: Sequence[Run]) -> Scales:
    """Return the scales of recordings of one damper.

    Each is the largest of any run; quantiles keep outliers out. A current that is zero throughout has the scale of the
    reference damper. Mid-stroke is where the position is zero, unless this is far beyond what was recorded, as with a sensor
    that counts from elsewhere: then it is the middle of the recorded positions.
    """
    force = max(_half_span(run.force) for run in runs)
    stroke = max(_half_span(run.position) for run in runs)
    speed = max(float(np.quantile(np.abs(run.velocity), 0.95)) for run in runs)
    current = max(float(np.quantile(np.abs(run.current), 0.99)) for run in runs)
    found = force, stroke, speed, current
    force, stroke, speed, current = (
        value if value > 0.0 else default for value, default in zip(found, _values(REFERENCE), strict=True)
    )
    ends = [_ends(run.position) for run in runs]
    low, high = min(low for low, _ in ends), max(high for _, high in ends)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    if abs(middle) > FAR_FROM_ZERO * half:
        return Scales(force, stroke, speed, current, mid_stroke=middle)
    return Scales(force, stroke, speed, current, centre=middle if abs(middle) > NEAR_ZERO * half else 0.0)


def rule(unit: str) -> str:
    """Return by which scales a quantity of this unit grows, such as ``force / stroke``; empty for a pure number."""
    powers = dict(zip(_NAMES, exponents(unit), strict=True))

    def product(sign: int) -> str:
        parts = [name + _SUPERSCRIPTS[abs(power)] for name, power in powers.items() if power * sign > 0]
        return " ".join(parts)

    above, below = product(1), product(-1)
    return f"{above or 1} / {below}" if below else above


_SUPERSCRIPTS = {1: "", 2: "²", 3: "³", 4: "⁴"}


@cache
def exponents(unit: str) -> tuple[int, int, int, int]:
    """Return the exponents of force, length, current and time in an SI unit, such as (1, -1, 0, 1) for ``N s/m``.

    Raises
    ------
    InputError
        For a unit that is not made of those that models and effects use.
    """
    total = [0, 0, 0, 0]
    for place, part in enumerate(unit.split("/")):
        for symbol in part.strip(" ()").split():
            name, power = re.fullmatch(r"([A-Za-z1]*)(.*)", symbol).groups()  # type: ignore[union-attr]
            if name not in _BASE or power not in _POWERS:
                raise InputError(f"unit {unit!r}: {symbol} is not known, expected {', '.join(filter(None, _BASE))}")
            sign = -_POWERS[power] if place else _POWERS[power]
            total = [sum_ + sign * exponent for sum_, exponent in zip(total, _BASE[name], strict=True)]
    return total[0], total[1], total[2], total[3]


def _values(scales: Scales) -> tuple[float, ...]:
    return scales.force, scales.stroke, scales.speed, scales.current


def _half_span(values: np.ndarray) -> float:
    low, high = _ends(values)
    return 0.5 * (high - low)


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(values, [0.01, 0.99])
    return float(low), float(high)
