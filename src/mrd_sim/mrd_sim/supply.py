"""The coil supply: volts on its control input become amperes in the damper's coil."""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_base import quantity

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CoilSupply:
    """A current-controlled supply with the coil on its output.

    The default is an analog controller of 0 to 5 V for 0 to 1 A. A LORD RD-3002-03 (Wonder Box) is ``gain`` 0.4 A/V about,
    ``dead_zone`` 0.5 V, ``current_limit`` 2 A. Coil of the RD-8040-1: 5 ohm at ambient, 5 to 20 mH (LORD technical
    data).
    """

    gain: float = quantity(0.2, "A/V", "current over control voltage, above the dead zone", lower=0.001, upper=10)
    dead_zone: float = quantity(0.0, "V", "control voltage below which nothing happens", lower=0, upper=5)
    input_limit: float = quantity(5.0, "V", "highest control voltage that counts", lower=0.1, upper=10)
    current_limit: float = quantity(1.0, "A", "of the supply", lower=0, upper=5)
    voltage_limit: float = quantity(12.0, "V", "across the coil, of either sign", lower=0.1, upper=100)
    response: float = quantity(0.0005, "ms", "time constant of the current controller", lower=1e-6, upper=1)
    resistance: float = quantity(5.0, "ohm", "of the coil", lower=0.01, upper=1000)
    inductance: float = quantity(0.01, "mH", "of the coil", lower=1e-6, upper=10)

    def target(self, volts: Array) -> Array:
        """Return the current in A that the supply aims at."""
        effective = np.clip(volts, 0.0, self.input_limit) - self.dead_zone
        return np.clip(self.gain * effective, 0.0, self.current_limit)

    def advance(self, dt: float, volts: Array, current: float) -> Array:
        """Return the coil current in A over equally spaced samples of control voltage.

        Parameters
        ----------
        dt : float
            s between samples.
        volts : ndarray (n,)
        current : float
            Coil current in A before the first sample.
        """
        rail = self.voltage_limit / self.resistance
        towards_target = -math.expm1(-dt / self.response)
        towards_rail = -math.expm1(-dt * self.resistance / self.inductance)
        followed: Array = _follow(self.target(volts), current, towards_target, towards_rail, rail)
        return followed


@njit(cache=True, nogil=True)
def _follow(target: Array, current: float, towards_target: float, towards_rail: float, rail: float) -> Array:
    """Return the first-order approach to the target, limited to what full voltage of either sign reaches in the coil."""
    followed = np.empty_like(target)
    for k in range(len(target)):
        wanted = current + (target[k] - current) * towards_target
        fastest = current + (rail - current) * towards_rail
        slowest = current + (-rail - current) * towards_rail
        current = min(max(wanted, slowest), fastest)
        followed[k] = current
    return followed
