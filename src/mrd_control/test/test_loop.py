"""The closed loop: statistics, exactness, energy; every model; the hybrid twin and the controller of the bench."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mrd_base import InputError
from mrd_control.controller import Actuator, Controller
from mrd_control.excitations import Bump, Road
from mrd_control.laws import LAWS
from mrd_control.linear import stationary_covariance
from mrd_control.loop import run_loop
from mrd_control.prediction import PREDICTORS
from mrd_control.systems import QuarterCar, ShearBuilding, SingleMass
from mrd_control.tracking import tracking
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS
from mrd_sim.path import Path

RATE = 1000.0
CONSTANT = LAWS["constant_current"]

JUMPING = {"hysteretic_biviscous": 0.98, "hyperbolic_tangent": 0.98, "sigmoid": 0.8, "pre_yield_hysteresis": 0.9}
"""Models and effects that jump with the sign of position, speed or acceleration, and how many samples have a root."""


def test_a_linear_damper_on_a_random_road_has_the_variance_of_the_lyapunov_equation(car, linear_damper):
    """Twenty roads of 200 s: the mean of their variances within 3 %, and within their own 95 % interval (times 1.5)."""
    road = Road("B", 20.0, lowest_frequency=0.0)
    covariance = stationary_covariance(car, 1500.0, road.velocity_psd)
    row = car.with_linear_damper(1500.0)[2]
    expected = np.array(
        [row @ covariance @ row, covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1], covariance[1, 1]]
    )
    found = []
    for seed in range(20):
        base = Road("B", 20.0, lowest_frequency=0.0, seed=seed).base(202_000, RATE)
        result = run_loop(car, linear_damper, CONSTANT, base, RATE)
        tyre = result.state[:, 1] - base[:, 0]
        found.append([series[2000:].var() for series in (result.acceleration, result.travel, tyre)])
    mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    assert (1.96 * error < 0.06 * expected).all()  # of the variance: 3 % of the rms
    np.testing.assert_allclose(np.sqrt(mean), np.sqrt(expected), rtol=0.03)
    assert (np.abs(mean - expected) < 1.5 * 1.96 * error).all()


def test_a_bouc_wen_damper_in_a_quarter_car_is_as_scipy_solves_it(car, bouc_wen):
    """Textbook equations of car, lags and damper in `solve_ivp`, at a tight tolerance."""
    p = dict(zip(bouc_wen.model.names, bouc_wen.theta, strict=True))
    current, lag, duration = 0.4, 0.003, 2.0
    bump = Bump(height=0.04, length=4.0, speed=12.0, start=0.2)

    def road(t):
        phase = 2 * np.pi * 12.0 / 4.0 * (t - 0.2)
        return 0.02 * (1 - np.cos(phase)) if 0 < phase < 2 * np.pi else 0.0

    def slope(t, s):
        z_s, z_u, v_s, v_u, w, i, u = s
        x, v = z_s - z_u, v_s - v_u
        F = (p["yield_force"] + p["yield_force_per_A"] * u) * w + (p["viscous"] + p["viscous_per_A"] * u) * v
        F += p["stiffness"] * x + p["offset"]
        rate = (v - p["shape"] * abs(v) * w * abs(w) - (1 - p["shape"]) * v * w * w) / p["yield_travel"]
        spring = 22e3 * x + F
        wheel = (spring - 190e3 * (z_u - road(t))) / 40.0
        return [v_s, v_u, -spring / 320.0, wheel, rate, (current - i) / lag, (i - u) / p["coil_lag"]]

    assert p["exponent"] == 2.0
    assert p["yield_travel_per_A"] == 0.0
    time = np.arange(int(duration * RATE) + 1) / RATE
    tight = solve_ivp(slope, (0, duration), np.zeros(7), "LSODA", time, rtol=1e-9, atol=1e-11, max_step=1e-3)
    errors = {}
    for rate in (RATE, 4 * RATE):
        base = bump.base(int(duration * rate) + 1, rate)
        result = run_loop(car, bouc_wen, CONSTANT, base, rate, gains={"current": current}, supply_lag=lag)
        every = round(rate / RATE)
        body, travel = result.state[::every, 0], result.travel[::every]
        assert np.abs(travel).max() > 0.01
        errors[rate] = (
            np.std(body - tight.y[0]) / np.std(tight.y[0]),
            np.std(travel - tight.y[0] + tight.y[1]) / np.std(travel),
        )
    assert max(errors[RATE]) < 3e-3
    assert max(errors[4 * RATE]) < 0.35 * max(errors[RATE])


@pytest.mark.parametrize("name", MODELS)
def test_every_model_acts_in_the_loop_as_along_a_path(name, car):
    """The force in the loop is the one that the model gives along the motion which the loop found."""
    damper = Damper(name)
    base = Road("C", 15.0, seed=2).base(3000, RATE)
    result = run_loop(car, damper, CONSTANT, base, RATE, gains={"current": 0.3}, supply_lag=0.0)
    assert not result.diverged
    assert np.ptp(result.travel) > 5e-3
    check_against_path(damper, result, JUMPING.get(name, 1.0))


@pytest.mark.parametrize(
    "name", [name for name, effect in EFFECTS.items() if effect.kernel is not None and name != "mains_hum"]
)
def test_every_effect_acts_in_the_loop_as_along_a_path(name, car):
    """All but those in series or of temperature, which the loop refuses, and the hum, whose phase a loop does not know."""
    damper = Damper("bouc_wen", effects={name: dict(EFFECTS[name].typical)})
    base = Road("C", 15.0, seed=2).base(2000, RATE)
    result = run_loop(car, damper, CONSTANT, base, RATE, gains={"current": 0.3}, supply_lag=0.0)
    assert not result.diverged
    check_against_path(damper, result, JUMPING.get(name, 1.0))


def check_against_path(damper, result, share=1.0):
    """Compare forces after the first sample: this share of them is the same within twice the tolerance of the loop."""
    n = len(result.time) - 1
    acceleration = np.diff(result.speed) * RATE
    along = Path(np.full(n, 1 / RATE), result.travel[1:], result.speed[1:], acceleration, result.current[1:], np.arange(n))
    state = damper.model.initial_state(Path(*np.zeros((5, 1)), np.arange(1)))
    expected = damper.model.forces(damper.theta, along, state)[0]
    error = np.abs(result.force[1:] - expected)
    assert np.quantile(error, share) < 2e-3


def test_an_effect_of_temperature_is_refused(car):
    damper = Damper("bouc_wen", effects={"temperature_dependence": {"viscous": 0.02}})
    with pytest.raises(InputError, match="with temperature_dependence: a loop has no temperature on which it could depend"):
        run_loop(car, damper, CONSTANT, np.zeros((100, 2)), RATE)


@pytest.mark.parametrize("name", ["series_compliance", "joint_play"])
def test_elements_in_series_are_refused(name, car):
    damper = Damper("bouc_wen", effects={name: dict(EFFECTS[name].typical)})
    with pytest.raises(InputError, match=f"{name} in series with the damper cannot act in a loop"):
        run_loop(car, damper, CONSTANT, np.zeros((100, 2)), RATE)


@settings(max_examples=25)
@given(
    st.sampled_from(
        [
            QuarterCar(),
            QuarterCar(passive_damping=300.0),
            SingleMass(),
            ShearBuilding(storey_damping=(0.0, 50.0, 50.0)),
            SingleMass(lever_ratio=0.6),
        ]
    ),
    st.sampled_from(["bouc_wen", "normalised_bouc_wen", "modified_dahl", "bingham", "modified_bouc_wen"]),
    st.sampled_from(["constant_current", "skyhook_on_off", "skyhook", "mixed_skyhook_add", "force_tracking"]),
    st.integers(0, 1000),
)
def test_energy_is_balanced_and_the_damper_is_passive(system, model, law, seed):
    """What the base gives is stored, lost in dashpots, or taken by the damper; and the damper never gives net energy.

    No dashpot is on the base here: its work is not resolved on a base with white velocity.
    """
    linear, damper = system.linear(), passive(model)
    base = Road("B", 20.0, seed=seed).base(4000, RATE) * (0.02 if linear.base_accelerates else 1.0)
    result = run_loop(linear, damper, LAWS[law], base, RATE)
    assert not result.diverged
    n = len(linear.mass)
    position, velocity = result.state[:, :n], result.state[:, n:]
    # Work over each interval by the trapezoidal rule: force times travel.
    travel = np.diff(result.travel)
    taken = np.cumsum(0.5 * (result.force[1:] + result.force[:-1]) * travel)
    assert not linear.base_damping.any()
    ground = position @ linear.base_stiffness - linear.base_stiffness.sum() * base[:, 0]
    if linear.lower < 0:
        ground = ground + linear.lever_ratio * result.force
    given_by_base = np.cumsum(-0.5 * (ground[1:] + ground[:-1]) * np.diff(base[:, 0]))
    kinetic = 0.5 * (velocity**2) @ linear.mass
    elastic = 0.5 * np.einsum("ki,ij,kj->k", position, linear.stiffness, position)
    elastic += -(position @ linear.base_stiffness) * base[:, 0] + 0.5 * linear.base_stiffness.sum() * base[:, 0] ** 2
    power = np.einsum("ki,ij,kj->k", velocity, linear.damping, velocity)
    lost = np.cumsum(0.5 * (power[1:] + power[:-1])) / RATE
    imbalance = given_by_base - (kinetic + elastic)[1:] - taken - lost
    scale = max(taken.max(), kinetic.max(), 1e-3)
    assert np.abs(imbalance).max() < 0.01 * scale
    # What a yielding element has stored it may give back: half the yield force times the yield travel, and its spring.
    assert taken.min() > -0.02 * scale - 0.05


def passive(model):
    """A damper without the parts that store energy or push: springs and preload."""
    free = {name: 0.0 for name in ("stiffness", "offset", "accumulator_stiffness") if name in MODELS[model].names}
    return Damper(model, free)


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_the_controller_of_the_bench_is_that_of_the_offline_twin(predictor, car, bouc_wen):
    """It gets the forces and positions that the twin has measured."""
    actuator = Actuator(0.004, 0.001, predictor)
    base = Road("A", 20.0, seed=4).base(1500, RATE)
    law = LAWS["clipped_lqg"]
    twin = run_loop(car, bouc_wen, law, base, RATE, actuator=actuator)
    controller = Controller(car, bouc_wen, law, RATE, actuator)
    states, _, answers = controller.add_block(base, twin.force[:-1], twin.rod[:-1])
    current, command, travel, speed, _ = answers.T
    np.testing.assert_allclose(states, twin.state[:-1], rtol=0, atol=1e-15)
    assert np.array_equal(current, twin.commanded[:-1])
    assert np.array_equal(command, twin.command[1:])
    np.testing.assert_allclose(travel, twin.travel[1:], rtol=0, atol=1e-15)
    np.testing.assert_allclose(speed, twin.speed[1:], rtol=0, atol=1e-12)


def test_without_delay_the_hybrid_loop_is_the_simulated_one(car, linear_damper):
    base = Bump(height=0.02).base(4000, RATE)
    touching = run_loop(car, linear_damper, CONSTANT, base, RATE)
    hybrid = run_loop(car, linear_damper, CONSTANT, base, RATE, actuator=Actuator(0.0))
    assert tracking(touching.travel, hybrid.travel, 1 / RATE).nrms < 0.03  # the force is held over a period
    finer = Bump(height=0.02).base(16_000, 4 * RATE)
    hybrid = run_loop(car, linear_damper, CONSTANT, finer, 4 * RATE, actuator=Actuator(0.0))
    assert tracking(touching.travel, hybrid.travel[::4], 1 / RATE).nrms < 0.01


def test_a_late_and_lagging_rod_is_found_by_the_tracking(car, linear_damper):
    base = Bump(height=0.02).base(4000, RATE)
    for actuator in (Actuator(0.003), Actuator(0.0035), Actuator(0.0, 0.003), Actuator(0.002, 0.001)):
        result = run_loop(car, linear_damper, CONSTANT, base, RATE, actuator=actuator)
        found = tracking(result.travel, result.rod, 1 / RATE)
        assert found.delay == pytest.approx(actuator.total_delay, abs=2e-4)


def test_an_unstable_loop_ends_early(car, linear_damper):
    result = run_loop(car, linear_damper, CONSTANT, Bump().base(30_000, RATE), RATE, actuator=Actuator(0.03))
    assert result.diverged
    assert len(result.time) == len(result.force) < 30_000
    assert np.abs(result.travel[-1]) >= 1.0 > np.abs(result.travel[-2])


def test_a_damper_is_not_changed_by_a_loop(car, bouc_wen):
    base = Road().base(1000, RATE)
    first = run_loop(car, bouc_wen, LAWS["clipped_lqg"], base, RATE)
    second = run_loop(car, bouc_wen, LAWS["clipped_lqg"], base, RATE)
    np.testing.assert_array_equal(first.force, second.force)
