"""Largest force to expect of the damper, to check an experiment before the rod moves."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from mrd_base import quantity

# The methods take and return single numbers or arrays.
T = TypeVar("T", float, NDArray[np.float64])


@dataclass(frozen=True)
class ForceEnvelope:
    """Bingham model (Stanway, Sproston & Stevens 1987) of the largest force of the damper, affine in the coil current.

    The defaults were fitted to measured dampers of the RD-8040-1 class at 0 to 1 A.
    """

    offset: float = quantity(50.0, "N", "gas preload", lower=0, upper=1e7)
    yield_force: float = quantity(112.0, "N", "at 0 A", lower=0, upper=1e7)
    yield_slope: float = quantity(1051.0, "N/A", "rise of the yield force with the current", lower=1e-3, upper=1e9)
    viscosity: float = quantity(883.0, "N s/m", "rise of the force with the speed, at 0 A", lower=1e-3, upper=1e9)
    viscosity_slope: float = quantity(4304.0, "N s/m/A", "rise of the viscosity with the current", lower=0, upper=1e9)

    def force(self, speed: T, current: T) -> T:
        """Return the largest force in N at speeds in m/s and currents in A, both ≥ 0."""
        return self.at_rest(current) + self.slope(current) * speed

    def at_rest(self, current: T) -> T:
        """Return the largest force in N before the fluid yields."""
        return self.offset + self.yield_force + self.yield_slope * current

    def slope(self, current: T) -> T:
        """Return the slope of the largest force over the speed, in N·s/m."""
        return self.viscosity + self.viscosity_slope * current

    def current(self, force: float, speed: T) -> T:
        """Return the current in A that gives a force in N at a speed; negative where the speed alone gives more."""
        return (force - self.force(speed, 0.0 * speed)) / (self.yield_slope + self.viscosity_slope * speed)

    def speed(self, force: float, current: T) -> T:
        """Return the speed in m/s that gives a force in N at a current; negative where the current alone gives more."""
        return (force - self.at_rest(current)) / self.slope(current)
