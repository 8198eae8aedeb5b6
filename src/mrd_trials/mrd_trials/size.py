"""The size of a damper, as a change of units.

All plants are made at the size of the reference damper. A plant of another size is the same physics in other units: the unit
of force, of length and of current are other ones, that of time stays, because mains, sensors' delays and sampling have
nothing to do with the size of a damper.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mrd_runs import Run
from mrd_runs.scales import exponents
from mrd_trajectory.settings import GeneratorSettings

FORCE, STROKE, CURRENT = 1e3, 0.055, 0.5
"""Size of the reference damper: force in N, stroke in m, current in A."""

FORCES, STROKES, CURRENTS = (5.0, 400e3), (1e-3, 0.5), (0.2, 5.0)
"""Ranges of the drawn sizes in the same units: from the brake of a haptic device to the damper of a building."""

USED_STROKE = 0.9
"""Share of its stroke that a measured damper is taken to have moved over."""


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
        InputError
            When the unit is unknown.
        """
        newton, metre, ampere, _ = exponents(unit)
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
