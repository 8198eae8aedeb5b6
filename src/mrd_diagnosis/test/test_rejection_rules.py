"""What speaks against a cause is known by a rule, and the verdict obeys it."""

import importlib
from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import dedent
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_diagnosis import diagnose
from mrd_diagnosis.decision import causes, conclusion
from mrd_diagnosis.decision.conclusion import Conclusion, reject_others, worse_by_runs
from mrd_diagnosis.decision.explanation import Explanation
from mrd_diagnosis.decision.rejection_rules import RULES, Claim, markdown_table, rejecting_rule
from mrd_diagnosis.diagnosis import (
    ON_BOUND,
    UNDETERMINED,
    Candidate,
    Cause,
    Finding,
    Interval,
    Member,
    ParameterEstimate,
    Rejected,
)
from mrd_diagnosis.fitting.base_fit import LinearisedRefit
from mrd_diagnosis.recordings.imitating_limitations import clock_finding, imitating_limitations
from mrd_diagnosis.report.gap_file import to_json
from mrd_diagnosis.report.sentences import imitation_note, next_command, next_step
from mrd_diagnosis.search.effect_search import refit_with_effects
from mrd_diagnosis.search.model_comparison import ModelComparison
from mrd_diagnosis.wording.effect_names import effect_name
from mrd_identification.correction import correction_of_report
from mrd_runs.validation import make_run
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

EXPERIMENTS = {
    "multisine": """
        rod: {waveform: multisine, amplitude_mm: 14, lowest_hz: 0.3, highest_hz: 6, period_s: 10, rolloff: 1.2, seed: 0}
        coil: {waveform: aprbs, low_mA: 0, high_mA: 300, shortest_s: 0.05, longest_s: 0.3, count: 8, seed: 1}""",
    "triangle": """
        rod: {waveform: triangle, amplitude_mm: 12, slope_mm_per_s: 40}
        coil: {waveform: sine, offset_mA: 200, amplitude_mA: 150, frequency_hz: 0.8}""",
    "sine": """
        rod: {waveform: sine, amplitude_mm: 5, frequency_hz: 3}
        coil: {waveform: constant, level_mA: 200}""",
    "slow": """
        rod: {waveform: sine, amplitude_mm: 20, frequency_hz: 0.25}
        coil: {waveform: constant, level_mA: 150}""",
}
DAMPER = {"yield_force": 60.0, "yield_force_per_A": 800.0, "yield_travel": 1.5e-4, "viscous": 800.0, "coil_lag": 0.0}
FEW = ("gas_spring", "moving_mass", "force_sensor_lag", "channel_delay", "rate_dependent_hysteresis")
DOCUMENT = Path(__file__).parents[3] / "docs" / "diagnosis.md"


def recorded(effects=None, seed=0, rate=250):
    limits = read_settings(None)
    plans = [
        plan(
            parse_experiment(f"name: {name}\nduration_s: 8\nrate_hz: {rate}\n{dedent(text)}", name),
            limits.limits,
            limits.force_envelope,
        )
        for name, text in EXPERIMENTS.items()
    ]
    return measure_plans(plans, Damper("bouc_wen", DAMPER, effects=effects), np.random.default_rng(seed))


def held(run, channel, samples):
    """Return a run in which each reading of a channel stays the same for so many samples."""
    columns = {"time_s": run.time, "position_m": run.position, "current_A": run.current, "force_N": run.force}
    columns[channel] = columns[channel][np.arange(len(run)) // samples * samples]
    return make_run(run.name, columns, {})


# ---- The rules


def claim(effect="moving_mass", value=1.0, lower=0.9, upper=1.1, remark="", **more):
    name = EFFECTS[effect].parameters[0].name
    parameters = {f"{effect}.{name}": ParameterEstimate(Interval(value, lower, upper), "", remark)}
    return Claim(effect, **({"parameters": parameters, "closed_fraction": Interval(0.9), "open_fraction": 0.1} | more))


HELD = Finding("clock", "limitation", "the position is refreshed at 50 Hz only", "a", "position")


@pytest.mark.parametrize(
    ("rule", "claimed"),
    [
        (None, claim()),
        (None, claim("gas_spring", closed_fraction=Interval(0.02), open_fraction=0.01)),
        ("noise", claim(has_gap=False)),
        ("limitation", claim(limitations=(HELD,))),
        ("clocks", claim("channel_delay", clocks_agree=False)),
        (None, claim("gas_spring", clocks_agree=False)),
        ("on_bound", claim(value=-0.5, lower=-0.5, upper=-0.43, remark=ON_BOUND)),
        ("undetermined", claim("rate_dependent_hysteresis", 507.0, 0.0, 5000.0, UNDETERMINED)),
        ("neutral", claim("force_sensor_lag", 1e-7, 0.0, 24e-6)),
        ("neutral", claim("moving_mass", -0.2, -0.5, 0.1)),
        ("little", claim(closed_fraction=Interval(0.01), open_fraction=0.99, chosen=False)),
        (None, claim(closed_fraction=Interval(0.01), open_fraction=0.99)),
        ("little", claim(closed_fraction=Interval(-0.3), open_fraction=1.0)),
        ("worse", claim(closed_fraction=Interval(0.3), closed_together=Interval(-0.5, -0.7, -0.3))),
        (None, claim(closed_fraction=Interval(0.3), closed_together=Interval(-0.1, -0.7, 0.4))),
        ("other_model", claim(other_model=0.93)),
        (None, claim(other_model=0.4)),
        ("other_effect", claim(chosen=False)),
    ],
)
def test_the_first_rule_that_holds_rejects(rule, claimed):
    found = rejecting_rule(claimed)
    assert (found and found.id) == rule


def test_one_of_two_sizes_that_act_by_themselves_is_enough():
    sizes = {
        "channel_crosstalk.from_position": ParameterEstimate(Interval(10.0, -500.0, 500.0), "N/m"),
        "channel_crosstalk.from_current": ParameterEstimate(Interval(40.0, 35.0, 45.0), "N/A"),
    }
    assert rejecting_rule(Claim("channel_crosstalk", sizes, closed_fraction=Interval(0.9))) is None
    absent = sizes | {"channel_crosstalk.from_current": ParameterEstimate(Interval(1.0, -5.0, 8.0), "N/A")}
    assert rejecting_rule(Claim("channel_crosstalk", absent, closed_fraction=Interval(0.9))).id == "neutral"


def test_a_size_that_trades_with_a_shape_is_not_absent_where_it_closes_the_gap():
    spring = {
        "hardening_spring.force": ParameterEstimate(Interval(40.0, 0.0, 97.0), "N"),
        "hardening_spring.exponent": ParameterEstimate(Interval(4.9, 3.2, 6.6), ""),
    }
    much, perhaps_nothing = Interval(0.9, 0.8, 1.0), Interval(0.4, -0.1, 0.7)
    assert rejecting_rule(Claim("hardening_spring", spring, closed_fraction=much, closed_beside=much)) is None
    # What it closes around another form tells nothing of the size in the user's model.
    by_form = Claim("hardening_spring", spring, closed_fraction=much, closed_beside=perhaps_nothing)
    assert rejecting_rule(by_form).id == "neutral"
    left_out = spring | {"hardening_spring.force": ParameterEstimate(Interval(0.0, 0.0, 97.0), "N")}
    assert rejecting_rule(Claim("hardening_spring", left_out, closed_fraction=Interval(0.9, 0.8, 1.0))).id == "neutral"
    alone = {"hardening_spring.force": spring["hardening_spring.force"]}
    assert rejecting_rule(Claim("hardening_spring", alone, closed_fraction=Interval(0.9, 0.8, 1.0))).id == "neutral"


@given(
    st.sampled_from(list(EFFECTS)),
    st.sampled_from(["clock", "lag", "filter", "clipping", "hum", "coverage", "aliasing"]),
    st.sampled_from(["limitation", "remark"]),
    st.sampled_from(["position", "force", "current"]),
)
def test_only_limitations_of_their_kind_imitate_an_effect(effect, kind, severity, channel):
    found = imitating_limitations(effect, [Finding(kind, severity, "-", "a", channel)])
    if severity == "remark" or kind in ("hum", "coverage", "aliasing"):
        assert found == ()
    if effect in ("channel_delay", "moving_mass", "series_compliance", "joint_play") and severity == "limitation":
        assert bool(found) == (
            kind in ("clock", "lag", "filter") or (effect, kind, channel) == ("joint_play", "clipping", "position")
        )
    if effect in ("gas_spring", "thermal_fade"):
        assert found == ()


def test_the_documentation_has_the_rules():
    text = DOCUMENT.read_text(encoding="utf-8")
    assert markdown_table() in text
    assert len({rule.id for rule in RULES}) == len(RULES)


# ---- Limitations stand before effects


@pytest.mark.parametrize(
    ("channel", "rate", "samples", "limited"),
    [
        pytest.param("position_m", 250, 5, (0, 1, 2, 3), marks=pytest.mark.slow),
        ("force_N", 250, 5, (0, 1, 2, 3)),
        pytest.param("force_N", 500, 5, (0, 2), marks=pytest.mark.slow),
        pytest.param("current_A", 250, 5, (1,), marks=pytest.mark.slow),
    ],
)
def test_readings_that_are_held_are_the_answer_and_no_cause(channel, rate, samples, limited):
    runs = [held(run, channel, samples if number in limited else 1) for number, run in enumerate(recorded(rate=rate))]
    diagnosis = diagnose(runs, "bouc_wen", effects=("moving_mass", "channel_delay"))
    assert (diagnosis.causes, next_command(diagnosis)) == ((), "")
    assert "is refreshed at" in diagnosis.sentence or diagnosis.verdict == "no_gap"
    if diagnosis.verdict == "data_fault":
        assert {entry.rule for entry in diagnosis.rejected} == {"limitation"}
        with pytest.raises(InputError, match="recordings are faulty"):
            correction_of_report(to_json(diagnosis), "gap.json")


def test_what_the_runs_without_a_limitation_show_as_well_is_named():
    runs = recorded({"channel_delay": {"delay": 0.012}})
    runs[3] = held(runs[3], "position_m", 2)
    diagnosis = diagnose(runs, "bouc_wen", effects=FEW)
    assert any("is refreshed at" in finding.text for finding in diagnosis.findings)
    assert [cause.effect for cause in diagnosis.causes] == ["channel_delay"]


def test_a_delay_is_not_named_where_the_clocks_are_not_known_to_agree():
    runs = recorded({"channel_delay": {"delay": 0.012}})
    assert clock_finding(runs) is None
    doubtful = [
        replace(run, info={**run.info, "clocks": {"position": "stamps of a", "force": "stamps of b"}}) for run in runs
    ]
    diagnosis = diagnose(doubtful, "bouc_wen", effects=("channel_delay", "gas_spring"))
    assert (diagnosis.verdict, diagnosis.causes) == ("data_fault", ())
    assert "clocks that are not known to agree" in diagnosis.sentence
    assert [(entry.effect, entry.rule) for entry in diagnosis.rejected] == [("channel_delay", "clocks")]
    # One run of five tells little, a set after a change that has one run tells all.
    assert clock_finding([doubtful[0], *runs]) is None
    assert clock_finding(doubtful[:1], runs) == clock_finding(doubtful[:1])


@pytest.mark.slow
def test_runs_before_a_change_do_not_show_that_an_effect_is_more_than_a_limitation_of_all_others():
    after = [held(run, "position_m", 5) for run in recorded({})]
    diagnosis = diagnose(after, "bouc_wen", reference=recorded({}, seed=50), effects=FEW)
    assert diagnosis.causes == ()
    assert {entry.rule for entry in diagnosis.rejected if entry.chosen} <= {"limitation"}


# ---- Seen, not determined


def test_a_size_beyond_its_range_is_seen_and_not_named(monkeypatch):
    runs = recorded({"channel_delay": {"delay": 0.012}})
    delay = EFFECTS["channel_delay"]
    narrow = replace(delay, parameters=(replace(delay.parameters[0], upper=0.011),))
    monkeypatch.setitem(EFFECTS, "channel_delay", narrow)
    diagnosis = diagnose(runs, "bouc_wen", effects=("channel_delay", "gas_spring"))
    assert (diagnosis.verdict, diagnosis.causes) == ("ambiguous", ())
    assert (diagnosis.rejected[0].effect, diagnosis.rejected[0].rule) == ("channel_delay", "on_bound")
    assert diagnosis.sentence.startswith("Seen, not determined: the force channel is late by 11")
    assert "above 99 %" not in diagnosis.sentence
    assert "wider range" in next_step(diagnosis)
    assert "apply" not in next_command(diagnosis)
    with pytest.raises(InputError, match="--anyway"):
        correction_of_report(to_json(diagnosis), "gap.json")
    assert "channel_delay" in correction_of_report(to_json(diagnosis), "gap.json", anyway=True).effects


@pytest.mark.slow
def test_an_effect_that_closes_the_gap_with_any_size_is_seen_and_not_named(monkeypatch):
    runs = recorded({"channel_delay": {"delay": 0.012}})
    estimate = causes.effect_parameters

    def undetermined(refitted):
        return {name: replace(value, remark=UNDETERMINED) for name, value in estimate(refitted).items()}

    monkeypatch.setattr(causes, "effect_parameters", undetermined)
    diagnosis = diagnose(runs, "bouc_wen", effects=(*FEW[:2], "channel_delay"))
    assert (diagnosis.verdict, diagnosis.causes) == ("ambiguous", ())
    assert diagnosis.sentence.startswith("Seen, not determined: the force channel is late by")
    assert "99 %" not in diagnosis.sentence.partition("It would remove")[0]
    assert "Record runs" in next_step(diagnosis)
    assert diagnosis.nearest.effects == ("channel_delay",)


# ---- Other damper models


def test_an_effect_is_not_explained_where_another_damper_model_does_as_much(monkeypatch):
    """Noise explains what the effect leaves, so that nothing else asks for another model."""
    module = importlib.import_module("mrd_diagnosis.explain_gap")
    asked = []

    def as_good(effect, weighting, base, *_):
        asked.append(effect)
        (fit,) = refit_with_effects(weighting, LinearisedRefit.around(weighting, base), [effect], 1)
        return {"modified_lugre": fit.refit}

    monkeypatch.setattr(module, "fit_alternative_models", partial(as_good, "channel_delay"))
    runs = recorded({"channel_delay": {"delay": 0.012}})
    diagnosis = diagnose(runs, "bouc_wen", effects=("channel_delay", "gas_spring"))
    assert asked == ["channel_delay"]
    assert diagnosis.verdict in ("ambiguous", "unknown_effect")
    monkeypatch.setattr(module, "fit_alternative_models", partial(as_good, "gas_spring"))
    assert diagnose(runs, "bouc_wen", effects=("channel_delay", "gas_spring")).verdict == "explained"


@pytest.mark.parametrize(
    ("left_alone", "named"), [(1500.0, {"bypass_flow", "side_load_friction"}), (0.0, {"bypass_flow"}), (None, set())]
)
def test_the_rules_are_asked_again_when_what_remains_was_fitted_without_the_rejected(monkeypatch, left_alone, named):
    """A thinning has no size in these runs; with it, friction by side load has one, and without it perhaps none."""

    def cause(effect, size, remark=""):
        name = EFFECTS[effect].parameters[0].name
        estimate = ParameterEstimate(Interval(size, size - 100.0, size + 100.0), "", remark)
        return Cause(effect, 0.9, 1e-3, Interval(0.3, 0.2, 0.4), {f"{effect}.{name}": estimate})

    def causes_of(explanation, _rng):
        effects = explanation.comparison.effects
        whole = "shear_thinning" in effects
        sizes = {
            "shear_thinning": cause("shear_thinning", 4000.0, UNDETERMINED),
            "side_load_friction": cause("side_load_friction", 1500.0 if whole else left_alone or 0.0),
            "bypass_flow": cause("bypass_flow", 0.0 if left_alone is None and not whole else 1500.0),
        }
        return tuple(sizes[effect] for effect in effects)

    def chosen(effects):
        alternatives = {effect: {} for effect in effects}
        return SimpleNamespace(effects=tuple(effects), alternatives=alternatives, weighting=None, base=None, best=None)

    monkeypatch.setattr(conclusion, "name_causes", causes_of)
    monkeypatch.setattr(conclusion, "harmful_effects", lambda *_: ((), {}))
    monkeypatch.setattr(conclusion, "closed_fraction_between", lambda *_, **__: Interval(0.6, 0.5, 0.7))
    monkeypatch.setattr(conclusion, "refit_on", lambda *_: None)
    monkeypatch.setattr(conclusion, "refit_without", lambda *_: None)
    monkeypatch.setattr(conclusion, "_with_only", lambda _comparison, effects: chosen(effects))
    monkeypatch.setattr(conclusion, "with_intervals_of_all_forms", lambda cause, _explanation: cause)
    whole = chosen(["shear_thinning", "side_load_friction", "bypass_flow"])
    explanation = Explanation("partly_explained", whole, {effect: {effect: 0.9} for effect in whole.effects}, {})
    found = conclusion.conclude(explanation, whole, (), None, np.random.default_rng(0))
    assert {cause.effect for cause in found.causes} == named
    assert {entry.effect for entry in found.rejected} == set(whole.effects) - named
    assert found.explanation.verdict == ("partly_explained" if named else "unknown_effect")
    assert (found.complete is whole) == (not named)


def test_what_predicts_each_run_worse_from_the_others_is_no_cause():
    """Although segments of the runs are predicted better: an end stop had been moved between the runs."""
    cause = Cause("end_stop", 0.6, 1e-3, Interval(0.4, 0.2, 0.6), {})
    comparison = ModelComparison(None, None, (None,), ("end_stop",), {"end_stop": {}})
    explanation = Explanation("partly_explained", comparison, {"end_stop": {"end_stop": 0.6}}, {"end_stop": 1e-3})
    found = worse_by_runs(Conclusion(explanation, comparison, (cause,)))
    assert (found.causes, found.explanation.verdict) == ((), "unknown_effect")
    # The corrected simulator is the model that predicts better.
    assert found.complete.effects == found.explanation.comparison.effects == ()
    assert [(entry.effect, entry.rule, entry.chosen) for entry in found.rejected] == [("end_stop", "worse", True)]
    limited = worse_by_runs(Conclusion(explanation, comparison, (cause,), limitations=(HELD,)))
    assert limited.explanation.verdict == "data_fault"


def candidate_of(effect, closed):
    return Candidate((effect,), 0.05, Interval(closed, closed - 0.1, closed + 0.1), 1e-3, 0.0, {})


def test_no_effect_is_rejected_for_a_better_one_that_there_is_not():
    """Of an unknown effect, what comes nearest leaves too much open; a class has no rejected members."""
    nearest = ModelComparison(None, None, (None,), ("end_stop",), {"end_stop": {}})
    unknown = Conclusion(Explanation("unknown_effect", nearest, {}, {}), nearest, ())
    listed = [candidate_of("end_stop", 0.6), candidate_of("gas_spring", 0.3)]
    found = reject_others(unknown, listed, (), (), None)
    assert {entry.effect: entry.rule for entry in found} == {"end_stop": "unexplained", "gas_spring": "other_effect"}
    members = tuple(Member(effect, 0.4, 1.0, {}) for effect in ("channel_delay", "force_sensor_lag"))
    cause = Cause("channel_delay", 0.6, 1e-3, Interval(0.8, 0.7, 0.9), {}, "class", members)
    named = Conclusion(Explanation("ambiguous", nearest, {}, {}), nearest, (cause,))
    listed = [candidate_of("channel_delay", 0.8), candidate_of("force_sensor_lag", 0.7), candidate_of("gas_spring", 0.3)]
    assert [entry.effect for entry in reject_others(named, listed, (), (), None)] == ["gas_spring"]


def test_only_what_a_limitation_imitates_is_said_to_be_imitated():
    def entry(effect, rule):
        return Rejected(effect, rule, "", True, 0.7, 0.01, Interval(0.6), {})

    note = imitation_note([entry("channel_delay", "limitation"), entry("gas_spring", "on_bound")])
    assert effect_name("channel_delay") in note
    assert effect_name("gas_spring") not in note


def test_the_likeliest_effect_of_a_place_leads_it(monkeypatch):
    """The search chose the other one with an earlier estimate of the noise; its size starts from the fit in that place."""
    base, lag, delay = (
        SimpleNamespace(values=values)
        for values in ({"viscous": 1.0}, {"viscous": 2.0, "force_sensor_lag.time": 3e-3}, {"channel_delay.delay": 4e-3})
    )
    alternatives = {"force_sensor_lag": {"force_sensor_lag": lag, "channel_delay": delay, "": base}}
    comparison = ModelComparison(None, base, (lag,), ("force_sensor_lag",), alternatives)
    probabilities = {"force_sensor_lag": {"channel_delay": 0.6, "force_sensor_lag": 0.35, "": 0.05}}
    explanation = Explanation("ambiguous", comparison, probabilities, {"force_sensor_lag": 1e-3})

    def with_chain(compared, effects, values, others):
        return replace(compared, chain=(SimpleNamespace(values=values),), effects=tuple(effects), alternatives=others)

    monkeypatch.setattr(conclusion, "with_chain", with_chain)
    led, complete = conclusion._led_by_likeliest(explanation, comparison, lambda compared: compared)
    assert complete is led.comparison
    assert (complete.effects, *led.probabilities, *led.p_values) == (("channel_delay",), "channel_delay", "channel_delay")
    assert complete.best.values["channel_delay.delay"] == 4e-3
    assert complete.alternatives["channel_delay"] is alternatives["force_sensor_lag"]
    kept = replace(explanation, probabilities={"force_sensor_lag": {"force_sensor_lag": 0.6, "channel_delay": 0.35}})
    assert conclusion._led_by_likeliest(kept, comparison, lambda compared: compared) == (kept, comparison)
