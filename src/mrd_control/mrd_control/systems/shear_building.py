"""A shear building of any number of storeys, with the damper in one of them."""

from dataclasses import dataclass

import numpy as np

from mrd_base import InputError, quantity
from mrd_control.linear import LinearSystem
from mrd_control.systems.system import System, lever_field


@dataclass(frozen=True)
class ShearBuilding(System):
    """Rigid floors on columns; storey i with stiffness k_i and dashpot c_i is between floor i - 1 (the ground: 0) and i.

    The defaults are the three-storey model of Dyke et al., Smart Mater. Struct. 5 (1996), in round numbers.
    """

    floor_mass: tuple[float, ...] = quantity((98.3, 98.3, 98.3), "kg", "of the floors, from below", lower=0.01, upper=1e9)
    storey_stiffness: tuple[float, ...] = quantity(
        (516e3, 684e3, 684e3), "N/m", "of the storeys, from below", lower=1, upper=1e12
    )
    storey_damping: tuple[float, ...] = quantity(
        (125.0, 50.0, 50.0), "N s/m", "of the storeys, from below", lower=0, upper=1e12
    )
    damper_storey: int = quantity(1, "", "storey of the damper; 1 is the lowest", lower=1, upper=1000)
    lever_ratio: float = lever_field()

    def __post_init__(self) -> None:
        floors = len(self.floor_mass)
        for name, values in (("storey_stiffness", self.storey_stiffness), ("storey_damping", self.storey_damping)):
            if len(values) != floors:
                raise InputError(f"{name} has {len(values)} values, expected {floors}, one for each of floor_mass")
        if self.damper_storey > floors:
            raise InputError(f"damper_storey is {self.damper_storey}, expected 1 to {floors}")

    def linear(self) -> LinearSystem:
        floors = len(self.floor_mass)
        drifts = np.eye(floors) - np.eye(floors, k=-1)
        stiffness, damping = np.array(self.storey_stiffness), np.array(self.storey_damping)
        lowest = np.eye(floors)[0]
        return LinearSystem(
            mass=np.array(self.floor_mass),
            stiffness=drifts.T @ (stiffness[:, None] * drifts),
            damping=drifts.T @ (damping[:, None] * drifts),
            base_stiffness=stiffness[0] * lowest,
            base_damping=damping[0] * lowest,
            upper=self.damper_storey - 1,
            lower=self.damper_storey - 2,
            ride=floors - 1,
            drifts=drifts,
            lever_ratio=self.lever_ratio,
            base_accelerates=True,
        )
