"""The advised experiment tells explanations apart, better than any other; where none does, a sensor is advised."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.diagnosis import Advice
from mrd_diagnosis.experiment_design import advice as advice_module
from mrd_diagnosis.experiment_design.advice import advise, sensor
from mrd_diagnosis.experiment_design.experiment_library import library
from mrd_diagnosis.experiment_design.open_explanations import advise_next
from mrd_diagnosis.experiment_design.prediction import RivalModel
from mrd_diagnosis.experiment_design.separation import Predictor, Separation
from mrd_diagnosis.fitting.refit import Refit, refit
from mrd_diagnosis.fitting.weighting import RunScatter, Weighting
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.models import find_model
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import Experiment, format_experiment, parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import GeneratorSettings
from mrd_trajectory.waveforms.constant import Constant
from mrd_trajectory.waveforms.prbs import Prbs
from mrd_trajectory.waveforms.sine import Sine

BENCH = GeneratorSettings()
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


def sines(*lines, current=None):
    """Return plans of plain sines, (m, Hz) each."""
    coil = current or Constant(0.2)
    experiments = [Experiment(f"sine{i}", 6.0, 500.0, Sine(a, f), coil) for i, (a, f) in enumerate(lines)]
    return [plan(experiment, BENCH.limits, BENCH.force_envelope) for experiment in experiments]


def damper(effect, **sizes):
    effects = {effect: dict(EFFECTS[effect].typical) | sizes} if effect else {}
    return Damper("bouc_wen", BASE, None, effects)


def fitted(plans, truth, explanations) -> tuple[Weighting, dict[str, Refit]]:
    """Return the weighting of recordings of a damper, and explanations refitted to them."""
    random = np.random.default_rng(0)
    recordings = [prepare_recording(run) for run in measure_plans(plans, truth, random)]
    noise = estimate_noise(recordings, truth.model, truth.theta, random)
    weighting = Weighting(recordings, noise, RunScatter(0.01, 2.0), {"coil_lag": 0.0})

    def fit(weighting, effect, start):
        model = find_model("bouc_wen", None, [effect] if effect else [])
        if start is None:
            typical = {f"{effect}.{p}": v for p, v in EFFECTS[effect].typical.items()} if effect else {}
            start = model.vector(BASE | typical)
        return refit(weighting.problem(model, start), start, weighting.folds)

    refits = {effect: fit(weighting, effect, None) for effect in explanations}
    best = min(refits.values(), key=lambda fitted_model: fitted_model.fold_costs.sum())
    weighting = weighting.updated(best.problem.model, best.theta)
    return weighting, {effect: fit(weighting, effect, before.theta) for effect, before in refits.items()}


def evidence(weighting, refits, true, other):
    """Return twice the log-likelihood ratio."""
    return (refits[other].fold_costs.sum() - refits[true].fold_costs.sum()) / weighting.error_correlation


PLAIN = sines((8e-3, 1.0), (4e-3, 1.0))
DAMPERS = {
    "delay": ("force_sensor_lag", damper("channel_delay", delay=0.002), PLAIN),
    "lag": ("channel_delay", damper("force_sensor_lag", lag=0.002), PLAIN),
    "compliance": ("channel_delay", damper("series_compliance"), PLAIN),
    "thinning": ("seal_friction", damper("shear_thinning"), PLAIN),
    "spring": ("lvdt_nonlinearity", damper("gas_spring"), sines((15e-3, 0.3), (10e-3, 0.5))),
    "mass": ("channel_delay", damper("moving_mass"), PLAIN),
}


@pytest.fixture(scope="module")
def alike():
    """Refits to runs on which a delay and a lag look the same."""
    other, truth, plans = DAMPERS["delay"]
    return fitted(plans, truth, ["channel_delay", other])


def explanation_of(comparison: ModelComparison, probabilities: dict[str, float]) -> Explanation:
    """Return an ambiguous explanation by the one effect of a comparison."""
    (effect,) = comparison.effects
    return Explanation("ambiguous", comparison, {effect: probabilities}, {effect: 0.001})


def plan_of(advice: Advice):
    return plan(parse_experiment(advice.experiment, "advice"), BENCH.limits, BENCH.force_envelope)


@pytest.fixture(scope="module")
def experiments():
    return library(BENCH)


@pytest.fixture(autouse=True)
def planned_once(experiments, monkeypatch):
    """Plan the library of the shipped bench once for all tests."""
    monkeypatch.setattr(
        advice_module, "library", lambda bench, sizes: experiments if bench == BENCH else library(bench, sizes)
    )


def test_the_library_keeps_within_the_limits_and_names_each_experiment(experiments):
    plans = experiments
    names = [planned.experiment.name for planned in plans]
    assert 15 <= len(plans) == len(set(names)) <= 30
    for planned in plans:
        assert all(peak.value <= peak.limit * (1 + 1e-6) for peak in planned.peaks[:4]), planned.experiment.name
        assert planned.peaks[-1].value <= BENCH.limits.force
        again = plan_of(Advice("", format_experiment(planned.experiment)))
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
    weighting, refits = alike
    before = abs(evidence(weighting, refits, "channel_delay", "force_sensor_lag"))
    fractions = []
    advice = advise(refits, weighting, progress=fractions.append)
    assert advice.between == ("channel_delay", "force_sensor_lag")
    assert advice.error_rate < THRESHOLDS.wrong_choices
    assert "between delay of the force channel and lag of the force sensor;" in advice.text
    assert fractions[-1] == pytest.approx(1.0)
    _, truth, plans = DAMPERS["delay"]
    after = fitted([*plans, plan_of(advice)], truth, refits)
    assert evidence(*after, "channel_delay", "force_sensor_lag") > 20 * before
    assert advise(refits, weighting) == advice


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_advice_is_better_than_a_random_experiment_for_other_pairs_too(experiments):
    random, won = np.random.default_rng(1), []
    for other, truth, plans in DAMPERS.values():
        true = truth.model.effects[0].id
        weighting, refits = fitted(plans, truth, [true, other])
        advice = advise(refits, weighting)
        assert advice.experiment, true
        before = evidence(weighting, refits, true, other)
        drawn = [experiments[place] for place in random.choice(len(experiments), 3, replace=False)]
        gains = [
            evidence(*fitted([*plans, planned], truth, [true, other]), true, other) - before
            for planned in (plan_of(advice), *drawn)
        ]
        assert gains[0] > 20, (true, other)
        won.append(gains[0] > np.median(gains[1:]))
    assert sum(won) >= len(won) - 1, won


def test_a_run_must_separate_by_more_than_the_error_of_a_formula():
    """A delay and a lag of a millisecond differ by far less than they close, and one more run would not change that."""
    plans = sines((8e-3, 1.0), (4e-3, 2.0), (8e-3, 2.0), (4e-3, 3.0))
    weighting, refits = fitted(plans, damper("force_sensor_lag", lag=1.2e-3), ["force_sensor_lag", "channel_delay", ""])
    without = refits.pop("")
    assert advise(refits, weighting).experiment
    advice = advise(refits, weighting, without=without)
    assert advice.experiment == ""
    assert "differ by less than the error of either formula" in advice.text
    assert "give the rod one sharp blow" in advice.text


def test_unlikely_explanations_need_no_experiment():
    """Nearly any run tells a spring from a mass; that does not help where a lag and a delay are likely."""
    plans = sines((8e-3, 1.0), (4e-3, 2.0), (8e-3, 2.0), (4e-3, 3.0))
    truth = damper("force_sensor_lag", lag=1.2e-3)
    weighting, refits = fitted(plans, truth, ["force_sensor_lag", "channel_delay", "gas_spring", "moving_mass", ""])
    comparison = ModelComparison(
        weighting, refits[""], (refits["force_sensor_lag"],), ("force_sensor_lag",), {"force_sensor_lag": refits}
    )
    probabilities = {"force_sensor_lag": 0.6, "channel_delay": 0.39, "gas_spring": 0.005, "moving_mass": 0.005, "": 0.0}
    advice = advise_next(explanation_of(comparison, probabilities), {}, (), np.random.default_rng(0))
    assert advice.experiment == ""
    assert advice.between == ("force_sensor_lag", "channel_delay")


def test_explanations_that_no_run_tells_apart_need_a_sensor():
    weighting, refits = fitted(PLAIN[:1], damper("load_cell_gain"), ["load_cell_gain", ""])
    advice = advise(refits, weighting)
    assert advice.experiment == ""
    assert np.isnan(advice.error_rate)
    assert "dead weights" in advice.text
    assert re.search(r"gain of the load cell and no effect (differ|would still be wrong)", advice.text)


def test_one_explanation_needs_no_experiment(alike):
    weighting, refits = alike
    assert advise({"channel_delay": refits["channel_delay"]}, weighting) is None


def test_no_experiment_exceeds_the_force_that_an_explanation_predicts(alike, experiments):
    weighting, refits = alike
    predictor = Predictor.from_refits(refits, weighting, np.random.default_rng(0))
    assert predictor.separations(experiments[0], 800.0, np.random.default_rng(0)) is not None
    assert predictor.separations(experiments[0], 100.0, np.random.default_rng(0)) is None


def test_advice_keeps_within_the_limits_of_the_users_bench(alike, experiments, monkeypatch):
    weighting, refits = alike
    weak = replace(BENCH, limits=replace(BENCH.limits, force=100.0))
    benches = []
    monkeypatch.setattr(advice_module, "library", lambda bench, _sizes: benches.append(bench) or experiments[:2])
    alternatives = {"channel_delay": refits | {"": refits["force_sensor_lag"]}}
    comparison = ModelComparison(
        weighting, refits["force_sensor_lag"], (refits["channel_delay"],), ("channel_delay",), alternatives
    )
    probabilities = {"channel_delay": 0.5, "force_sensor_lag": 0.5}
    advice = advise_next(explanation_of(comparison, probabilities), {}, (), np.random.default_rng(0), weak)
    assert benches == [weak]
    assert advice.experiment == ""
    assert "No experiment that can be advised is safe: each would exceed 100 N" in advice.text
    monkeypatch.setattr(advice_module, "library", lambda *_: PLAIN)
    assert advise(refits, weighting).text.startswith("Every experiment that fits this bench is recorded already.")


def test_runs_at_one_current_leave_the_slopes_over_current_open():
    weighting, refits = fitted(sines((8e-3, 1.0), current=Constant(0.0)), damper("channel_delay"), ["channel_delay"])
    known = refits["channel_delay"]
    explanation = RivalModel.from_refit(known, weighting.fixed)
    added = {p.name for p in explanation.problem.parameters} - {p.name for p in known.problem.parameters}
    assert added == {"yield_force_per_A", "yield_travel_per_A", "viscous_per_A"}
    theta = explanation.problem.theta(explanation.unit)
    assert theta[explanation.problem.model.names.index("yield_force_per_A")] > 100.0
    # The runs are explained apart from the noise of the current, and hold no information on the slopes over the current.
    assert np.sum(explanation.problem.residuals(theta) ** 2) < 2 * known.fold_costs.sum()
    slope = [p.name for p in explanation.problem.parameters].index("yield_force_per_A")
    assert np.linalg.norm(explanation.root[:, slope]) < 0.05 * np.linalg.norm(explanation.root, axis=0).max()


def test_a_state_that_outlasts_a_run_is_carried_into_the_next_one():
    plans = sines((8e-3, 1.0), (8e-3, 2.0), current=Prbs(0.0, 0.3, 0.1, 8))
    weighting, refits = fitted(plans, damper("thermal_fade"), ["thermal_fade"])
    explanation = RivalModel.from_refit(refits["thermal_fade"], weighting.fixed)
    theta = explanation.problem.theta(explanation.unit)
    again = weighting.recordings[0]
    expected = consecutive_forces(explanation.problem.model, theta, [*weighting.recordings, again])[-1]
    np.testing.assert_allclose(explanation.force(theta, again.path)[again.counted], expected, rtol=1e-12)
    assert np.abs(expected - again.modelled(explanation.problem.model, theta)).max() > 0.1


def test_only_the_same_damper_with_more_effects_contains_another(alike):
    weighting, refits = alike
    delayed = RivalModel.from_refit(refits["channel_delay"], weighting.fixed)

    def without_effects(name):
        return replace(delayed, problem=replace(delayed.problem, model=find_model(name)))

    assert without_effects("bouc_wen").is_nested_in(delayed)
    assert not delayed.is_nested_in(without_effects("bouc_wen"))
    assert not without_effects("modified_dahl").is_nested_in(delayed)


def test_error_rates_fall_from_a_half():
    assert Separation(0.0).error_rate == 0.5
    assert Separation(4 * 1.6449**2).error_rate == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize("effect", EFFECTS)
def test_every_effect_has_a_sensor(effect):
    assert len(sensor({effect}, ())) > 30
    assert sensor({"a user's own", effect}, {"a user's own"}) == sensor((), {effect})


def test_an_effect_without_its_own_sensor_is_advised_by_its_stage():
    text = sensor({"moving_mass"}, {"magnetic_hysteresis"})
    assert "flux" in text
    assert EFFECTS["magnetic_hysteresis"].separated_by in text


def test_an_experiment_that_leaves_a_pair_open_says_so_in_the_same_sentence(alike):
    weighting, _ = alike
    decided, left_open = Separation(60.0), Separation(1e-3)
    separations = {
        ("end_stop", "backlash"): decided,
        ("end_stop", "joint_play"): decided,
        ("backlash", "joint_play"): left_open,
    }
    advice = advice_module._advise_experiment(*sines((5e-3, 1.0)), separations, weighting)
    assert (
        "It decides between end stop, backlash of the drive and play in a joint, but not between backlash of the drive "
        "and play in a joint; after it, such a choice would be wrong in "
    ) in advice.text
