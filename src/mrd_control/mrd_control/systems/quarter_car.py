"""A quarter car: body and wheel on a tyre."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_control.linear import LinearSystem
from mrd_control.systems.system import GRAVITY, System, lever_field


@dataclass(frozen=True)
class QuarterCar(System):
    """Body and wheel, m_s z_s'' = -k_s (z_s - z_u) - F and m_u z_u'' = k_s (z_s - z_u) + F - k_t (z_u - z_r)."""

    sprung_mass: float = quantity(320.0, "kg", "of the body", lower=1, upper=1e5)
    unsprung_mass: float = quantity(40.0, "kg", "of the wheel", lower=0.1, upper=1e5)
    spring: float = quantity(22e3, "N/m", "stiffness of the suspension", lower=0, upper=1e8)
    tyre: float = quantity(190e3, "N/m", "stiffness of the tyre", lower=1, upper=1e9)
    passive_damping: float = quantity(0.0, "N s/m", "of a dashpot beside the damper", lower=0, upper=1e6)
    lever_ratio: float = lever_field()

    def linear(self) -> LinearSystem:
        pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
        return LinearSystem(
            mass=np.array([self.sprung_mass, self.unsprung_mass]),
            stiffness=self.spring * pair + np.diag([0.0, self.tyre]),
            damping=self.passive_damping * pair,
            base_stiffness=np.array([0.0, self.tyre]),
            base_damping=np.zeros(2),
            upper=0,
            lower=1,
            ride=0,
            drifts=np.array([[1.0, -1.0]]),
            lever_ratio=self.lever_ratio,
            contact_stiffness=self.tyre,
            contact_load=GRAVITY * (self.sprung_mass + self.unsprung_mass),
        )
