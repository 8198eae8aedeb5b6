"""Classes of causes: what is named where recordings do not decide between effects that look alike."""

from types import SimpleNamespace

import numpy as np
import pytest

from mrd_diagnosis import Cause, diagnose
from mrd_diagnosis.decision.causes import level_of
from mrd_diagnosis.diagnosis import Interval, Member
from mrd_diagnosis.evidence.cause_class import class_name, imitations
from mrd_diagnosis.report.sentences import cause_clause
from mrd_diagnosis.search.model_comparison import NO_EFFECT
from mrd_sim.damper import Damper
from mrd_sim.effects import EFFECTS
from mrd_sim.simulate import measure_plans
from mrd_trajectory.experiment import parse_experiment
from mrd_trajectory.plan import plan
from mrd_trajectory.settings import read_settings

CANDIDATES = ("joint_play", "backlash", "gas_spring")
ONE_SINE = """
name: sine
duration_s: 6
rate_hz: 250
rod: {waveform: sine, amplitude_mm: 8, frequency_hz: 2}
coil: {waveform: constant, level_mA: 200}
"""


def recorded(**effects):
    settings = read_settings(None)
    of_one = plan(parse_experiment(ONE_SINE, "sine"), settings.limits, settings.force_envelope)
    damper = Damper("bouc_wen", {"coil_lag": 0.0, "yield_force": 60.0, "yield_travel": 1.5e-4}, effects=effects)
    return measure_plans([of_one] * 3, damper, np.random.default_rng(1))


def test_one_sine_tells_that_something_gives_and_not_what():
    diagnosis = diagnose(recorded(backlash={"play": 2e-4}), "bouc_wen", effects=CANDIDATES)
    (cause,) = diagnosis.causes
    assert (diagnosis.verdict, cause.level) == ("ambiguous", "class")
    assert {member.effect for member in cause.members} == {"joint_play", "backlash"}
    assert all(one.imitation > 0.9 for one in cause.members)
    assert cause.class_probability > 0.9
    assert diagnosis.sentence.startswith("Something between motor and damper gives")
    for member in cause.members:
        size = member.parameters[f"{member.effect}.play"].value.value
        assert size == pytest.approx(2e-4, rel=0.25)


def refitted(error):
    """Return a refit that leaves an error (n,)."""
    problem = SimpleNamespace(counted=lambda error: error, errors=lambda error: error)
    return SimpleNamespace(problem=problem, theta=np.asarray(error, dtype=float))


def test_look_alikes_change_the_error_alike_whatever_their_sizes():
    """An end stop whose change was 2.6 times as large had no R² with the spring that stood beside it with 40 %."""
    changes = {
        "hardening_spring": [-8.0, 3.0, 0.0, 0.0],
        "end_stop": [-24.0, -3.0, 0.0, 0.0],  # 3 times as large and a little different
        "gas_spring": [0.0, 0.0, -5.0, 0.0],  # changes another part
        "backlash": [-8.0, 3.0, -5.0, 0.0],  # changes both
        "seal_friction": [8.0, -3.0, 0.0, 0.0],  # the opposite
        "coil_lag": [0.0, 0.0, 0.0, 0.0],
        "moving_mass": [np.inf, 0.0, 0.0, 0.0],
        "channel_delay": [-8e200, 3e200, 0.0, 0.0],
    }
    without = np.array([10.0, 0.0, 5.0, 1.0])
    refits = {NO_EFFECT: refitted(without)} | {name: refitted(without + change) for name, change in changes.items()}
    shares = imitations("hardening_spring", refits)
    assert shares["end_stop"] == pytest.approx(0.78, abs=0.01)
    assert shares["backlash"] == pytest.approx(73 / 98)
    assert shares["channel_delay"] == pytest.approx(1.0)
    assert shares["gas_spring"] == shares["seal_friction"] == shares["coil_lag"] == shares["moving_mass"] == 0.0
    assert set(imitations("moving_mass", refits).values()) == {0.0}


def member(effect, probability):
    return Member(effect, probability, 0.9, {})


@pytest.mark.parametrize(
    ("probabilities", "level"),
    [
        ({"channel_delay": 0.9, "force_sensor_lag": 0.05}, "effect"),
        ({"channel_delay": 0.5, "force_sensor_lag": 0.3}, "class"),
        ({"channel_delay": 0.3, "load_cell_drift": 0.1, "channel_crosstalk": 0.2}, "stage"),
        ({"channel_delay": 0.3, "joint_play": 0.25, "gas_spring": 0.25}, "undecided"),
    ],
)
def test_the_level_is_what_the_recordings_determine(probabilities, level):
    members = tuple(
        member(name, probabilities[name]) for name in ("channel_delay", "force_sensor_lag") if name in probabilities
    )
    assert level_of("channel_delay", members, probabilities) == level


@pytest.mark.parametrize(("share", "level"), [(0.85, "class"), (0.92, "effect")])
def test_beside_a_wrong_form_one_effect_must_be_clearer_to_stand_for_its_class(share, level):
    probabilities = {"hardening_spring": 0.9 * share, "end_stop": 0.9 * (1.0 - share)}
    members = tuple(member(name, value) for name, value in probabilities.items())
    assert level_of("hardening_spring", members, probabilities, beside_wrong_form=True) == level
    assert level_of("hardening_spring", members, probabilities) == "effect"


@pytest.mark.parametrize(
    ("level", "effects", "text"),
    [
        ("effect", ["channel_delay"], "the force channel is late by 0 s"),
        (
            "class",
            ["channel_delay", "force_sensor_lag"],
            "the measured force is late: either the force channel is late by 0 s (40 %) "
            "or the force sensor lags by 0 s (40 %)",
        ),
        (
            "class",
            ["channel_delay", "gas_spring"],
            "either the force channel is late by 0 s (40 %) or the gas charge acts as a spring of 0 N/m (40 %)",
        ),
        ("stage", ["channel_delay"], "the cause acts in the force measurement, most likely as delay of the force channel"),
    ],
)
def test_a_cause_is_named_as_far_as_it_is_known(level, effects, text):
    members = tuple(member(effect, 0.4) for effect in effects)
    cause = Cause(effects[0], 0.4, 0.0, Interval(0.5), {}, level, members)
    assert cause_clause(cause).startswith(text)


def test_effects_that_look_alike_have_a_name_together():
    assert class_name(["joint_play", "backlash", "series_compliance"]) == "something between motor and damper gives"
    assert class_name(["joint_play", "gas_spring"]) == ""
    assert class_name(["joint_play", "an own effect"]) == ""
    symptoms = [effect.symptom for effect in EFFECTS.values() if effect.symptom]
    assert all(symptoms.count(symptom) > 1 for symptom in symptoms)


def test_the_likelier_effect_of_a_stage_is_named_first():
    members = (member("pre_yield_hysteresis", 0.04),)
    cause = Cause("pre_yield_hysteresis", 0.04, 0.0, Interval(0.5), {}, "stage", members, ("series_compliance",))
    assert cause_clause(cause).startswith(
        "the cause acts in the damper fluid, more likely as compliance in series than as pre-yield hysteresis, which was"
    )
