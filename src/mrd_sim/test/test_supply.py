"""The simulated coil supply."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_sim.supply import CoilSupply

DT = 1 / 8000


def test_volts_to_amperes_at_rest():
    supply = CoilSupply()
    assert supply.target(np.array([-1.0, 0.0, 2.5, 5.0, 10.0])).tolist() == [0.0, 0.0, 0.5, 1.0, 1.0]


def test_dead_zone_and_limit_of_a_pulsed_driver():
    supply = CoilSupply(gain=0.4, dead_zone=0.5, current_limit=1.5)
    assert supply.target(np.array([0.3, 0.5, 1.5, 5.0])).tolist() == pytest.approx([0.0, 0.0, 0.4, 1.5])


def test_small_steps_follow_the_controller():
    supply = CoilSupply(response=0.002, voltage_limit=100.0)
    current = supply.advance(DT, np.full(800, 1.0), 0.0)
    t = DT * np.arange(1, 801)
    np.testing.assert_allclose(current, 0.2 * -np.expm1(-t / 0.002), atol=1e-12)


def test_a_full_step_is_as_fast_as_the_voltage_drives_the_coil():
    # 0 to 1 A takes -(L/R) ln(1 - I R / V).
    supply = CoilSupply(response=1e-6, current_limit=1.0)
    current = supply.advance(DT, np.full(800, 5.0), 0.0)
    full = -(0.01 / 5) * math.log(1 - 1.0 * 5 / 12)
    assert np.argmax(current > 0.999) * DT == pytest.approx(full, abs=2 * DT)


@given(st.lists(st.floats(-20, 20), min_size=1, max_size=50), st.floats(0, 1))
def test_current_stays_within_the_limits_and_does_not_depend_on_the_blocks(volts, start):
    supply = CoilSupply()
    commands = np.repeat(np.array(volts), 7)
    current = supply.advance(DT, commands, start)
    assert np.all((current >= 0) & (current <= 1))
    half = len(commands) // 2
    first = supply.advance(DT, commands[:half], start)
    second = supply.advance(DT, commands[half:], float(first[-1]) if half else start)
    np.testing.assert_array_equal(np.concatenate([first, second]), current)
