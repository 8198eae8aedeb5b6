"""Dampers and a car that several tests share."""

import pytest

from mrd_control.systems import QuarterCar
from mrd_sim.damper import Damper


@pytest.fixture(scope="session")
def car():
    """The quarter car of the reference values: 320 and 40 kg, 22 and 190 kN/m."""
    return QuarterCar().linear()


@pytest.fixture
def linear_damper():
    """A linear damper of 1500 N s/m at any current."""
    return Damper("linear_viscous", {"viscous": 1500.0, "viscous_per_A": 0.0, "coil_lag": 0.0})


@pytest.fixture
def bouc_wen():
    """The damper of the simulated bench."""
    values = {"yield_force": 80.0, "yield_force_per_A": 900.0, "yield_travel": 125e-6, "viscous": 900.0}
    return Damper("bouc_wen", {**values, "viscous_per_A": 2500.0, "stiffness": 1500.0, "offset": -45.0, "coil_lag": 0.004})
