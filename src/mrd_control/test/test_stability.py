"""The delay margin of a hybrid loop, against a solution in closed form and against the loop itself."""

import numpy as np
import pytest

from mrd_base import InputError
from mrd_control.controller import Actuator
from mrd_control.excitations import Bump
from mrd_control.laws import LAWS
from mrd_control.loop import run_loop
from mrd_control.stability import check_stability, describing_function, stability_margin, trembling_amplitude
from mrd_control.systems import QuarterCar, SingleMass
from mrd_sim.damper import Damper

RATE = 1000.0


def viscous(value):
    return Damper("linear_viscous", {"viscous": value, "viscous_per_A": 0.0, "coil_lag": 0.0})


@pytest.mark.parametrize("damping", [500.0, 2000.0, 8000.0])
def test_the_margin_of_one_mass_is_that_of_the_closed_form(damping):
    """m s² + k + c s exp(-s T) = 0 has its first root on the imaginary axis at w T = pi/2, m w² - c w - k = 0."""
    mass, spring, rate = 250.0, 20e3, 20e3
    w = (damping + np.sqrt(damping**2 + 4 * mass * spring)) / (2 * mass)
    margin = stability_margin(SingleMass(mass, spring).linear(), viscous(damping), Actuator(0.0), rate, [0.0])
    # Holding the force costs half a period.
    assert margin.delay + 0.5 / rate == pytest.approx(np.pi / 2 / w, rel=0.015)
    assert 2 * np.pi * margin.frequency == pytest.approx(w, rel=0.01)


@pytest.mark.parametrize(
    "actuator", [Actuator(0.0), Actuator(0.0, 0.004), Actuator(0.0, 0.0, "polynomial")], ids=["none", "lag", "polynomial"]
)
@pytest.mark.parametrize("system", [QuarterCar(), SingleMass(80.0, 30e3)], ids=["car", "mass"])
def test_a_loop_decays_below_its_margin_and_grows_above_it(actuator, system):
    linear, damper = system.linear(), viscous(1500.0)
    margin = stability_margin(linear, damper, actuator, RATE, [0.0])
    base = Bump(height=0.005, length=5.0).base(20_000, RATE)
    for factor in (0.96, 1.04):
        changed = Actuator(margin.delay * factor - actuator.lag, actuator.lag, actuator.predictor)
        result = run_loop(linear, damper, LAWS["constant_current"], base, RATE, actuator=changed)
        grew = result.diverged or np.abs(result.travel[-500:]).max() > np.abs(result.travel[3000:5000]).max()
        assert grew == (factor > 1)


@pytest.mark.parametrize("predictor", ["none", "polynomial"])
def test_a_wrong_delay_is_borne_as_far_as_the_check_says(car, predictor):
    """The predictor stays prepared for 3 ms, whatever the delay is."""
    damper, declared = viscous(1500.0), Actuator(0.003, 0.0, predictor)
    margin = check_stability(car, damper, declared, RATE, [0.0])
    assert margin.least == 0.0
    assert margin.most > 0.003
    base = Bump(height=0.005, length=5.0).base(20_000, RATE)
    for factor in (0.96, 1.04):
        wrong = Actuator(margin.most * factor, 0.0, predictor, ahead=0.003)
        result = run_loop(car, damper, LAWS["constant_current"], base, RATE, actuator=wrong)
        grew = result.diverged or np.abs(result.travel[-500:]).max() > np.abs(result.travel[3000:5000]).max()
        assert grew == (factor > 1)
    assert f"from 0 to {1e3 * margin.most:.3g} ms" in margin.describe(0.003)


def test_the_describing_function_of_a_linear_damper_is_itself():
    stiffness, coefficient = describing_function(viscous(1234.0), 2e-3, 0.0)
    np.testing.assert_allclose(coefficient, 1234.0, rtol=1e-3)
    np.testing.assert_allclose(stiffness, 0.0, atol=1.0)


def test_the_describing_function_of_friction_is_the_known_one():
    """Coulomb friction: c = 4 F / (pi w A)."""
    damper = Damper("bingham", {"yield_force": 100.0, "yield_force_per_A": 0.0, "viscous": 0.0, "creep_speed": 5e-4})
    _, coefficient = describing_function(damper, 5e-3, 0.0)
    w = 2 * np.pi * 400.0
    assert coefficient[-1] == pytest.approx(4 * 100.0 / (np.pi * w * 5e-3), rel=0.02)


def test_a_yielding_damper_is_unstable_at_small_amplitudes_only(bouc_wen):
    """Below the trembling amplitude the loop grows until there, above it decays to there."""
    car, actuator = QuarterCar(320.0, 80.0).linear(), Actuator(0.003)
    amplitude = trembling_amplitude(car, bouc_wen, actuator, RATE, [0.0])
    assert 1e-5 < amplitude < 2e-3
    result = run_loop(car, bouc_wen, LAWS["constant_current"], Bump(height=0.02).base(20_000, RATE), RATE, actuator=actuator)
    rest = result.rod[-5000:] - result.rod[-5000:].mean()
    assert 0.3 * amplitude < np.abs(rest).max() < 3 * amplitude


def test_an_unstable_set_up_is_refused_with_what_would_make_it_stable(car, bouc_wen):
    with pytest.raises(
        InputError, match=r"at 1 A it is stable up to a delay of ([\d.]+) ms and has 20 ms .* or ([\d.]+) times the masses"
    ) as refused:
        check_stability(car, bouc_wen, Actuator(0.02), RATE, [0.0, 0.5, 1.0])
    assert "\n" not in str(refused.value)
    words = str(refused.value).split()
    bears, factor = float(words[words.index("up") + 5]), float(words[words.index("times") - 1])
    # What it says is true.
    assert check_stability(car, bouc_wen, Actuator(0.98e-3 * bears), RATE, [0.0, 0.5, 1.0]).delay > 0.98e-3 * bears
    heavier = QuarterCar(320.0 * factor, 40.0 * factor).linear()
    assert check_stability(heavier, bouc_wen, Actuator(0.02), RATE, [0.0, 0.5, 1.0]).delay > 0.02
