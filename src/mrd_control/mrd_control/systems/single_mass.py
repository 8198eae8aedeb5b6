"""One mass with a spring on a moving base: the emulated system of the followed paper, a vibration table."""

from dataclasses import dataclass

import numpy as np

from mrd_base import quantity
from mrd_control.linear import LinearSystem
from mrd_control.systems.system import System, lever_field


@dataclass(frozen=True)
class SingleMass(System):
    """One degree of freedom, m z'' = -k (z - z_b) - c (z' - z_b') - F, with the damper between mass and base."""

    mass: float = quantity(250.0, "kg", "of the body", lower=0.1, upper=1e6)
    spring: float = quantity(20e3, "N/m", "stiffness between body and base", lower=0, upper=1e9)
    passive_damping: float = quantity(0.0, "N s/m", "of a dashpot beside the damper", lower=0, upper=1e7)
    lever_ratio: float = lever_field()

    def linear(self) -> LinearSystem:
        return LinearSystem(
            mass=np.array([self.mass]),
            stiffness=np.array([[self.spring]]),
            damping=np.array([[self.passive_damping]]),
            base_stiffness=np.array([self.spring]),
            base_damping=np.array([self.passive_damping]),
            upper=0,
            lower=-1,
            ride=0,
            drifts=np.array([[1.0]]),
            lever_ratio=self.lever_ratio,
        )
