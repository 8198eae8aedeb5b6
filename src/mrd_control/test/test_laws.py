"""Control laws: when they ask for current, that they never ask for active force, that optimal ones are optimal."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from mrd_base import InputError
from mrd_control.excitations import Road
from mrd_control.force_map import current_for_force, inverse_map
from mrd_control.laws import LAWS, find_law
from mrd_control.laws.law import STATE
from mrd_control.laws.optimal import optimal_gains
from mrd_control.loop import run_loop
from mrd_control.systems import QuarterCar, ShearBuilding, SingleMass
from mrd_sim.damper import Damper
from mrd_sim.models import MODELS

RATE = 1000.0
CAR = QuarterCar().linear()
BOUC_WEN = Damper("bouc_wen", {"yield_force": 80.0, "yield_force_per_A": 900.0, "offset": 0.0, "stiffness": 0.0})
TABLE = inverse_map(BOUC_WEN, 1.0)

speeds = st.floats(-1.0, 1.0)


def asked(name, *, acceleration=0.0, upper=0.0, lower=0.0, travel=0.0, speed=None, force=0.0, state=None, gains=None):
    """Current that a law asks for in one situation."""
    law = LAWS[name]
    speed = upper - lower if speed is None else speed
    signals = np.concatenate(
        [[1 / RATE, acceleration, upper, lower, travel, speed, force, 1.0], np.zeros(4) if state is None else state]
    )
    assert len(signals) == STATE + 4
    return law.kernel(law.vector(gains or {}, CAR, 1 / RATE), np.zeros(law.memory(CAR)), signals, TABLE)


@given(speeds, speeds, st.floats(-20, 20))
def test_two_state_laws_follow_their_rules(upper, lower, acceleration):
    speed, situation = upper - lower, {"upper": upper, "lower": lower, "acceleration": acceleration}
    assert asked("skyhook_on_off", **situation) == (0.3 if upper * speed >= 0 else 0.0)
    assert asked("acceleration_driven", **situation) == (0.3 if acceleration * speed >= 0 else 0.0)
    slow = acceleration**2 <= (4 * np.pi * upper) ** 2
    rule = "skyhook_on_off" if slow else "acceleration_driven"
    assert asked("mixed_skyhook_add", **situation) == asked(rule, **situation)
    assert asked("constant_current", gains={"current": 0.2}, **situation) == 0.2


@given(speeds, speeds, st.floats(0, 1))
def test_laws_with_a_force_demand_never_ask_for_active_force(upper, lower, share):
    """No current where the demanded force has the direction of the motion, and the clipped force does never."""
    speed = upper - lower
    sky, ground = 4000.0 * upper, -1000.0 * lower
    for name, demand, gains in (
        ("skyhook", sky, {}),
        ("groundhook", ground, {}),
        ("force_tracking", sky, {}),
        ("hybrid", share * sky * (sky * speed > 0) + (1 - share) * ground * (ground * speed > 0), {"share": share}),
    ):
        current = asked(name, upper=upper, lower=lower, gains=gains)
        assert current >= 0.0
        if demand * speed <= 0.0:
            assert current == 0.0


@given(st.floats(-2e3, 2e3), st.lists(st.floats(-0.5, 0.5), min_size=4, max_size=4))
def test_the_clipped_optimal_law_asks_only_while_the_force_is_to_rise(force, state):
    demanded = optimal_gains(LAWS["clipped_lqr"].values({}), CAR) @ state
    current = asked("clipped_lqr", force=force, state=np.array(state))
    assert current == (0.3 if (demanded - force) * force > 0 else 0.0)
    if demanded * force < 0:
        assert current == 0.0


@given(st.floats(0.002, 2.0), st.sampled_from([-1.0, 1.0]), st.floats(0.0, 1.0))
def test_the_inverse_model_gives_the_current_of_a_force(speed, direction, current):
    """In steady motion; between the speeds of the map the force is taken as linear."""
    damper = BOUC_WEN.model.at_current(BOUC_WEN.theta, current)
    force = direction * (damper["yield_force"] + damper["viscous"] * speed)
    assert current_for_force(TABLE, direction * speed, force) == pytest.approx(current, abs=1e-3)
    assert current_for_force(TABLE, -direction * speed, force) == 0.0
    assert current_for_force(TABLE, direction * speed, 1e6 * direction) == 1.0
    assert current_for_force(TABLE, direction * speed, 0.1 * direction) == 0.0


@pytest.mark.parametrize("name", MODELS)
def test_every_model_has_an_inverse_or_says_why_not(name):
    damper = Damper(name)
    try:
        table = inverse_map(damper, 1.0)
    except InputError as refused:
        assert "has no inverse: at" in str(refused)  # noqa: PT017
        assert "\n" not in str(refused)  # noqa: PT017
    else:
        resisting = np.sign(table[1:, :1]) * table[1:, 1:]
        assert (np.diff(resisting, axis=1) >= 0).all()


def test_a_damper_of_one_newton_has_an_inverse():
    small = {"yield_force": 0.1, "yield_force_per_A": 0.5, "viscous": 0.2, "viscous_per_A": 0.0}
    assert (np.diff(inverse_map(Damper("bingham", small), 1.0)[-1, 1:]) > 0.0).all()
    with pytest.raises(InputError, match="has no inverse"):
        inverse_map(Damper("bingham", {**small, "yield_force_per_A": 1e-4}), 1.0)


def test_a_law_that_needs_an_inverse_refuses_a_damper_without_one():
    constant = Damper("linear_viscous", {"viscous_per_A": 0.0})
    base = np.zeros((100, 2))
    with pytest.raises(InputError, match=r"model linear_viscous has no inverse: at .* expected a force that rises"):
        run_loop(CAR, constant, LAWS["skyhook"], base, RATE)
    run_loop(CAR, constant, LAWS["skyhook_on_off"], base, RATE)


@settings(max_examples=30)
@given(st.sampled_from([QuarterCar(), SingleMass(passive_damping=50.0), ShearBuilding()]), st.integers(0, 2**32 - 1))
def test_optimal_gains_cannot_be_bettered(system, seed):
    """The mean cost under white noise, by the Lyapunov equation, rises with any small change of the gains."""
    linear, values, rng = system.linear(), LAWS["clipped_lqr"].values({}), np.random.default_rng(seed)
    n, order = len(linear.mass), linear.order
    gains = optimal_gains(values, linear)
    noise = rng.normal(size=(order, order))

    def cost(k):
        closed = linear.a + np.outer(linear.b[:, 2], k)
        assert np.linalg.eigvals(closed).real.max() < 0
        covariance = solve_continuous_lyapunov(closed, -noise @ noise.T)
        drifts = np.hstack([linear.drifts, np.zeros_like(linear.drifts)])
        total = closed[n + linear.ride] @ covariance @ closed[n + linear.ride]
        total += (
            values["drift_weight"] * np.trace(drifts @ covariance @ drifts.T) + values["force_weight"] * k @ covariance @ k
        )
        if linear.contact_stiffness:
            total += values["contact_weight"] * covariance[linear.lower, linear.lower]
        return total

    least = cost(gains)
    for _ in range(5):
        change = 1e-3 * np.abs(gains).max() * rng.normal(size=order) * (np.abs(gains) / np.abs(gains).max() + 1e-2)
        assert cost(gains + change) >= least * (1 - 1e-9)


def test_the_estimated_state_comes_near_the_true_one():
    """LQG and LQR mostly agree, because the Kalman filter has found the state."""
    base = Road("B", 20.0, seed=1).base(20_000, RATE)
    known = run_loop(CAR, BOUC_WEN, LAWS["clipped_lqr"], base, RATE)
    estimated = run_loop(CAR, BOUC_WEN, LAWS["clipped_lqg"], base, RATE)
    assert estimated.acceleration.std() == pytest.approx(known.acceleration.std(), rel=0.02)
    assert estimated.travel.std() == pytest.approx(known.travel.std(), rel=0.03)
    assert np.mean(known.commanded > 0) > 0.03


def test_force_feedback_makes_up_for_a_wrong_model():
    """The damper is weaker than the inverse believes: with feedback its force is nearer to the demanded one."""
    strong = Damper("bouc_wen", {"yield_force": 80.0, "yield_force_per_A": 900.0, "offset": 0.0, "stiffness": 0.0})
    table = inverse_map(strong, 1.0)
    weak = Damper("bouc_wen", {"yield_force": 80.0, "yield_force_per_A": 500.0, "offset": 0.0, "stiffness": 0.0})
    theta, law = weak.theta, LAWS["force_tracking"]
    speed, wanted, errors = 0.1, 500.0, {}
    for name, gains in (("open", {"proportional_gain": 0.0, "integral_gain": 0.0}), ("closed", {})):
        parameters, memory = law.vector({"skyhook_viscous": wanted / speed, **gains}, CAR, 1 / RATE), np.zeros(1)
        current = 0.0
        for _ in range(2000):
            damper = weak.model.at_current(theta, min(max(current, 0.0), 1.0))
            force = damper["yield_force"] + damper["viscous"] * speed
            signals = np.array([1 / RATE, 0.0, speed, 0.0, 0.0, speed, force, 1.0, *np.zeros(4)])
            current = law.kernel(parameters, memory, signals, table)
        errors[name] = abs(force - wanted)
    assert errors["open"] > 50.0
    assert errors["closed"] < 1.0


def test_skyhook_calms_the_body_where_the_damper_can_be_soft():
    """A car heavy enough for the damper: less body velocity than any constant current gives, and less acceleration too."""
    system = QuarterCar(320.0, 40.0, lever_ratio=0.4).linear()
    damper = Damper("bouc_wen", {"yield_force": 80.0, "yield_force_per_A": 900.0, "viscous": 900.0, "offset": 0.0})
    base = Road("C", 20.0, seed=1).base(40_000, RATE)
    passive = [
        run_loop(system, damper, LAWS["constant_current"], base, RATE, gains={"current": current}).acceleration[2000:].std()
        for current in np.linspace(0, 1, 9)
    ]
    active = run_loop(system, damper, LAWS["skyhook"], base, RATE).acceleration[2000:].std()
    assert active < 0.95 * min(passive)


@pytest.mark.parametrize(
    ("name", "gains", "message"),
    [
        ("skyhok", {}, "unknown law skyhok; did you mean skyhook"),
        ("skyhook", {"gain": 1.0}, "law skyhook: unknown parameter gain .*skyhook_viscous"),
        ("hybrid", {"share": 1.2}, "law hybrid: share is 1.2, expected 0 to 1"),
        ("constant_current", {"current": -0.1}, "current is -0.1 A, expected 0 to 5"),
    ],
)
def test_unknown_laws_and_parameters_are_refused_in_one_line(name, gains, message):
    with pytest.raises(InputError, match=message) as refused:
        find_law(name).values(gains)
    assert "\n" not in str(refused.value)


def test_every_law_is_in_the_catalogue_by_its_id():
    assert all(law.id == name for name, law in LAWS.items())


def test_a_lever_changes_the_damper_not_the_skyhook():
    """With a lever the damper moves less and gives more force; the dashpot to the sky stays the same for the masses."""
    law, current = LAWS["skyhook"], {}
    for ratio in (1.0, 0.5):
        system = QuarterCar(lever_ratio=ratio).linear()
        signals = np.array([1 / RATE, 0.0, 0.1, 0.0, 0.0, 0.1 * ratio, 0.0, ratio, *np.zeros(4)])
        parameters = law.vector({"skyhook_viscous": 4000.0}, system, 1 / RATE)
        current[ratio] = law.kernel(parameters, np.zeros(0), signals, TABLE)
        damper = BOUC_WEN.model.at_current(BOUC_WEN.theta, current[ratio])
        on_masses = ratio * (damper["yield_force"] + damper["viscous"] * 0.1 * ratio)
        assert on_masses == pytest.approx(400.0, rel=0.01)
    assert current[0.5] > current[1.0]
