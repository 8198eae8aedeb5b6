"""Limits of bench and damper on motion, force and current."""

from dataclasses import dataclass

from mrd_base import InputError, quantity

LARGEST_CURRENT = 50.0
"""A, of any coil: bound of what a file may hold. The limits of a bench are in its file."""


@dataclass(frozen=True)
class Limits:
    """Limits of bench and damper; the section ``limits`` of bench.yaml.

    The position is 0 at mid-stroke. Its magnitude may be up to half of ``stroke`` less ``margin``.

    Raises
    ------
    InputError
        For a margin that leaves nothing of the stroke.
    """

    stroke: float = quantity(0.055, "mm", "travel of the damper, end to end (LORD RD-8040-1: 55 mm)", lower=1e-3, upper=1)
    margin: float = quantity(0.0015, "mm", "kept free at both ends of the stroke", lower=0, upper=0.1)
    speed: float = quantity(0.2, "mm/s", "of the rod", lower=1e-4, upper=10)
    acceleration: float = quantity(10.0, "m/s2", "of the rod", lower=0.01, upper=200)
    jerk: float = quantity(1000.0, "m/s3", "of the rod", lower=0.1, upper=1e6)
    force: float = quantity(800.0, "N", "on the load cell (100 kg cell: 981 N at rated load)", lower=0.1, upper=2e6)
    current_min: float = quantity(0.0, "A", "of the coil", lower=-LARGEST_CURRENT, upper=0)
    current_max: float = quantity(1.0, "A", "of the coil, continuous", lower=1e-3, upper=LARGEST_CURRENT)

    def __post_init__(self) -> None:
        if self.margin >= 0.5 * self.stroke:
            raise InputError(
                f"margin_mm: found {1e3 * self.margin:.4g}, expected less than {500 * self.stroke:.4g}, half of stroke_mm; "
                "choose the margin for this damper"
            )

    @property
    def reach(self) -> float:
        """Largest allowed distance of the rod from mid-stroke, in m."""
        return self.stroke / 2 - self.margin
