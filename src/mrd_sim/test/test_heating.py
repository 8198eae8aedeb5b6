"""The damper's own heat."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_sim.heating import Heating

capacities, times = st.floats(1.0, 1e5), st.floats(10.0, 1e4)


@given(capacities, times, st.floats(0.0, 1e4))
def test_a_constant_power_ends_where_the_loss_equals_it(capacity, time_constant, power):
    heating = Heating(capacity, time_constant, ambient=20.0)
    warmed = heating.warmed(293.15, np.full(3000, power), time_constant / 100.0)
    assert warmed[-1] - 293.15 == pytest.approx(power * time_constant / capacity, rel=1e-9, abs=1e-9)
    assert (np.diff(warmed) >= -1e-9 * warmed[-1]).all()


@given(capacities, times, st.integers(1, 99))
def test_the_cut_into_blocks_changes_nothing(capacity, time_constant, cut):
    heating = Heating(capacity, time_constant)
    power = np.random.default_rng(cut).uniform(-10.0, 100.0, 100)
    whole = heating.warmed(310.0, power, 0.5)
    first = heating.warmed(310.0, power[:cut], 0.5)
    second = heating.warmed(float(first[-1]), power[cut:], 0.5)
    assert np.allclose(np.concatenate([first, second]), whole, rtol=1e-12)


def test_without_a_loss_worth_mentioning_the_heat_stays():
    warmed = Heating(heat_capacity=500.0, time_constant=1e5).warmed(298.15, np.full(100, 50.0), 0.1)
    assert warmed[-1] - 298.15 == pytest.approx(50.0 * 10.0 / 500.0, rel=1e-3)
