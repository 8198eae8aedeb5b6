"""Weights of evidence that are learnt from plants whose effects are known."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis.decision.presence import PresenceModel
from mrd_diagnosis.evidence.evidence import EVIDENCE
from mrd_trials.cli.learn import work
from mrd_trials.cli.options import default_answers
from mrd_trials.learn import Row, learn, rows_of, set_share
from mrd_trials.records import GroundTruth, Submission, WeighedEffect, append_record
from mrd_trials.submission import installed_diagnoser, reserve_folder
from mrd_trials.trial_design import Recipe
from mrd_trials.trial_folder import PublicTrial, write_trial

NAMES = [entry.name for entry in EVIDENCE]
PLANTS = "rich", "single"
AGAINST = {entry.name for entry in EVIDENCE if entry.against}


def truth(plant, causes, *, excitation="rich", kind="single", implied=(), background=""):
    return GroundTruth(
        plant,
        kind,
        "bouc_wen",
        "bent",
        False,
        implied,
        {},
        {},
        {},
        causes,
        {},
        1.0,
        "",
        excitation,
        500.0,
        0,
        "",
        background,
    )


def weighed(effect, *others, **evidence):
    numbers = dict.fromkeys(NAMES, 0.5) | evidence
    return WeighedEffect(effect, (effect, *others), 0.5, numbers, {effect: 0.5})


def drawn_rows(count, seed=0):
    """Draw rows in which the share that is closed tells right from wrong, drift does as well, and nothing else matters."""
    rng = np.random.default_rng(seed)
    rows = []
    for index in range(count):
        right = bool(rng.random() < 0.5)
        numbers = {name: float(rng.random()) for name in NAMES}
        numbers["support"] = float(np.clip(rng.normal(0.6 if right else 0.3, 0.1), 0, 1))
        numbers["drift"] = float(np.clip(rng.normal(0.2 if right else 0.5, 0.2), 0, 2))
        entry = WeighedEffect("end_stop", ("end_stop",), 0.5, numbers, {"end_stop": 0.5})
        rows.append(Row(f"damper{index % 4}", entry, frozenset({"end_stop"} if right else ()), PLANTS))
    return rows


def test_what_tells_right_from_wrong_gets_the_weight():
    model = learn(drawn_rows(200), {PLANTS: 200}, [{"seed": 1}])
    largest = max(model.weights, key=lambda name: abs(model.weights[name]))
    assert largest == "support"
    assert model.weights["drift"] < 0.0
    for name, weight in model.weights.items():
        assert weight <= 0.0 if name in AGAINST else weight >= 0.0
    measured = model.card["left out by damper"]
    assert measured["log loss"] < 0.7 * measured["log loss of the mean alone"]
    assert measured["named and right"] > 0.85 * measured["named"]
    assert model.card["trials"] == [{"seed": 1}]
    assert PresenceModel(**json.loads(json.dumps(asdict(model)))) == model


def test_sets_hold_the_true_effect_in_nine_of_ten_cases():
    def row(place):
        probabilities = {"end_stop": 0.4, "gas_spring": 0.3, "backlash": 0.2, "settling": 0.1}
        entry = WeighedEffect("end_stop", tuple(probabilities), 0.5, dict.fromkeys(NAMES, 0.5), probabilities)
        return Row("damper", entry, frozenset([list(probabilities)[place]]), PLANTS)

    def share(*rows):
        return set_share(rows, np.full(len(rows), 1.0))

    assert share(*[row(0)] * 100) == pytest.approx(0.0, abs=1e-3)
    assert share(*[row(0)] * 85, *[row(1)] * 15) == pytest.approx(0.4, abs=1e-3)
    assert share(*[row(0)] * 80, *[row(2)] * 20) == pytest.approx(0.7, abs=1e-3)
    elsewhere = replace(
        row(0),
        weighed=replace(row(0).weighed, members=("end_stop", "mains_hum"), table={"end_stop": 1.0, "mains_hum": 0.0}),
        causes=frozenset({"mains_hum"}),
    )
    assert share(*[row(0)] * 80, *[elsewhere] * 20) == 1.0


def test_the_same_trials_give_the_same_weights():
    assert learn(drawn_rows(100), {PLANTS: 100}, []) == learn(drawn_rows(100), {PLANTS: 100}, [])


def test_each_kind_of_plant_counts_as_in_the_standard_trial():
    """Many dampers without an effect were diagnosed only to learn what stands in for one; they made every cause unlikely."""
    rows, null = drawn_rows(300), ("rich", "null")
    kinds = [replace(row, plants=PLANTS if row.right else null) for row in rows]
    more = kinds + 3 * [row for row in kinds if not row.right]
    undecided = dict.fromkeys(NAMES, 0.5) | {"support": 0.45, "drift": 0.35}
    once = learn(kinds, {PLANTS: 150, null: 150}, []).probability(undecided)
    assert 0.3 < once < 0.7
    assert learn(more, {PLANTS: 150, null: 600}, []).probability(undecided) == pytest.approx(once, abs=0.02)


def test_evidence_against_nature_gets_no_weight():
    rows = [
        replace(row, weighed=replace(row.weighed, evidence=dict(row.weighed.evidence) | {"kept": 1.0 - row.right}))
        for row in drawn_rows(100)
    ]
    assert learn(rows, {PLANTS: 100}, []).weights["kept"] == 0.0


def test_too_few_plants_are_refused():
    with pytest.raises(InputError, match="expected 20 of each"):
        learn(drawn_rows(30), {PLANTS: 30}, [])


def test_one_form_of_damper_is_refused():
    with pytest.raises(InputError, match="one form of damper only"):
        learn([replace(row, damper="bent") for row in drawn_rows(100)], {PLANTS: 100}, [])


def test_a_class_is_right_with_its_member():
    answers = {"p1": truth("p1", ("channel_delay",))}
    submissions = {
        "p1": Submission("p1", "x", weighed=(weighed("force_sensor_lag", "channel_delay"), weighed("gas_spring")))
    }
    assert [row.right for row in rows_of(answers, submissions)] == [True, False]


def test_what_nobody_knows_is_not_counted():
    answers = {
        "p1": truth("p1", (), excitation="semireal", kind="null"),
        "p2": truth("p2", ("end_stop",), excitation="semireal", background="p1"),
        "p3": truth("p3", ("end_stop",), implied=("shear_thinning",)),
        "p4": truth("p4", ("joint_play",), excitation="semireal", background="p1"),
    }
    submissions = {
        "p1": Submission("p1", "x", weighed=(weighed("backlash"),)),
        "p2": Submission("p2", "x", weighed=(weighed("backlash"), weighed("end_stop"), weighed("gas_spring"))),
        "p3": Submission("p3", "x", weighed=(weighed("shear_thinning"), weighed("backlash"))),
        "p4": Submission(
            "p4", "x", weighed=(weighed("joint_play", "backlash"),)
        ),  # right, but the untouched runs had it too
    }
    failed = submissions | {"p1": Submission("p1", "failed")}
    assert [row.weighed.effect for row in rows_of(answers, failed)] == ["backlash"]
    rows = rows_of(answers, submissions)
    assert [(row.weighed.effect, row.right) for row in rows] == [
        ("end_stop", True),
        ("gas_spring", False),
        ("backlash", False),
    ]


@pytest.mark.parametrize(
    ("family", "versions", "message"),
    [
        ("evaluation", ("1", "1"), "family evaluation, on which nothing may be tuned"),
        ("development", ("1", "2"), "verdicts_1: holds verdicts of another diagnoser than .*verdicts_0"),
    ],
)
def test_trials_that_nothing_may_be_learnt_from_are_refused(tmp_path, monkeypatch, family, versions, message):
    arguments = ["learn", "--output", str(tmp_path / "presence.json")]
    for number, version in enumerate(versions):
        folder, verdicts = tmp_path / f"trial_{number}", tmp_path / f"verdicts_{number}"
        folder.mkdir()
        write_trial(PublicTrial(Recipe(number, {}, family=family), ()), folder)
        append_record(truth("p1", ()), default_answers(folder))
        reserve_folder(replace(installed_diagnoser(), version=version), verdicts)
        arguments += ["--trial", str(folder), str(verdicts)]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(InputError, match=message):
        work()
