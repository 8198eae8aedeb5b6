"""Emulated systems: their equations, their exact propagation, their response to white noise, their files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mrd_base import InputError
from mrd_control.linear import propagate, stationary_covariance
from mrd_control.systems import SYSTEMS, QuarterCar, ShearBuilding, SingleMass, read_system


def test_a_quarter_car_has_the_textbook_equations():
    car = QuarterCar(300.0, 50.0, 20e3, 180e3, 100.0).linear()
    z_s, z_u, v_s, v_u, z_r, F = 0.02, -0.01, 0.3, -0.2, 0.005, 70.0
    derivative = car.a @ [z_s, z_u, v_s, v_u] + car.b @ [z_r, 0.7, F]
    spring = 20e3 * (z_s - z_u) + 100.0 * (v_s - v_u)
    np.testing.assert_allclose(derivative[:2], [v_s, v_u])
    np.testing.assert_allclose(derivative[2:], [(-spring - F) / 300.0, (spring + F - 180e3 * (z_u - z_r)) / 50.0])


def test_a_shear_building_with_equal_storeys_has_the_known_frequencies():
    """w_r = 2 sqrt(k/m) sin((2 r - 1) pi / (2 (2 n + 1))), for example Chopra, Dynamics of Structures, section 10."""
    n, mass, stiffness = 5, 100.0, 4e5
    building = ShearBuilding((mass,) * n, (stiffness,) * n, (0.0,) * n).linear()
    expected = 2 * np.sqrt(stiffness / mass) * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (2 * (2 * n + 1)))
    found = np.sort(np.linalg.eigvals(building.a).imag)[n:]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_ends_of_the_damper_are_where_its_force_acts():
    for storey in (1, 2, 3):
        building = ShearBuilding(damper_storey=storey).linear()
        # Virtual work: what the force does to the masses is what the travel takes from the rod.
        momentum = building.mass * building.b[3:, 2]
        np.testing.assert_allclose(momentum, -building.outputs[3, :3])
    half = SingleMass(lever_ratio=0.5).linear()
    assert half.outputs[3, 0] == 0.5
    assert half.b[1, 2] == -0.5 / half.mass[0]


systems = st.one_of(
    st.builds(
        QuarterCar,
        st.floats(50, 500),
        st.floats(5, 60),
        st.floats(1e3, 5e4),
        st.floats(1e4, 3e5),
        st.floats(0, 3e3),
        st.floats(0.3, 2.0),
    ),
    st.builds(SingleMass, st.floats(5, 500), st.floats(1e2, 1e5), st.floats(0, 3e3)),
    st.integers(1, 4).flatmap(
        lambda n: st.builds(
            ShearBuilding,
            st.tuples(*[st.floats(50, 500)] * n),
            st.tuples(*[st.floats(1e4, 1e6)] * n),
            st.tuples(*[st.floats(0, 1e3)] * n),
            st.integers(1, n),
        )
    ),
)


@given(systems, st.floats(1e-4, 2e-2), st.integers(0, 2**32 - 1))
def test_propagation_is_exact_for_inputs_that_are_linear_in_time(system, period, seed):
    linear, rng = system.linear(), np.random.default_rng(seed)
    x = rng.normal(size=linear.order) * 0.01
    before, after = rng.normal(size=(2, 3)) * [0.01, 0.1, 300.0]
    step = propagate(linear.a, linear.b, period)

    def slope(time, state):
        return linear.a @ state + linear.b @ (before + (after - before) * time / period)

    tight = solve_ivp(slope, (0.0, period), x, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
    np.testing.assert_allclose(step.transition @ x + step.before @ before + step.after @ after, tight, atol=1e-10)


@pytest.mark.parametrize(
    ("density", "speed", "acceleration", "travel", "tyre"),
    [(64e-6, 20.0, 0.703, 5.51e-3, 392.5), (256e-6, 50 / 3.6, 1.172, 9.18e-3, 654.0)],
)
@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_a_linear_damper_on_a_road_gives_the_reference_values(density, speed, acceleration, travel, tyre, scale):
    """Quarter car of 320 and 40 kg on classes B and C; a car of a quarter of all values has the same motion."""
    car = QuarterCar(320.0 * scale, 40.0 * scale, 22e3 * scale, 190e3 * scale).linear()
    covariance = stationary_covariance(car, 1500.0 * scale, (2 * np.pi * 0.1) ** 2 * density * speed)

    def rms(row):
        return np.sqrt(row @ covariance @ row)

    assert rms(car.with_linear_damper(1500.0 * scale)[2]) == pytest.approx(acceleration, rel=0.01)
    assert rms(np.array([1.0, -1.0, 0.0, 0.0])) == pytest.approx(travel, rel=0.01)
    assert 190e3 * scale * rms(np.array([0.0, 1.0, 0.0, 0.0])) == pytest.approx(scale * tyre, rel=0.01)


def test_systems_are_read_from_yaml(tmp_path):
    file = tmp_path / "car.yaml"
    file.write_text("system: quarter_car\nsprung_mass_kg: 280\nspring_N_per_m: 18e3\n")
    assert read_system(file) == QuarterCar(280.0, spring=18e3)
    file.write_text("system: shear_building\nfloor_mass_kg: [200, 150]\nstorey_stiffness_N_per_m: [3e5, 2e5]\n")
    with pytest.raises(InputError, match="storey_damping has 3 values, expected 2"):
        read_system(file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("system: quarter_car\nsprung_mass_kg: -320\n", "sprung_mass_kg: found -320, expected 1 to 100000"),
        ("system: quarter_cat\n", "unknown system quarter_cat; did you mean quarter_car"),
        ("sprung_mass_kg: 320\n", "system is missing, expected one of quarter_car"),
        ("system: single_mass\nsprung_mass_kg: 3\n", "unknown key sprung_mass_kg"),
        ("system: shear_building\nfloor_mass_kg: [100, -1, 100]\n", r"floor_mass_kg\[1\]: found -1"),
        ("system: shear_building\ndamper_storey: 4\n", "damper_storey is 4, expected 1 to 3"),
    ],
)
def test_bad_systems_are_refused_in_one_line(tmp_path, text, message):
    file = tmp_path / "system.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=message) as refused:
        read_system(file)
    assert "\n" not in str(refused.value)
    assert str(file) in str(refused.value)


def test_every_system_has_a_static_load_or_none():
    for kind in SYSTEMS.values():
        system = kind().linear()
        assert (system.contact_load > 0) == (system.contact_stiffness > 0)
