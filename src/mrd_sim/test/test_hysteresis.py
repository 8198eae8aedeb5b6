"""The exact step of the Bouc-Wen state against a tight solver of its differential equation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.integrate import solve_ivp, trapezoid

from mrd_sim.dual_type import as_duals
from mrd_sim.hysteresis import advance, advance_twice, slope


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


STATES = st.floats(-1, 1)
SIGMAS = st.one_of(st.sampled_from([0.5, 1.0]), st.floats(0.5, 1.5))
EXPONENTS = st.one_of(st.sampled_from([1.0, 2.0]), st.floats(1, 5))
LOG_TRAVELS = st.floats(-9, 3)
SIGNS = st.sampled_from([-1.0, 1.0])


@settings(max_examples=500)
@given(STATES, LOG_TRAVELS, SIGNS, SIGMAS, EXPONENTS)
def test_finite_and_within_the_bound_of_class_one(w, log_travel, sign, sigma, n):
    after = advance(w, sign * 10**log_travel, sigma, n)
    assert np.isfinite(after)
    assert abs(after) <= 1 + 1e-12


@given(st.lists(st.floats(-3, 3), min_size=50, max_size=200), SIGMAS, EXPONENTS)
@settings(max_examples=50)
def test_stays_within_the_bound_along_a_random_path(travels, sigma, n):
    w = 0.0
    for travel in travels:
        w = advance(w, travel, sigma, n)
        assert abs(w) <= 1 + 1e-12


@settings(max_examples=500)
@given(STATES, LOG_TRAVELS, SIGNS, SIGMAS, EXPONENTS)
def test_both_states_of_a_divided_travel(w, log_travel, sign, sigma, n):
    travel = sign * 10**log_travel
    expected = advance(w, travel, sigma, n), advance(w, 2 * travel, sigma, n)
    assert advance_twice(w, travel, sigma, n) == pytest.approx(expected, abs=1e-10)


@settings(max_examples=500)
@given(STATES, LOG_TRAVELS, LOG_TRAVELS, SIGNS, SIGMAS, EXPONENTS)
def test_two_steps_make_one(w, first, second, sign, sigma, n):
    first, second = sign * 10**first, sign * 10**second
    between = advance(w, first, sigma, n)
    assert advance(between, second, sigma, n) == pytest.approx(advance(w, first + second, sigma, n), abs=1e-10)


@settings(max_examples=200)
@given(STATES, LOG_TRAVELS, SIGMAS, EXPONENTS)
def test_odd_in_direction(w, log_travel, sigma, n):
    travel = 10**log_travel
    assert advance(-w, -travel, sigma, n) == pytest.approx(-advance(w, travel, sigma, n), abs=1e-14)


@settings(max_examples=500)
@given(STATES, LOG_TRAVELS, st.floats(1e-6, 2), SIGMAS, EXPONENTS)
def test_the_farther_the_rod_the_higher_the_state(w, log_travel, more, sigma, n):
    travel = 10**log_travel
    before, after = advance(w, travel, sigma, n), advance(w, travel * (1 + more), sigma, n)
    assert w - 1e-13 <= before <= after + 1e-13


@settings(max_examples=300)
@given(STATES, LOG_TRAVELS, SIGNS, SIGMAS, st.sampled_from([1.0, 2.0]), st.sampled_from([1e-12, 1e-9, 1e-6]))
def test_general_exponent_tends_to_the_closed_forms(w, log_travel, sign, sigma, n, near):
    travel = sign * 10**log_travel
    closed = advance(w, travel, sigma, n)
    assert advance(w, travel, sigma, n + near) == pytest.approx(closed, abs=3 * near + 1e-12)


@njit
def _advance(at, advanced):
    advanced[0] = advance(at[0], at[1], at[2], at[3])


@settings(max_examples=300)
@given(
    st.floats(-0.99, 0.99, allow_subnormal=False),
    st.floats(-4, 1),
    SIGNS,
    st.floats(0.51, 1.4),
    st.one_of(st.just(2.0), st.floats(1.05, 5)),
)
def test_derivatives_to_state_travel_shape_and_exponent(w, log_travel, sign, sigma, n):
    at = [w, sign * 10**log_travel, sigma, n]
    dual, advanced = as_duals(np.array(at)), as_duals(np.zeros(1))
    for i in range(4):
        dual.derivatives[:, 0] = np.arange(4) == i
        _advance(dual, advanced)
        h = 1e-6 * max(abs(at[i]), 0.1) if i != 1 else 1e-5 * abs(at[i])
        sides = [advance(*(value + side * h * (j == i) for j, value in enumerate(at))) for side in (-1, 1)]
        # Accuracy of a central difference: its truncation and its rounding.
        slope = pytest.approx((sides[1] - sides[0]) / (2 * h), rel=1e-5, abs=1e-6 + 1e-13 / h)
        assert advanced.derivatives[0, 0] == slope


@pytest.mark.parametrize("n", [1.0, 1.6, 2.0, 4.0])
def test_a_closed_cycle_dissipates(n):
    x = np.concatenate([np.linspace(0, 3, 300), np.linspace(3, -3, 600), np.linspace(-3, 3, 600)])
    w, states = 0.0, []
    for travel in np.diff(x, prepend=0.0):
        w = advance(w, travel, 0.8, n)
        states.append(w)
    assert trapezoid(states[300:], x[300:]) > 0
