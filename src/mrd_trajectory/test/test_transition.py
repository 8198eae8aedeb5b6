"""Transitions meet their ends, are continuous, keep the limits, and are short."""

import numpy as np
import pytest
from hypothesis import assume, given, reject
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_trajectory.limits import Limits
from mrd_trajectory.path import REST, MotionState, concatenate, cut, extremes, largest_magnitude, quintic_hermite, state_at
from mrd_trajectory.transition import KINDS, corner, transition

LIMITS = Limits()
kinds = st.sampled_from(KINDS)
positions = st.floats(-0.02, 0.02)
speeds = st.floats(-0.12, 0.12)
accelerations = st.floats(-4, 4)


def end_of(path):
    return np.array([path(path.x[-1], nu) for nu in range(3)])


def assert_continuous(path):
    """No jump of position, velocity or acceleration at any break."""
    h = np.diff(path.x)[:-1]
    for nu in range(3):
        piece = path.derivative(nu)
        left = np.zeros(len(h))
        for row in piece.c[:, :-1]:
            left = left * h + row
        np.testing.assert_allclose(left, piece.c[-1, 1:], atol=(1e-9, 1e-7, 1e-4)[nu])


@given(kind=kinds, start=positions, end=positions)
def test_rest_to_rest_is_minimal(kind, start, end):
    assume(abs(end - start) > 1e-6)
    path = transition(kind, MotionState(start), MotionState(end), LIMITS)
    np.testing.assert_allclose(state_at(path, 0.0), [start, 0, 0], atol=1e-9)
    np.testing.assert_allclose(end_of(path), [end, 0, 0], atol=1e-7)
    assert_continuous(path)
    used = [
        largest_magnitude(path, 1) / LIMITS.speed,
        largest_magnitude(path, 2) / LIMITS.acceleration,
        largest_magnitude(path, 3) / LIMITS.jerk,
    ]
    assert max(used) == pytest.approx(1, rel=1e-5)


def test_linear_move_is_the_double_s_of_the_textbook():
    # Time of a move that reaches speed and acceleration limits: D/v + v/a + a/j (Biagiotti & Melchiorri 2008, §3.4).
    limits = Limits(speed=0.1, acceleration=5.0, jerk=1000.0)
    path = transition("linear", REST, MotionState(0.02), limits)
    assert path.x[-1] == pytest.approx(0.02 / 0.1 + 0.1 / 5 + 5 / 1000)
    assert path(path.x[-1] / 2, 1) == pytest.approx(0.1)


@given(kind=kinds, x0=positions, v0=speeds, a0=accelerations, x1=positions, v1=speeds, a1=accelerations)
def test_moving_ends_are_met_within_the_limits(kind, x0, v0, a0, x1, v1, a1):
    start, end = MotionState(x0, v0, a0), MotionState(x1, v1, a1)
    try:
        path = transition(kind, start, end, LIMITS)
    except InputError:
        reject()
    np.testing.assert_allclose(state_at(path, 0.0), start, atol=1e-6)
    np.testing.assert_allclose(end_of(path), end, atol=1e-5)
    assert_continuous(path)
    assert largest_magnitude(path) <= LIMITS.reach * (1 + 1e-5)
    assert largest_magnitude(path, 1) <= LIMITS.speed * (1 + 1e-5)
    assert largest_magnitude(path, 2) <= LIMITS.acceleration * (1 + 1e-5)
    assert largest_magnitude(path, 3) <= LIMITS.jerk * (1 + 1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_states_of_a_running_sine_are_reached_from_rest(kind):
    for phase in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        for amplitude, frequency in ((0.02, 1.0), (0.005, 3.0), (0.025, 0.1)):
            w = 2 * np.pi * frequency
            state = MotionState(amplitude * np.sin(phase), amplitude * w * np.cos(phase), -amplitude * w**2 * np.sin(phase))
            for path in (transition(kind, REST, state, LIMITS), transition(kind, state, REST, LIMITS)):
                assert path.x[-1] < 1.5


@given(kind=kinds, before=st.floats(-0.2, 0.2), after=st.floats(-0.2, 0.2))
def test_a_corner_joins_both_lines(kind, before, after):
    turn = corner(kind, before, after, LIMITS)
    half = turn.x[-1] / 2
    # Leaves the line "before" half its time ahead of the corner and meets "after" half its time past it.
    assert end_of(turn) == pytest.approx([(before + after) * half, after, 0], abs=1e-6)
    low, high = extremes(turn, 1)
    assert low >= min(before, after) - 1e-9
    assert high <= max(before, after) + 1e-9
    assert largest_magnitude(turn, 2) <= LIMITS.acceleration * (1 + 1e-5)
    assert largest_magnitude(turn, 3) <= LIMITS.jerk * (1 + 1e-5)


def test_the_same_state_needs_no_time():
    assert transition("quintic", MotionState(0.01, 0.1, 1.0), MotionState(0.01, 0.1, 1.0), LIMITS).x[-1] == 0


def test_hermite_follows_a_sine_to_sixth_order():
    time = np.linspace(0, 1, 33)
    w = 2 * np.pi
    path = quintic_hermite(time, np.sin(w * time), w * np.cos(w * time), -(w**2) * np.sin(w * time))
    fine = np.linspace(0, 1, 5000)
    assert np.abs(path(fine) - np.sin(w * fine)).max() < 2e-9
    assert largest_magnitude(path, 1) == pytest.approx(w, rel=1e-9)


def test_an_impossible_transition_is_refused_in_one_line():
    with pytest.raises(InputError, match=r"no quintic transition from 0 mm .* keeps the limits"):
        transition("quintic", REST, MotionState(0.0, 0.3), LIMITS)


def test_cut_and_concatenated_keep_the_motion():
    path = concatenate(
        [
            transition("linear", REST, MotionState(0.01), LIMITS),
            transition("cubic", MotionState(0.01), MotionState(-0.01), LIMITS),
        ]
    )
    shorter = cut(path, 0.1)
    fine = np.linspace(0, 0.1, 50)
    assert shorter.x[-1] == 0.1
    np.testing.assert_array_equal(shorter(fine), path(fine))
