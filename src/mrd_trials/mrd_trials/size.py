"""The size of a damper, as a change of units.

All plants are made at the size of the reference damper. A plant of another size is the same physics in other units: the unit
of force, of length and of current are other ones, that of time stays, because mains, sensors' delays and sampling have
nothing to do with the size of a damper.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrd_runs import Run
from mrd_trajectory.settings import GeneratorSettings

FORCE, STROKE, CURRENT = 1e3, 0.055, 0.5
"""Size of the reference damper: force in N, stroke in m, current in A."""

FORCES, STROKES, CURRENTS = (5.0, 400e3), (1e-3, 0.5), (0.2, 5.0)
"""Ranges of the drawn sizes in the same units: from the brake of a haptic device to the damper of a building."""

USED_STROKE = 0.9
"""Share of its stroke that a measured damper is taken to have moved over."""

EXPONENTS = {
    "N": (1, 0, 0),
    "m": (0, 1, 0),
    "A": (0, 0, 1),
    "J": (1, 1, 0),
    "W": (1, 1, 0),
    "kg": (1, -1, 0),
    "Pa": (1, -2, 0),
    "Ohm": (1, 1, -2),
    "s": (0, 0, 0),
    "Hz": (0, 0, 0),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
}
"""Exponents of newton, metre and ampere in a unit; a kilogram is N s²/m."""


@dataclass(frozen=True)
class Size:
    """Forces, motions and currents of a damper over those of the same damper at the reference size."""

    force: float = 1.0
    motion: float = 1.0
    current: float = 1.0

    def factor(self, unit: str) -> float:
        """Return the factor of a quantity in a unit such as ``N s/(m A)``.

        Raises
        ------
        ValueError
            When the unit is unknown.
        """
        newton, metre, ampere = exponents(unit)
        return float(self.force**newton * self.motion**metre * self.current**ampere)

    @property
    def inverse(self) -> "Size":
        """The size that leads back."""
        return Size(1.0 / self.force, 1.0 / self.motion, 1.0 / self.current)

    def scaled(self, run: Run) -> Run:
        """Return a run of the reference size at this size."""
        return replace(
            run,
            position=run.position * self.motion,
            velocity=run.velocity * self.motion,
            acceleration=None if run.acceleration is None else run.acceleration * self.motion,
            current=run.current * self.current,
            force=run.force * self.force,
        )

    @property
    def bench(self) -> GeneratorSettings:
        """Limits of the bench that has this size, where the shipped bench has the reference size."""
        shipped = GeneratorSettings()
        units = {"stroke": "m", "margin": "m", "speed": "m/s", "acceleration": "m/s²", "jerk": "m/s³", "force": "N"}
        units |= {"current_min": "A", "current_max": "A"}
        envelope = {"offset": "N", "yield_force": "N", "yield_slope": "N/A", "viscosity": "N s/m"}
        envelope |= {"viscosity_slope": "N s/m/A"}
        return replace(
            shipped,
            limits=replace(
                shipped.limits, **{name: getattr(shipped.limits, name) * self.factor(unit) for name, unit in units.items()}
            ),
            force_envelope=replace(
                shipped.force_envelope,
                **{name: getattr(shipped.force_envelope, name) * self.factor(unit) for name, unit in envelope.items()},
            ),
        )


REFERENCE = Size()
"""That of the reference damper."""


def draw_size(rng: np.random.Generator) -> Size:
    """Draw a size; force, stroke and current are independent of each other and logarithmically uniform."""
    drawn = (float(low * (high / low) ** rng.random()) for low, high in (FORCES, STROKES, CURRENTS))
    return Size(*(value / reference for value, reference in zip(drawn, (FORCE, STROKE, CURRENT), strict=True)))


def measured_size(runs: Sequence[Run]) -> Size:
    """Return the size of a measured damper from all of its recordings; without current, that of the reference."""
    force = max(float(np.abs(run.force).max()) for run in runs)
    stroke = max(float(np.ptp(run.position)) for run in runs) / USED_STROKE
    current = max(float(np.abs(run.current).max()) for run in runs) or CURRENT
    return Size(force / FORCE, stroke / STROKE, current / CURRENT)


def exponents(unit: str) -> tuple[int, int, int]:
    """Return the exponents of newton, metre and ampere in a unit; what follows a stroke, or its brackets, is divided by.

    Raises
    ------
    ValueError
        When the unit is unknown.
    """
    total, end = np.zeros(3, dtype=int), 0
    for group in re.finditer(r"(/?)\s*(\([^)]*\)|[A-Za-z1]+[²³]?)\s*", unit):
        if group.start() != end:
            break
        end = group.end()
        for symbol, power in re.findall(r"([A-Za-z]+|1)([²³]?)", group[2]):
            if symbol not in EXPONENTS:
                raise ValueError(f"unit {unit}: found {symbol}, expected one of {', '.join(EXPONENTS)}")
            total += np.array(EXPONENTS[symbol]) * {"": 1, "²": 2, "³": 3}[power] * (-1 if group[1] else 1)
    if end != len(unit):
        raise ValueError(f"unit {unit}: is not understood from {unit[end:]!r} on")
    newton, metre, ampere = map(int, total)
    return newton, metre, ampere
