"""Diagnoses of simulated dampers whose effect is known."""

import re
import sys
from dataclasses import replace
from textwrap import dedent
from types import SimpleNamespace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis import diagnose
from mrd_diagnosis.cli import diagnose as diagnose_tool
from mrd_diagnosis.decision import verdict as rules_of_verdict
from mrd_diagnosis.decision.rejection_rules import RULES
from mrd_diagnosis.diagnosis import UNDETERMINED, Interval
from mrd_diagnosis.fitting.base_fit import LinearisedRefit, fit_base
from mrd_diagnosis.fitting.refit import refit_on
from mrd_diagnosis.search.effect_search import refit_with_effects, score_effects
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_identification.fit_file import StoredFit
from mrd_identification.low_pass import parse_low_pass, with_force_filter
from mrd_identification.recording import prepare_recording
from mrd_sim.damper import Damper
from mrd_sim.models import find_model
from mrd_sim.simulate import Instruments, measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

EXPERIMENTS = {
    "multisine": """
        rod: {waveform: multisine, amplitude_mm: 14, lowest_hz: 0.3, highest_hz: 6, period_s: 10, rolloff: 1.2, seed: 0}
        coil: {waveform: aprbs, low_mA: 0, high_mA: 300, shortest_s: 0.05, longest_s: 0.3, count: 8, seed: 1}""",
    "triangle": """
        rod: {waveform: triangle, amplitude_mm: 12, slope_mm_per_s: 40}
        coil: {waveform: staircase, levels_mA: [0, 200, 400, 200], hold_s: 0.7}""",
    "sine": """
        rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 3}
        coil: {waveform: prbs, low_mA: 50, high_mA: 300, bit_s: 0.1, order: 7, seed: 2}""",
    "slow": """
        rod: {waveform: sine, amplitude_mm: 20, frequency_hz: 0.25}
        coil: {waveform: constant, level_mA: 150}""",
}
DAMPER = {
    "yield_force": 60.0,
    "yield_force_per_A": 800.0,
    "yield_travel": 1.5e-4,
    "viscous": 800.0,
    "viscous_per_A": 1500.0,
    "stiffness": 1000.0,
    "offset": -40.0,
    "coil_lag": 0.0,
}


def cut(run, first, last):
    """Return the part of a run between two times in s."""
    part = (run.time >= first) & (run.time <= last)
    series = {n: getattr(run, n)[part] for n in ("position", "velocity", "current", "force", "acceleration")}
    return replace(run, time=run.time[part] - run.time[part][0], **series)


FEW = ("coil_lag", "gas_spring", "moving_mass", "force_sensor_lag", "channel_delay")


def recorded(effects=None, model="bouc_wen", seed=0, rate=250, instruments=None, only=EXPERIMENTS, **values):
    """Return runs of a damper; ``only`` names experiments, or maps further names to experiments."""
    settings = read_settings(None)
    texts = EXPERIMENTS | (only if isinstance(only, dict) else {})
    plans = [
        plan(
            parse_experiment(f"name: {name}\nduration_s: 8\nrate_hz: {rate}\n{dedent(texts[name])}", name),
            settings.limits,
            settings.force_envelope,
        )
        for name in only
    ]
    own = {name: value for name, value in DAMPER.items() if name in find_model(model).names}
    damper = Damper(model, own | values, effects=effects)
    return measure_plans(plans, damper, np.random.default_rng(seed), instruments=instruments)


@pytest.fixture(scope="module")
def delayed():
    return recorded({"channel_delay": {"delay": 0.012}})


@pytest.fixture(scope="module")
def explained(delayed):
    return diagnose(delayed, "bouc_wen", effects=FEW)


def test_the_effect_is_named_with_its_size_and_what_it_closes(explained):
    assert (explained.verdict, [cause.effect for cause in explained.causes]) == ("explained", ["channel_delay"])
    (cause,) = explained.causes
    diagnosis = cause.parameters["channel_delay.delay"].value
    assert diagnosis.value == pytest.approx(0.012, abs=3e-4)
    assert 0.0 < diagnosis.upper - diagnosis.lower < 0.001
    assert cause.probability > 0.95
    assert cause.p_value < 0.01
    assert explained.gap.closed_fraction.value > 0.97
    assert explained.gap.closed_fraction.lower > 0.9
    assert (
        explained.gap.noise_floor.value
        < explained.gap.after.value
        < 1.3 * explained.gap.noise_floor.value
        < explained.gap.before.value
    )
    assert explained.sentence.startswith("The force channel is late by 1")
    assert explained.corrected.parameters["channel_delay.delay"] == diagnosis.value
    assert explained.held_out_by == "leave-one-run-out"


def test_every_effect_that_was_tried_is_named_or_rejected(explained):
    named, rejected = ([entry.effect for entry in entries] for entries in (explained.causes, explained.rejected))
    tried = [candidate.effects[0] for candidate in explained.candidates if len(candidate.effects) == 1]
    assert sorted(named + rejected) == sorted(tried)
    assert {entry.rule for entry in explained.rejected} <= {rule.id for rule in RULES}


def test_the_gap_is_located(explained):
    assert explained.where
    assert explained.where[0].q_value < 0.05
    assert explained.where[0].lift > 1


def test_the_same_seed_gives_the_same_answer(delayed, explained):
    again = diagnose(delayed, "bouc_wen", effects=FEW[::-1])
    assert again.sentence == explained.sentence
    assert again.gap.closed_fraction == explained.gap.closed_fraction
    assert again.candidates == explained.candidates


def test_without_the_effect_in_the_catalogue_it_is_unknown(delayed):
    diagnosis = diagnose(delayed, "bouc_wen", effects=("gas_spring", "moving_mass"))
    assert diagnosis.verdict == "unknown_effect"
    assert not diagnosis.causes
    assert diagnosis.where
    assert diagnosis.sentence.startswith("Most of the gap")
    assert not any(entry.chosen for entry in diagnosis.rejected)
    # What stands in for the missing effect was weighed, and found unlikely.
    assert {entry.effect: entry.probability < 0.5 for entry in diagnosis.weighed} == {"moving_mass": True}
    assert "moving_mass" in {entry.effect for entry in diagnosis.rejected}
    assert {model.name for model in diagnosis.alternative_models} >= {"sigmoid", "bouc_wen with exponent fitted too"}


@pytest.fixture(scope="module")
def healthy():
    return diagnose(recorded(seed=1), "bouc_wen", effects=("cavitation", *FEW))


def test_without_an_effect_there_is_no_gap(healthy):
    assert (healthy.verdict, healthy.causes, healthy.corrected.effects) == ("no_gap", (), ())
    assert healthy.gap.before.value < 1.2 * healthy.gap.noise_floor.value
    smallest = {candidate.effects[0]: candidate.smallest_detectable for candidate in healthy.candidates}
    assert smallest["channel_delay"].endswith(("ms", "µs"))


def test_scatter_from_run_to_run_is_no_effect():
    noisy = recorded(seed=2, instruments=Instruments(run_gain=0.03, run_offset=6.0))
    diagnosis = diagnose(noisy, "bouc_wen")
    assert diagnosis.verdict == "no_gap"
    gains = np.array([residual.gain for residual in diagnosis.residuals])
    assert 0.005 < gains.std() < 0.08


def test_parameters_alone_can_be_the_answer():
    simulator = StoredFit("bouc_wen", {}, (), DAMPER | {"yield_force": 140.0, "viscous": 1500.0}, {})
    diagnosis = diagnose(recorded(seed=3), "bouc_wen", parameters=simulator, effects=FEW)
    assert diagnosis.verdict == "no_gap"
    assert diagnosis.gap.as_given > 5 * diagnosis.gap.before.value
    assert "parameters" in diagnosis.sentence


def test_a_lag_that_the_simulator_has_is_no_candidate():
    simulator = StoredFit("bouc_wen", {}, (), DAMPER | {"coil_lag": 0.004}, {})
    diagnosis = diagnose(recorded(seed=4, coil_lag=0.004), "bouc_wen", parameters=simulator, effects=FEW)
    assert diagnosis.verdict == "no_gap"
    assert "coil_lag" in {untestable.effect for untestable in diagnosis.untestable}


def test_a_model_without_hysteresis_lacks_it():
    runs = recorded(seed=5)
    diagnosis = diagnose(runs, "bingham", effects=("pre_yield_hysteresis", "channel_delay", "moving_mass"))
    assert "pre_yield_hysteresis" in {cause.effect for cause in diagnosis.causes}


def test_beside_an_unknown_effect_what_is_known_is_named():
    runs = recorded({"channel_delay": {"delay": 0.012}, "gas_spring": {"stiffness": 4000.0}})
    diagnosis = diagnose(runs, "bingham", effects=("pre_yield_hysteresis", "gas_spring"))
    assert diagnosis.verdict == "partly_explained"
    lacking, spring = diagnosis.causes
    assert (lacking.effect, spring.effect) == ("pre_yield_hysteresis", "gas_spring")
    assert spring.parameters["gas_spring.stiffness"].value.value == pytest.approx(4000.0, rel=0.3)
    assert set(diagnosis.corrected.effects) == {"pre_yield_hysteresis", "gas_spring"}
    assert 0.8 < diagnosis.gap.closed_fraction.value < 0.97


def test_one_run_is_held_out_by_folds(delayed):
    diagnosis = diagnose(delayed[:1], "bouc_wen", effects=FEW)
    assert diagnosis.held_out_by == "blocks"
    assert [cause.effect for cause in diagnosis.causes] == ["channel_delay"]
    assert any("Only one run" in note for note in diagnosis.notes)


def test_held_out_runs_judge(delayed):
    diagnosis = diagnose(delayed[:3], "bouc_wen", held_out=delayed[3:], effects=("channel_delay", "moving_mass"))
    assert diagnosis.held_out_by == "runs"
    assert [residual.held_out for residual in diagnosis.residuals] == [False, False, False, True]
    assert [cause.effect for cause in diagnosis.causes] == ["channel_delay"]
    assert diagnosis.gap.closed_fraction.value > 0.9


def test_a_fit_says_where_mid_stroke_is():
    runs = [replace(run, position=run.position + 0.022) for run in recorded(seed=3)]
    simulator = StoredFit("bouc_wen", {}, (), {**DAMPER, "mid_stroke": 0.022}, {})
    diagnosis = diagnose(runs, "bouc_wen", parameters=simulator, effects=("moving_mass",))
    assert (diagnosis.verdict, diagnosis.corrected.parameters["mid_stroke"]) == ("no_gap", 0.022)


@pytest.mark.parametrize("zero", [0.016, *(pytest.param(zero, marks=pytest.mark.slow) for zero in (0.0, -0.3))])
def test_a_stop_at_one_end_is_named_wherever_the_zero_of_the_position_is(zero):
    """One that was symmetric about the zero was named at two ends, or at none."""
    stopped = recorded({"end_stop": {"stiffness": 2e7, "upper": 0.007, "lower": -0.03, "exponent": 2.0}}, seed=5)
    runs = [replace(run, position=run.position + zero) for run in stopped]
    diagnosis = diagnose(runs, "bouc_wen", effects=("end_stop", "hardening_spring", "moving_mass"))
    (cause,) = diagnosis.causes
    mid_stroke = diagnosis.corrected.parameters["mid_stroke"]
    # Where the zero is at mid-stroke, or was found there, a spring that hardens from the other end looks like it.
    assert diagnosis.verdict == ("explained" if zero > 0.0 else "ambiguous")
    assert cause.effect == "end_stop"
    assert mid_stroke == (0.0 if zero > -0.1 else pytest.approx(zero, abs=1e-3))
    assert cause.parameters["end_stop.upper"].value.value == pytest.approx(0.007 + zero - mid_stroke, abs=1e-4)
    assert cause.parameters["end_stop.lower"].remark == UNDETERMINED


def test_an_odd_multisine_tells_noise_from_distortion():
    odd = """
        rod: {waveform: multisine, amplitude_mm: 8, lowest_hz: 0.5, highest_hz: 4, period_s: 2, rolloff: 1, seed: 0}
        coil: {waveform: constant, level_mA: 200}"""
    (run,) = recorded(seed=11, only={"odd": odd})
    body = cut(run, run.duration - 7.5, run.duration - 1.2)
    diagnosis = diagnose([body], "bouc_wen", effects=("moving_mass",))
    assert any("odd harmonics only" in note and "at even harmonics" in note for note in diagnosis.notes)


def test_faulty_recordings_stop_the_diagnosis(delayed):
    dead = replace(delayed[0], name="dead", force=np.full(len(delayed[0]), 3.0))
    diagnosis = diagnose([*delayed[1:], dead], "bouc_wen")
    assert diagnosis.verdict == "data_fault"
    assert "dead" in diagnosis.sentence
    assert not diagnosis.candidates
    assert len(diagnosis.runs) == 4


def test_constant_currents_say_nothing_of_magnetics():
    for seed in range(4):
        runs = [cut(run, 1.5, run.duration - 1.5) for run in recorded(seed=20 + seed, only=["slow", "slow"])]
        diagnosis = diagnose(runs, "bouc_wen", effects=("magnetic_hysteresis", "coil_lag", "moving_mass", "channel_delay"))
        assert diagnosis.verdict == "no_gap", diagnosis.sentence
        assert {"magnetic_hysteresis", "coil_lag"} <= {untestable.effect for untestable in diagnosis.untestable}


def sines(model="bouc_wen", effects=None, **values):
    """One sine at three currents."""
    coil = "coil: {waveform: constant, level_mA: %g}"
    sine = "rod: {waveform: sine, amplitude_mm: 12, frequency_hz: 1}"
    only = {f"sine_{level}": f"{sine}\n{coil % level}" for level in (50, 150, 300)}
    return [cut(run, 1.5, run.duration - 1.5) for run in recorded(effects, model, seed=1, only=only, **values)]


@pytest.mark.parametrize(
    "model",
    [
        pytest.param("modified_dahl", marks=pytest.mark.slow),
        "modified_lugre",
        pytest.param("hyperbolic_tangent", marks=pytest.mark.slow),
    ],
)
def test_at_one_speed_another_damper_model_is_not_taken_for_an_effect(model):
    diagnosis = diagnose(sines(model), "bouc_wen", effects=("joint_play", "seal_friction", "shear_thinning"))
    assert (diagnosis.verdict, diagnosis.causes) == ("unknown_effect", ())
    assert diagnosis.alternative_models[0].closed_fraction.value > max(0.95, diagnosis.nearest.closed_fraction.value)
    assert f"The model {diagnosis.alternative_models[0].name} removes" in diagnosis.sentence


@pytest.mark.parametrize(
    ("closes", "left", "verdict"),
    [(0.7, 0.1, "explained"), (0.45, 0.1, "unknown_effect"), (0.7, 0.25, "unknown_effect"), (0.8, 0.25, "explained")],
)
def test_little_more_than_noise_needs_only_half_of_the_gap_to_be_closed(closes, left, verdict, monkeypatch):
    monkeypatch.setattr(rules_of_verdict, "closed_fraction_between", lambda *_, **__: Interval(closes, closes, closes))
    comparison = SimpleNamespace(
        best=SimpleNamespace(chi_square=1.0 + left, held_out_chi_squares=np.full(8, 100.0 * (1.0 + left))),
        base=SimpleNamespace(chi_square=2.0),
        effects=("moving_mass",),
        alternative_model="",
        weighting=SimpleNamespace(folds=[(0, slice(100 * n, 100 * n + 100)) for n in range(8)]),
    )
    probabilities = {"moving_mass": {"moving_mass": 1.0}}
    found = rules_of_verdict.verdict_on_gap(comparison, 2.0, probabilities, {"moving_mass": 0.001}, np.random.default_rng(0))
    assert found == verdict


def test_a_damper_model_that_predicts_worse_than_the_other_effects_alone_is_no_alternative():
    def with_cost(cost):
        return SimpleNamespace(held_out_cost=cost)

    alternatives = {
        "gas_spring": {"gas_spring": with_cost(1.0), "": with_cost(9.0)},
        "coil_lag": {"coil_lag": with_cost(1.0), "": with_cost(2.0)},
    }
    chain = (with_cost(9.0), with_cost(1.0))
    comparison = ModelComparison(None, with_cost(99.0), chain, tuple(alternatives), alternatives).with_alternative_models(
        {"dahl": with_cost(5.0), "lugre": with_cost(7.0)}
    )
    assert comparison.alternatives["gas_spring"][comparison.alternative_model].held_out_cost == 5.0
    assert comparison.alternatives["coil_lag"] == alternatives["coil_lag"]


def test_at_one_speed_an_effect_that_no_damper_model_imitates_is_named():
    diagnosis = diagnose(sines(effects={"joint_play": {"play": 3e-4}}), "bouc_wen", effects=("joint_play", "seal_friction"))
    assert (diagnosis.verdict, [cause.effect for cause in diagnosis.causes]) == ("explained", ["joint_play"])


def test_a_true_simulator_among_scattered_runs_is_no_gap_in_the_parameters():
    runs = recorded(seed=8, instruments=Instruments(run_gain=0.03, run_offset=8.0))
    diagnosis = diagnose(runs, "bouc_wen", parameters=StoredFit("bouc_wen", {}, (), DAMPER, {}), effects=FEW)
    assert diagnosis.gap.as_given < 1.3 * diagnosis.gap.before.value
    assert diagnosis.sentence.startswith("No gap")


@pytest.mark.parametrize("held_out", ["multisine", "slow"])
def test_the_error_as_given_and_the_one_before_are_of_the_same_runs(held_out):
    """Relative to its force, the noise of a slow run is larger than that of a fast one."""
    runs = recorded(seed=12)
    aside = [run for run in runs if run.name.endswith(held_out)]
    simulator = StoredFit("bouc_wen", {}, (), DAMPER, {})
    fitted = [run for run in runs if run not in aside]
    diagnosis = diagnose(fitted, "bouc_wen", held_out=aside, parameters=simulator, effects=("moving_mass",))
    assert diagnosis.gap.as_given == pytest.approx(diagnosis.gap.before.value, rel=0.15)
    assert diagnosis.sentence.startswith("No gap")


def test_a_second_cause_is_found_and_both_have_alternatives():
    runs = recorded({"coil_lag": {"lag": 0.002}, "moving_mass": {"mass": 4.0}}, seed=9)
    diagnosis = diagnose(runs, "bouc_wen", effects=FEW)
    assert {cause.effect for cause in diagnosis.causes} == {"coil_lag", "moving_mass"}
    assert all(cause.probability > 0.8 for cause in diagnosis.causes)
    likely = [cause.probability * cause.closed_fraction.value for cause in diagnosis.causes]
    assert likely == sorted(likely, reverse=True)


@pytest.mark.slow
def test_a_second_cause_is_found_within_the_tolerance_of_the_first_formula():
    runs = recorded({"channel_delay": {"delay": 0.006}, "moving_mass": {"mass": 5.0}}, seed=9)
    diagnosis = diagnose(runs, "bouc_wen", effects=FEW)
    assert [cause.effect for cause in diagnosis.causes] == ["channel_delay", "moving_mass"]
    sizes = diagnosis.causes[1].parameters["moving_mass.mass"].value
    assert sizes.value == pytest.approx(5.0, rel=0.1)
    assert diagnosis.causes[1].closed_fraction.value < 0.06


@pytest.mark.slow
def test_a_play_far_smaller_than_typical_scores_best_beside_a_lag():
    runs = recorded({"backlash": {"play": 7e-5}, "force_sensor_lag": {"lag": 0.0017}}, seed=3, rate=500)
    fit = fit_base(find_model("bouc_wen"), None, [prepare_recording(run) for run in runs], np.random.default_rng(0))
    (lagging,) = refit_with_effects(fit.weighting, LinearisedRefit.around(fit.weighting, fit.base), ["force_sensor_lag"], 1)
    weighting = fit.weighting.updated(lagging.refit.problem.model, lagging.refit.theta)
    base_fit = LinearisedRefit.around(weighting, refit_on(weighting, lagging.refit))
    of_play, *others = (score.gain for score in score_effects(weighting, base_fit, ["backlash", *FEW, "flow_asymmetry"]))
    assert of_play > 10 * max(others)


@pytest.mark.slow
def test_runs_that_were_set_aside_may_go_beyond_the_fitted():
    effect = {"channel_delay": {"delay": 0.012}}
    runs = recorded(effect, seed=10, only=["sine", "multisine", "slow", "slow"])
    diagnosis = diagnose(runs[:2], "bouc_wen", held_out=runs[2:], effects=("channel_delay", "moving_mass"))
    assert [residual.extrapolates for residual in diagnosis.residuals if residual.held_out] == ["stroke", "stroke"]
    assert diagnosis.gap.extrapolated is not None


def test_heat_goes_on_from_run_to_run():
    effect = {"thermal_fade": {"fade": 2e-4}}
    runs = recorded(effect, seed=6, only=["multisine", "sine", "triangle", "slow", "multisine"])
    diagnosis = diagnose(runs, "bouc_wen", effects=("thermal_fade", "gas_spring"))
    fade = next(candidate for candidate in diagnosis.candidates if candidate.effects == ("thermal_fade",))
    assert fade.parameters["thermal_fade.fade"].value.value == pytest.approx(2e-4, rel=0.2)


@pytest.mark.slow
def test_what_has_settled_is_stirred_once_also_in_runs_that_were_set_aside():
    effect = {"settling": {"excess": 0.3, "travel": 0.3}}
    runs = recorded(effect, seed=6, only=["triangle", "multisine", "sine", "slow", "multisine"])
    diagnosis = diagnose(runs[:4], "bouc_wen", held_out=runs[4:], effects=("settling", "gas_spring"))
    assert [cause.effect for cause in diagnosis.causes] == ["settling"]
    assert diagnosis.gap.after.value < 1.2 * diagnosis.gap.noise_floor.value


@pytest.mark.parametrize("frequency", [50.0, pytest.param(60.0, marks=pytest.mark.slow)])
def test_a_hum_is_found_whichever_the_mains_are(frequency):
    runs = recorded({"mains_hum": {"amplitude": 4.0, "frequency": frequency}}, rate=500)
    diagnosis = diagnose(runs, "bouc_wen", effects=("mains_hum", *FEW))
    assert (diagnosis.verdict, [cause.effect for cause in diagnosis.causes]) == ("explained", ["mains_hum"])
    assert diagnosis.corrected.parameters["mains_hum.frequency"] == frequency
    assert diagnosis.corrected.parameters["mains_hum.amplitude"] == pytest.approx(4.0, rel=0.1)
    assert f"at {frequency:.0f} Hz" in diagnosis.sentence


def test_a_known_filter_of_the_force_is_no_gap():
    runs = [
        replace(run, force=parse_low_pass("lowpass:6:zero-phase").filtered(run.force, run.rate))
        for run in recorded(rate=200)
    ]
    known = diagnose([with_force_filter(run, "lowpass:6:zero-phase") for run in runs], "bouc_wen", effects=("gas_spring",))
    assert known.gap.before.value < 0.02
    assert (known.verdict, known.causes) == ("no_gap", ())
    assert [finding.severity for finding in known.findings if finding.kind == "filter"] == ["remark"] * len(runs)


@pytest.mark.parametrize("frequency", [50.0, *(pytest.param(hum, marks=pytest.mark.slow) for hum in (60.02, 119.96))])
def test_a_strong_hum_in_slow_sampling_is_no_noise(frequency):
    phases = enumerate(recorded(rate=200))
    runs = [replace(run, force=run.force + 34.0 * np.cos(2 * np.pi * frequency * run.time + phase)) for phase, run in phases]
    diagnosis = diagnose(runs, "bouc_wen", effects=("mains_hum", *FEW))
    assert [cause.effect for cause in diagnosis.causes] == ["mains_hum"]
    assert diagnosis.verdict == "explained"
    assert diagnosis.corrected.parameters["mains_hum.frequency"] == round(frequency)
    assert diagnosis.gap.noise_floor.value < 0.15 * diagnosis.gap.before.value
    assert diagnosis.corrected.parameters["mains_hum.amplitude"] == pytest.approx(34.0, rel=0.15)
    assert any(finding.kind == "hum" for finding in diagnosis.findings)


def test_a_detectable_cap_is_one_that_the_force_reaches(healthy):
    cavitation = next(candidate for candidate in healthy.candidates if candidate.effects == ("cavitation",))
    cap = re.fullmatch(r"cavitation limits the force in compression to (\d+) N", cavitation.smallest_detectable)[1]
    model = find_model("bouc_wen", effects=("cavitation",))
    change = [
        model.force(model.vector(healthy.corrected.parameters | {"cavitation.inverse_cap": 1 / float(cap)}), path)
        - model.force(model.vector(healthy.corrected.parameters), path)
        for path in (residual.recording.path for residual in healthy.residuals)
    ]
    assert np.abs(np.concatenate(change)).max() > 5.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"effects": ["ghost"]}, "unknown effect ghost"),
        ({"model": "ghost"}, "unknown model ghost"),
        ({"runs": []}, "runs is empty, expected at least one run"),
        ({"parameters": StoredFit("bingham", {}, (), {}, {})}, "of the model bingham, expected bouc_wen"),
        ({"parameters": StoredFit("bouc_wen", {}, (), {"yield_force": 1e9}, {})}, "yield_force is 1e.09 N, expected"),
        (
            {"parameters": StoredFit("bouc_wen", {}, ("backlash",), {}, {})},
            "found the effects backlash in the fit, expected none",
        ),
        ({"parameters": StoredFit("bouc_wen", {"viscous": "tanh"}, (), {}, {}), "laws": "affine"}, "found the current laws"),
    ],
)
def test_bad_input(delayed, change, says):
    asked = {"runs": delayed, "model": "bouc_wen"} | change
    with pytest.raises(InputError, match=says):
        diagnose(**asked)


def test_the_tool_refuses_an_unusable_bench_file(tmp_path, monkeypatch, delayed):
    bench = tmp_path / "bench.yaml"
    bench.write_text("/**: {ros__parameters: {limits: {stroke_mm: far}}}\n")
    arguments = ["diagnose", "run.csv", "--model", "bouc_wen", "--bench", str(bench), "--output", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(InputError, match=r"bench\.yaml"):
        diagnose_tool.work()


def test_it_can_be_cancelled(delayed):
    class CancelledError(Exception):
        pass

    def progress(stage, fraction):
        if fraction > 0.1:
            raise CancelledError(stage)

    with pytest.raises(CancelledError):
        diagnose(delayed, "bouc_wen", effects=FEW, progress=progress)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "size"),
    [("backlash", 2e-4), ("coil_lag", 0.01), ("moving_mass", 4.0), ("shear_thinning", 600.0), ("flow_asymmetry", 0.08)],
)
def test_the_whole_catalogue_names_it(effect, size):
    from mrd_sim.effects import EFFECTS

    first = EFFECTS[effect].parameters[0].name
    runs = recorded({effect: dict(EFFECTS[effect].typical) | {first: size}}, seed=7, rate=500)
    diagnosis = diagnose(runs, "bouc_wen")
    assert diagnosis.causes[0].effect == effect
    assert diagnosis.gap.closed_fraction.value > 0.9
