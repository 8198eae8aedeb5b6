"""What single effects of fluid and structure do, beside what all effects promise (`test_effects.py`)."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mrd_sim.effects import EFFECTS
from mrd_sim.lag import decay, follow
from mrd_sim.models import find_model
from mrd_sim.path import make_path


def sine(amplitude=0.02, frequency=1.0, current=0.5, rate=2000.0, seconds=3.0):
    time = np.arange(int(rate * seconds)) / rate
    w = 2 * np.pi * frequency
    x = -amplitude * np.cos(w * time)
    return time, x, amplitude * w * np.sin(w * time), -w * w * x, np.full(len(time), current)


def apply(effect, values, time, x, v, a, u, force):
    """Force after an effect."""
    force = force.copy()
    p = np.array([values.get(parameter.name, parameter.default) for parameter in EFFECTS[effect].parameters])
    dt = np.diff(time, prepend=time[0])
    EFFECTS[effect].kernel(p, np.zeros(EFFECTS[effect].states), dt, x, v, a, u, force)
    return force


def added(effect, values, motion):
    return apply(effect, values, *motion, np.zeros(len(motion[0])))


def test_gas_spring_is_a_polytropic_accumulator_without_its_preload():
    area, pressure, volume, kappa = 78.5e-6, 1.5e6, 15e-6, 1.2
    motion = sine()
    x = motion[1]
    expected = -area * pressure * ((volume / (volume + area * x)) ** kappa - 1)
    values = {"stiffness": kappa * area**2 * pressure / volume, "curvature": (kappa + 1) * area / volume}
    assert added("gas_spring", values, motion) == pytest.approx(expected, abs=1e-9)


def test_cavitation_caps_compression_only_and_delays_the_rebound():
    time, x, v, a, u = sine(seconds=2.0)
    path = make_path(time, x, v, a, u)
    base = find_model("bingham")
    given = {"yield_force": 1500.0, "yield_force_per_A": 0.0, "offset": -50.0}
    plain = base.force(base.vector(given), path)
    model = find_model("bingham", effects=["cavitation"])

    def capped(cap):
        own = {"inverse_cap": 1 / cap, "opening": 10.0, "preload": 50.0}
        return model.force(model.vector(given | {f"cavitation.{name}": value for name, value in own.items()}), path)

    found = capped(1000.0)
    inward = (v < -0.05) & (time > 0.55)
    assert found[inward] == pytest.approx(-1050.0, rel=0.05)
    outward = v > 0.01
    first = outward & (time < 0.5)
    assert found[first] == pytest.approx(plain[first])
    # The void is crossed against next to nothing, and then all is as before.
    again = outward & (time > 1.0)
    crossing = again & (found < 150.0)
    assert np.ptp(x[crossing]) > 5e-3
    assert np.abs(found[crossing & (v > 0.02)] + 50.0).max() < 100.0
    late = again & (time > 1.465)
    assert found[late] == pytest.approx(plain[late], rel=1e-6)
    assert capped(5000.0) == pytest.approx(plain)


def test_asymmetry_is_a_share_of_the_force_by_direction():
    motion = sine()
    v = motion[2]
    found = apply("flow_asymmetry", {"asymmetry": 0.1, "turning": 5e-5}, *motion, 500.0 * np.sign(v))
    assert found[v > 0.05] == pytest.approx(550.0)
    assert found[v < -0.05] == pytest.approx(-450.0)


def test_asymmetry_turns_with_travel_after_a_reversal():
    x = np.r_[np.linspace(0, 0.01, 101), np.linspace(0.01, 0.0, 101)]
    time, still = np.arange(202) / 100, np.zeros(202)
    found = apply("flow_asymmetry", {"asymmetry": 0.1, "turning": 1e-3}, time, x, still, still, still, np.full(202, 100.0))
    travelled = np.linspace(0, 0.01, 101)
    assert found[:101] == pytest.approx(110.0 - 10.0 * np.exp(-travelled / 1e-3))
    assert found[101:] == pytest.approx(90.0 + 20.0 * np.exp(-travelled / 1e-3), abs=1e-2)


def test_shear_thinning_turns_a_viscous_force_into_a_power_law():
    motion = sine()
    v = motion[2]
    found = apply("shear_thinning", {"viscous": 900.0, "exponent": 0.6, "growth": 2.0}, *motion, 900.0 * (1 + 2.0 * 0.5) * v)
    assert found == pytest.approx(1800.0 * 0.1 * np.sign(v) * np.abs(v / 0.1) ** 0.6, abs=1e-9)


def test_rate_dependent_hysteresis_is_a_relaxing_element_in_place_of_a_dashpot():
    viscous, relaxation = 1000.0, 0.02
    time, _, v, _, u = motion = sine(frequency=3.0)
    rate = viscous / relaxation

    def element(t, force):
        return rate * np.interp(t, time, v) - force / relaxation

    expected = solve_ivp(element, (0, time[-1]), [viscous * v[0]], t_eval=time, max_step=1e-3, rtol=1e-8, atol=1e-6).y[0]
    values = {"viscous": viscous, "relaxation": relaxation}
    found = apply("rate_dependent_hysteresis", values, *motion, viscous * v)
    assert found == pytest.approx(expected, abs=1e-4 * max(expected))
    # At constant speed nothing is left of it.
    steady = (time, 0.05 * time, np.full(len(time), 0.05), 0.0 * time, u)
    assert np.array_equal(added("rate_dependent_hysteresis", values, steady), np.zeros(len(time)))


@pytest.mark.parametrize("frequency", [0.5, 4.0])
def test_its_loop_widens_with_the_speed_where_that_of_yielding_does_not(frequency):
    """Velocity that the loop is open by, at one stroke."""
    motion = sine(amplitude=0.005, frequency=frequency, seconds=4.0)
    found = added("rate_dependent_hysteresis", {"viscous": 1000.0, "relaxation": 2e-3}, motion)
    w = 2 * np.pi * frequency
    last = motion[0] > 2.0
    assert np.max(np.abs(found[last])) / 1000.0 == pytest.approx(2e-3 * 0.005 * w**2, rel=0.01)


def test_pre_yield_hysteresis_gives_a_coulomb_force_the_loop_of_dahl():
    time, x, v, _, u = motion = sine(amplitude=0.005)
    friction = 100.0 + 600.0 * u
    travel = 2e-4 * (1 + 0.5 * u[0])
    found = apply("pre_yield_hysteresis", {"yield_travel": 2e-4, "growth": 0.5}, *motion, friction * np.sign(v))
    settled = time > 0.5
    turning, direction = np.where(v > 0, x.min(), x.max()), np.sign(v)
    # Saturated at every reversal, so from there on one exponential in travel.
    expected = friction * direction * (1 - 2 * np.exp(-np.abs(x - turning) / travel))
    assert found[settled & (v != 0)] == pytest.approx(expected[settled & (v != 0)], abs=2e-2 * friction.max())


def test_thermal_fade_follows_the_energy_and_cools():
    time, _, _, _, u = sine(seconds=300.0, rate=50.0)
    v = np.where(time < 150.0, 0.1, 0.0)
    motion = (time, np.cumsum(v) / 50.0, v, 0.0 * v, 0.0 * u)
    found = apply("thermal_fade", {"fade": 5e-5, "cooling_time": 100.0}, *motion, np.full(len(time), 300.0))
    # E' = 300 exp(-b E) v - E / t_c, then nothing but cooling.
    heat = solve_ivp(lambda t, e: 30.0 * np.exp(-5e-5 * e) - e / 100.0, (0, 150), [0.0], rtol=1e-9, dense_output=True).sol
    assert found[time == 100.0] == pytest.approx(300.0 * np.exp(-5e-5 * heat(100.0)), rel=1e-3)
    left = heat(150.0) * np.exp(-1.0)
    assert found[time == 250.0] == pytest.approx(300.0 * np.exp(-5e-5 * left), rel=1e-3)
    coil = apply("thermal_fade", {"fade": 5e-5, "cooling_time": 100.0}, time, 0 * v, 0 * v, 0 * v, 2 * u, np.ones(len(time)))
    assert coil[-1] == pytest.approx(np.exp(-5e-5 * 5.0 * 100.0 * (1 - np.exp(-3.0))), rel=1e-3)


def test_a_force_that_drives_the_rod_cools_nothing():
    """Below ambient, the force would grow with what it gives, without bound."""
    time = np.arange(2000) / 500
    v = np.full(len(time), 0.1)
    force = np.full(len(time), -1e5)
    found = apply("thermal_fade", {"fade": 2e-4, "cooling_time": 100.0}, time, 0.1 * time, v, 0 * v, 0 * v, force)
    assert np.array_equal(found, force)


def test_heat_and_travel_go_on_in_the_next_path():
    for name in ("thermal_fade", "settling"):
        model = find_model("bouc_wen", effects=[name])
        theta = model.vector({f"{name}.{key}": value for key, value in EFFECTS[name].typical.items()})
        path = make_path(*sine())
        state = model.initial_state(path)
        first, second = model.force(theta, path, state), model.force(theta, path, state)
        assert np.ptp(second) < 0.99 * np.ptp(first)


def test_settling_goes_by_travel():
    for frequency in (0.5, 2.0):
        motion = sine(frequency=frequency)
        travelled = np.cumsum(np.abs(np.diff(motion[1], prepend=motion[1][0])))
        for order, left in ((1.01, np.exp(-travelled / 0.2)), (2.0, 1 / (1 + travelled / 0.2))):
            values = {"excess": 0.1, "travel": 0.2, "order": order}
            found = apply("settling", values, *motion, np.full(len(travelled), 100.0))
            assert found == pytest.approx(100.0 + 10.0 * left, abs=0.2 * (order < 1.1) + 1e-6)


def test_seal_friction_is_a_box_with_a_hump_at_low_speed():
    motion = sine()
    v = motion[2]
    values = {"coulomb": 40.0, "stiction": 0.5, "stribeck_speed": 5e-3, "presliding": 5e-6}
    found = added("seal_friction", values, motion)
    assert found[v > 0.05] == pytest.approx(40.0)
    assert found[v < -0.05] == pytest.approx(-40.0)
    assert 1.3 * 40.0 < found.max() <= 1.5 * 40.0
    assert (found * v)[np.abs(v) > 0.02].min() > 0.0


def test_a_seal_gives_before_it_slides():
    x = np.r_[np.linspace(0, 1e-3, 101), np.linspace(1e-3, 0.0, 101)]
    time, still = np.arange(202) / 100, np.zeros(202)
    values = {"coulomb": 40.0, "stiction": 0.0, "presliding": 1e-4}
    found = added("seal_friction", values, (time, x, still, still, still))
    travelled = np.linspace(0, 1e-3, 101)
    assert found[:101] == pytest.approx(40.0 * (1 - np.exp(-travelled / 1e-4)))
    assert found[101:] == pytest.approx(40.0 * (2 * np.exp(-travelled / 1e-4) - 1), abs=1e-2)


@pytest.mark.parametrize("speed", [1e-4, 4e-3, 0.05])
def test_a_seal_sticks_by_the_bristles_that_have_bent_not_by_the_speed_alone(speed):
    x = np.r_[np.linspace(0, 1e-3, 101), np.linspace(1e-3, 0.0, 101)[1:]]
    time, still = np.arange(201) * 1e-5 / speed, np.zeros(201)
    values = {"coulomb": 40.0, "stiction": 0.5, "stribeck_speed": 4e-3, "presliding": 1e-4}
    velocity = np.repeat([speed, -speed], [101, 100])
    found = added("seal_friction", values, (time, x, velocity, still, still))
    level = 1 + 0.5 * np.exp(-((speed / 4e-3) ** 2))
    given = np.exp(-np.linspace(0, 1e-3, 101) / (1e-4 * level))
    assert found[:101] == pytest.approx(40.0 * level * (1 - given))
    assert found[101:] == pytest.approx(40.0 * level * ((2 - given[-1]) * given[1:] - 1))


def test_side_load_friction_is_a_bow_tie():
    motion = sine()
    _, x, v, _, _ = motion
    found = added("side_load_friction", {"slope": 1000.0, "centre": 0.005}, motion)
    slides = np.abs(v) > 0.03
    assert found[slides] == pytest.approx((np.sign(v) * 1000.0 * np.abs(x - 0.005))[slides], rel=2e-3)


def test_end_stop_pushes_back_beyond_its_limit_only():
    motion = sine()
    x = motion[1]
    found = added("end_stop", {"stiffness": 1e7, "upper": 0.018, "lower": -0.018}, motion)
    assert np.array_equal(found != 0, np.abs(x) > 0.018)
    assert found[x.argmin()] == pytest.approx(-1e7 * 0.002**2)
    assert found[x.argmax()] == pytest.approx(1e7 * 0.002**2)


@pytest.mark.parametrize("exponent", [1.0, 1.5, 3.0])
def test_end_stop_follows_a_power_of_its_depth(exponent: float):
    motion = sine()
    depth = motion[1] - 0.014
    found = added("end_stop", {"stiffness": 1e7, "upper": 0.014, "lower": -0.014, "exponent": exponent}, motion)
    assert found[depth > 0] == pytest.approx(40.0 * (depth[depth > 0] / 0.002) ** exponent)


def test_joint_play_is_crossed_against_its_resistance():
    """At constant force far from its ends the joint opens at F / c_g; at its end the damper gets all of the motion."""
    time = np.arange(4000) / 4000
    motion = (time, 0.01 * time, np.full(len(time), 0.01), 0 * time, 0 * time)
    base, model = find_model("linear_viscous"), find_model("linear_viscous", effects=["joint_play"])
    own = {"viscous": 1000.0, "offset": 0.0}
    play = {"joint_play.play": 2e-3, "joint_play.resistance": 9000.0, "joint_play.film": 0.02}
    force = model.force(model.vector(own | play), make_path(*motion))
    alone = base.force(base.vector(own), make_path(*motion))
    # Dashpots in series: 1 / (1 / 1000 + 1 / 9000), the joint opens by 1 mm/s.
    assert force[time > 0.01] == pytest.approx(9.0, rel=5e-3)
    film = model.force(model.vector(own | play | {"joint_play.film": 0.98, "joint_play.play": 2e-4}), make_path(*motion))
    assert (np.diff(film[time > 0.01]) > -1e-6).all()
    assert film[-1] == pytest.approx(alone[-1], rel=1e-3)


def test_a_lag_far_longer_than_a_step_keeps_its_digits():
    for step in (1e-18, 1e-12, 1e-6, 1e-3):
        found = follow(0.2, -1.0, 1.0, 1.0 / step, decay(step, 1.0))
        assert found == pytest.approx(0.2 + step * (0.0 - 0.2), abs=1e-6 * step + 1e-12 + step**2)
