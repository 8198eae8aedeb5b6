"""The damper's own heat: dissipated power into one lump of heat capacity, with a loss to the ambient air."""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from mrd_base import quantity
from mrd_base.quantities import ZERO_CELSIUS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Heating:
    """A lump of heat capacity C that cools with a time constant t_c: C T' = P - C (T - T_a) / t_c.

    The defaults are those of a damper of about a kilogram of steel and oil in still air (Sahin, Cesmeci & Wereley: C of 300
    to 600 J/K, losses of 0.5 to 1.5 W/K).
    """

    heat_capacity: float = quantity(450.0, "J/K", "of the whole damper, as one lump", lower=0.1, upper=1e6)
    time_constant: float = quantity(450.0, "s", "of its cooling", lower=1, upper=1e5)
    ambient: float = quantity(25.0, "degC", "temperature of the room, and of the damper at first", lower=-40, upper=80)

    @property
    def ambient_kelvin(self) -> float:
        """Temperature of the room in K."""
        return self.ambient + ZERO_CELSIUS

    def warmed(self, temperature: float, power: Array, dt: float) -> Array:
        """Return the temperature (n,) in K after each of equally long steps, exact for a power that is constant in each.

        Parameters
        ----------
        temperature : float
            K, before the first step.
        power : ndarray (n,)
            W that goes into the damper in each step.
        dt : float
            s.
        """
        keep = math.exp(-dt / self.time_constant)
        gain = (1.0 - keep) * self.time_constant / self.heat_capacity
        start = [keep * (temperature - self.ambient_kelvin)]
        rise, _ = scipy.signal.lfilter([gain], [1.0, -keep], np.asarray(power, np.float64), zi=start)
        return np.asarray(self.ambient_kelvin + rise, np.float64)
