"""The exact step of the Bouc-Wen state against a tight solver of its differential equation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp, trapezoid

from mrd_sim.hysteresis import advance, slope


def reference(w, travel, sigma, n):
    """Solve dw/dx numerically, restarting where w changes sign."""
    direction = np.sign(travel)

    def rate(_x, v):
        return [slope(direction * v[0], direction, sigma, n)]

    def crossing(_x, v):
        return v[0]

    crossing.terminal = True
    crossing.direction = 1
    v, left = direction * w, abs(travel)
    while left > 0:
        options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
        part = solve_ivp(rate, (0, left), [v], events=crossing if v < 0 else None, **options)
        v = part.y[0, -1] if part.status == 0 else 0.0
        left -= part.t[-1]
    return direction * v


@pytest.mark.parametrize("n", [1.0, 1.3, 2.0, 3.5])
@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0, 1.4])
def test_step_agrees_with_a_tight_solver(n, sigma):
    random = np.random.default_rng(int(100 * sigma + 10 * n))
    for _ in range(60):
        w, travel = random.uniform(-0.99, 0.99), random.uniform(-4, 4)
        assert advance(w, travel, sigma, n) == pytest.approx(reference(w, travel, sigma, n), abs=1e-10)


@settings(max_examples=300)
@given(
    st.floats(-1, 1),
    st.floats(-50, 50),
    st.floats(-50, 50),
    st.floats(0.5, 2),
    st.sampled_from([1.0, 2.0]),
)
def test_class_one_stays_within_its_bound_and_two_steps_make_one(w, first, second, sigma, n):
    between = advance(w, first, sigma, n)
    assert -1 <= between <= 1
    if first * second >= 0:
        assert advance(between, second, sigma, n) == pytest.approx(advance(w, first + second, sigma, n), abs=1e-9)


@settings(max_examples=200)
@given(st.floats(-1, 1), st.floats(0.01, 5), st.floats(0.5, 2), st.sampled_from([1.0, 2.0]))
def test_odd_in_direction(w, travel, sigma, n):
    assert advance(-w, -travel, sigma, n) == pytest.approx(-advance(w, travel, sigma, n), abs=1e-14)


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_a_closed_cycle_dissipates(n):
    x = np.concatenate([np.linspace(0, 3, 300), np.linspace(3, -3, 600), np.linspace(-3, 3, 600)])
    w, states = 0.0, []
    for travel in np.diff(x, prepend=0.0):
        w = advance(w, travel, 0.8, n)
        states.append(w)
    assert trapezoid(states[300:], x[300:]) > 0
