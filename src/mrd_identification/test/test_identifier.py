"""The identifier node: options and messages of the tool. `test_analysis_node.py` tests what all analyses share."""

from dataclasses import fields

import pytest
from action_msgs.msg import GoalStatus

from mrd_base import InputError
from mrd_identification.method import Method
from mrd_identification.nodes import identifier
from mrd_interfaces.action import Identify
from mrd_sim.models import find_model
from mrd_sim.models_page import EXAMPLE


@pytest.fixture
def client(serve_action, tmp_path):
    return serve_action(identifier.Identifier, Identify, "identify", "--ros-args", "-p", f"trusted_folders:={tmp_path}")


def test_bad_input_is_refused_in_one_line(client, recorded, tmp_path):
    nowhere = str(tmp_path / "nowhere")
    for goal, words in (
        (Identify.Goal(runs=recorded, model="honey", output=str(tmp_path)), "unknown model honey"),
        (Identify.Goal(runs=recorded, model="bingham", loss="absolute", output=str(tmp_path)), "loss 'absolute': expected"),
        (Identify.Goal(runs=recorded, model="bingham", fixed=["offset"], output=str(tmp_path)), "fixed parameter offset:"),
        (
            Identify.Goal(runs=recorded, model="bingham", effects_folder=nowhere, output=str(tmp_path)),
            f"effects_folder is {nowhere}: its files are executed",
        ),
        (
            Identify.Goal(runs=recorded, model="bingham", models_folder=nowhere, output=str(tmp_path)),
            f"models_folder is {nowhere}: its files are executed",
        ),
        (Identify.Goal(runs=recorded, model="bingham"), "--output is empty"),
        (Identify.Goal(model="bingham", output=str(tmp_path)), "no samples were heard"),
    ):
        why = client.failure(goal)
        assert words in why
        assert "\n" not in why.strip()


def test_a_goal_has_the_options_of_the_tool(client, recorded, tmp_path, monkeypatch):
    methods, fitted = [], []

    def stop(runs, *_arguments, method, **_options):
        methods.append(method)
        fitted.append(runs)
        raise InputError("stopped")

    monkeypatch.setattr(identifier, "identify", stop)
    common = {"runs": recorded, "model": "bingham", "output": str(tmp_path), "least_squares": True}
    options = {
        "laws": "viscous=tanh",
        "effects": ["moving_mass"],
        "fixed": ["offset=1.5"],
        "freed": ["creep_speed"],
        "offsets": True,
        "weights": "runs",
        "loss": "huber",
        "population": 20,
        "generations": 5,
        "seed": 7,
        "seeds": 2,
        "no_profile": True,
        "skip": 0.5,
        "force_filters": ["lowpass:20"],
    }
    for goal in (Identify.Goal(**common), Identify.Goal(**common, **options)):
        assert client.ended(client.send(goal)).result.message == "stopped"
    given = {name: value for name, value in options.items() if name in {field.name for field in fields(Method)}}
    given |= {"laws": {"viscous": "tanh"}, "fixed": {"offset": 1.5}, "profile": False}
    assert methods == [Method(laws=""), Method(**given)]
    assert [run.info.get("force_filter") for runs in fitted for run in runs] == [None] * 3 + ["lowpass:20"] * 3
    assert all(len(short) < len(whole) for whole, short in zip(*fitted, strict=True))


def test_a_model_of_the_user_is_known_during_its_goal(client, recorded, tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(EXAMPLE)
    known = []

    def stop(_runs, model, **_options):
        known.append(find_model(model).title)
        raise InputError("stopped")

    monkeypatch.setattr(identifier, "identify", stop)
    goal = Identify.Goal(runs=recorded, model="asymmetric_bingham", models_folder=str(tmp_path), output=str(tmp_path))
    assert client.ended(client.send(goal)).result.message == "stopped"
    assert len(known) == 1
    goal.models_folder = ""
    assert client.failure(goal).startswith("unknown model asymmetric_bingham")


def test_an_identification_reports_progress_and_ends_when_its_goal_is_cancelled(client, recorded, tmp_path):
    generations = 1_000_000
    handle = client.send(
        Identify.Goal(runs=recorded, model="bingham", population=8, generations=generations, output=str(tmp_path / "fit"))
    )
    client.until(lambda: len(client.feedback) > 1)
    handle.cancel_goal_async()
    assert client.ended(handle).status == GoalStatus.STATUS_CANCELED
    assert list((tmp_path / "fit").iterdir()) == []
    steps = [feedback.generation for feedback in client.feedback]
    assert 0 < steps[0] < steps[1]
    assert steps == sorted(steps)
    assert all(feedback.generations >= generations for feedback in client.feedback)
    assert all(feedback.nrmse > 0.0 for feedback in client.feedback)
