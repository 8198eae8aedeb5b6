"""The advised experiment tells rivals apart, better than any other; where none does, a sensor is advised."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_diagnosis.diagnose import _advice as next_advice
from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.experiment_design.candidates import library
from mrd_diagnosis.experiment_design.separation import ALLOWED_ERROR, BENCH, Foreseen, Separation, _Rival, advise, sensor
from mrd_diagnosis.model_comparison import ModelComparison
from mrd_diagnosis.noise_model import run_noise
from mrd_diagnosis.refit import Refit, RunScatter, refit
from mrd_diagnosis.weighting import Weighting
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import Experiment, format_experiment, parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.waveforms.constant import Constant
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine

BASE = {
    "yield_force": 80.0,
    "yield_force_per_A": 900.0,
    "yield_travel": 1.25e-4,
    "viscous": 900.0,
    "viscous_per_A": 2500.0,
    "stiffness": 1500.0,
    "offset": -45.0,
    "coil_lag": 0.0,
}


def sines(*of, current=None):
    """Plans of plain sines, (m, Hz) each."""
    coil = current or Constant(0.2)
    experiments = [Experiment(f"sine{i}", 6.0, 500.0, Sine(a, f), coil) for i, (a, f) in enumerate(of)]
    return [plan(experiment, BENCH.limits, BENCH.force_envelope) for experiment in experiments]


def damper(effect, **sizes):
    effects = {effect: dict(EFFECTS[effect].typical) | sizes} if effect else {}
    return Damper("bouc_wen", BASE, None, effects)


def fitted(plans, truth, rivals) -> tuple[Weighting, dict[str, Refit]]:
    """What recordings of a damper make of rivals."""
    random = np.random.default_rng(0)
    recordings = [prepare_recording(run) for run in measure_plans(plans, truth, random)]
    noises = run_noise(recordings, truth.model, truth.theta, random)
    weighting = Weighting(recordings, noises, RunScatter(0.01, 2.0), {"coil_lag": 0.0})

    def fit(weighting, rival, start):
        model = find_model("bouc_wen", None, [rival] if rival else [])
        if start is None:
            typical = {f"{rival}.{p}": v for p, v in EFFECTS[rival].typical.items()} if rival else {}
            start = model.vector(BASE | typical)
        return refit(weighting.problem(model, start), start, weighting.folds)

    found = {rival: fit(weighting, rival, None) for rival in rivals}
    best = min(found.values(), key=lambda of: of.cost.sum())
    weighting = weighting.updated(best.problem.model, best.theta)
    return weighting, {rival: fit(weighting, rival, of.theta) for rival, of in found.items()}


def evidence(weighting, found, true, other):
    """Twice the log-likelihood ratio."""
    return (found[other].cost.sum() - found[true].cost.sum()) / weighting.correlation_length


PLAIN = sines((8e-3, 1.0), (4e-3, 1.0))
CASES = {
    "delay": ("force_sensor_lag", damper("channel_delay", delay=0.002), PLAIN),
    "lag": ("channel_delay", damper("force_sensor_lag", lag=0.002), PLAIN),
    "compliance": ("channel_delay", damper("series_compliance"), PLAIN),
    "thinning": ("seal_friction", damper("shear_thinning"), PLAIN),
    "spring": ("lvdt_nonlinearity", damper("gas_spring"), sines((15e-3, 0.3), (10e-3, 0.5))),
    "mass": ("channel_delay", damper("moving_mass"), PLAIN),
}


@pytest.fixture(scope="module")
def alike():
    """Runs on which a delay and a lag look the same."""
    other, truth, plans = CASES["delay"]
    return fitted(plans, truth, ["channel_delay", other])


def planned_of(advice: Advice):
    return plan(parse_experiment(advice.experiment, "advice"), BENCH.limits, BENCH.force_envelope)


def test_the_library_keeps_within_the_limits_and_names_each_experiment():
    plans = library(BENCH)
    names = [planned.experiment.name for planned in plans]
    assert 15 <= len(plans) == len(set(names)) <= 30
    for planned in plans:
        assert all(peak.value <= peak.limit * (1 + 1e-6) for peak in planned.peaks[:4]), planned.experiment.name
        assert planned.peaks[-1].value <= BENCH.limits.force
        again = planned_of(Advice("", format_experiment(planned.experiment)))
        np.testing.assert_allclose(again.at(again.times()), planned.at(planned.times()), atol=1e-9)
        assert planned.experiment.description


@pytest.mark.slow
def test_another_bench_gets_smaller_experiments():
    limits = replace(BENCH.limits, stroke=0.03, force=400.0, speed=0.1)
    plans = library(replace(BENCH, limits=limits))
    assert len(plans) >= 15
    assert all(planned.peaks[0].value <= limits.reach * 1e3 * (1 + 1e-6) for planned in plans)
    assert all(planned.peaks[-1].value <= 400.0 for planned in plans)


def test_an_advised_experiment_tells_a_delay_from_a_lag(alike):
    weighting, found = alike
    before = abs(evidence(weighting, found, "channel_delay", "force_sensor_lag"))
    shares = []
    advice = advise(found, weighting, progress=shares.append)
    assert advice.between == ("channel_delay", "force_sensor_lag")
    assert advice.error_rate < ALLOWED_ERROR
    assert "delay of the force channel and lag of the force sensor apart" in advice.text
    assert shares[-1] == pytest.approx(1.0)
    _, truth, plans = CASES["delay"]
    after = fitted([*plans, planned_of(advice)], truth, found)
    assert evidence(*after, "channel_delay", "force_sensor_lag") > 20 * before
    assert advise(found, weighting) == advice


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_it_does_so_for_others_too_and_better_than_a_random_one():
    random, won = np.random.default_rng(1), []
    for other, truth, plans in CASES.values():
        true = truth.model.effects[0].id
        weighting, found = fitted(plans, truth, [true, other])
        advice = advise(found, weighting)
        assert advice.experiment, true
        before = evidence(weighting, found, true, other)
        drawn = [library(BENCH)[place] for place in random.choice(len(library(BENCH)), 3, replace=False)]
        gains = [
            evidence(*fitted([*plans, planned], truth, [true, other]), true, other) - before
            for planned in (planned_of(advice), *drawn)
        ]
        assert gains[0] > 20, (true, other)
        won.append(gains[0] > np.median(gains[1:]))
    assert sum(won) >= len(won) - 1, won


def test_a_run_must_tell_more_than_a_form_that_is_a_little_off():
    """A delay and a lag of a millisecond differ by far less than they close, and one more run would not change that."""
    plans = sines((8e-3, 1.0), (4e-3, 2.0), (8e-3, 2.0), (4e-3, 3.0))
    weighting, found = fitted(plans, damper("force_sensor_lag", lag=1.2e-3), ["force_sensor_lag", "channel_delay", ""])
    without = found.pop("")
    assert advise(found, weighting).experiment
    advice = advise(found, weighting, without=without)
    assert advice.experiment == ""
    assert "differ by less than either may err in its form" in advice.text
    assert "show all channels one event" in advice.text


def test_what_is_out_of_the_question_needs_no_experiment():
    """Nearly any run tells a spring from a mass, which answers nothing where a lag or a delay is the question."""
    plans = sines((8e-3, 1.0), (4e-3, 2.0), (8e-3, 2.0), (4e-3, 3.0))
    truth = damper("force_sensor_lag", lag=1.2e-3)
    weighting, rivals = fitted(plans, truth, ["force_sensor_lag", "channel_delay", "gas_spring", "moving_mass", ""])
    found = ModelComparison(
        weighting, rivals[""], (rivals["force_sensor_lag"],), ("force_sensor_lag",), {"force_sensor_lag": rivals}
    )
    chances = {"force_sensor_lag": 0.6, "channel_delay": 0.39, "gas_spring": 0.005, "moving_mass": 0.005, "": 0.0}
    advice = next_advice(found, {"force_sensor_lag": chances})
    assert advice.experiment == ""
    assert advice.between == ("force_sensor_lag", "channel_delay")


def test_what_no_run_tells_apart_needs_a_sensor():
    weighting, found = fitted(PLAIN[:1], damper("load_cell_gain"), ["load_cell_gain", ""])
    advice = advise(found, weighting)
    assert advice.experiment == ""
    assert np.isnan(advice.error_rate)
    assert "dead weights" in advice.text
    assert "gain of the load cell and the model without any effect" in advice.text


def test_one_explanation_needs_no_experiment(alike):
    weighting, found = alike
    assert advise({"channel_delay": found["channel_delay"]}, weighting) is None


def test_no_experiment_exceeds_the_force_that_a_rival_predicts(alike):
    weighting, found = alike
    foreseen = Foreseen.of(found, weighting, np.random.default_rng(0))
    planned = library(BENCH)[0]
    assert foreseen.separations(planned, 800.0, np.random.default_rng(0)) is not None
    assert foreseen.separations(planned, 100.0, np.random.default_rng(0)) is None


def test_at_one_current_nothing_is_taken_to_be_known_of_others():
    weighting, found = fitted(sines((8e-3, 1.0), current=Constant(0.0)), damper("channel_delay"), ["channel_delay"])
    known = found["channel_delay"]
    rival = _Rival.of(known, weighting.fixed)
    added = {p.name for p in rival.problem.parameters} - {p.name for p in known.problem.parameters}
    assert added == {"yield_force_per_A", "yield_travel_per_A", "viscous_per_A"}
    theta = rival.problem.theta(rival.unit)
    assert theta[rival.problem.model.names.index("yield_force_per_A")] > 100.0
    # The runs so far are explained, but for the noise that the current now brings in, and hold no slope over current.
    assert np.sum(rival.problem.residuals(theta) ** 2) < 2 * known.cost.sum()
    slope = [p.name for p in rival.problem.parameters].index("yield_force_per_A")
    assert np.linalg.norm(rival.root[:, slope]) < 0.05 * np.linalg.norm(rival.root, axis=0).max()


def test_what_outlasts_a_run_goes_on_in_the_next_one():
    plans = sines((8e-3, 1.0), (8e-3, 2.0), current=Prbs(0.0, 0.3, 0.1, 8))
    weighting, found = fitted(plans, damper("thermal_fade"), ["thermal_fade"])
    rival = _Rival.of(found["thermal_fade"], weighting.fixed)
    theta = rival.problem.theta(rival.unit)
    again = weighting.recordings[0]
    expected = consecutive_forces(rival.problem.model, theta, [*weighting.recordings, again])[-1]
    np.testing.assert_allclose(rival.force(theta, again.path)[again.counted], expected, rtol=1e-12)
    assert np.abs(expected - again.modelled(rival.problem.model, theta)).max() > 0.1


def test_only_the_same_damper_with_more_effects_contains_another():
    def of(model, *effects):
        return _Rival(SimpleNamespace(model=find_model(model, effects=effects)), np.zeros(0), np.zeros((0, 0)), 0.0)

    delayed = of("bouc_wen", "channel_delay")
    assert of("bouc_wen").within(delayed)
    assert not delayed.within(of("bouc_wen"))
    assert not of("modified_dahl").within(delayed)


def test_error_rates_fall_from_a_half():
    assert Separation(0.0).error_rate == 0.5
    assert Separation(4 * 1.6449**2).error_rate == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_has_a_sensor_that_shows_it(effect):
    assert len(sensor({effect}, ())) > 30
    assert sensor({"a user's own", effect}, {"a user's own"}) == sensor((), {effect})


def test_an_effect_without_a_sensor_of_its_own_is_told_by_its_stage():
    text = sensor({"moving_mass"}, {"magnetic_hysteresis"})
    assert "flux" in text
    assert EFFECTS["magnetic_hysteresis"].separated_by in text
