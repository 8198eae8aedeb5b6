"""The identifier node: the options and messages of the tool, one goal at a time, and cancelling."""

import threading

import pytest
from action_msgs.msg import GoalStatus

from mrd_base import InputError
from mrd_identification.method import Method
from mrd_identification.nodes import identifier
from mrd_interfaces.action import Identify


@pytest.fixture
def client(serve_action):
    return serve_action(identifier.Identifier, Identify, "identify")


def test_bad_input_is_refused_in_one_line(client, recorded, tmp_path):
    nowhere = str(tmp_path / "nowhere")
    for goal, words in (
        (Identify.Goal(runs=recorded, model="honey", output=str(tmp_path)), "unknown model honey"),
        (Identify.Goal(runs=recorded, model="bingham", loss="absolute", output=str(tmp_path)), "loss 'absolute': expected"),
        (Identify.Goal(runs=recorded, model="bingham", fixed=["offset"], output=str(tmp_path)), "fixed parameter offset:"),
        (Identify.Goal(runs=recorded, model="bingham", effects_folder=nowhere, output=str(tmp_path)), nowhere),
        (Identify.Goal(runs=recorded, model="bingham"), "--output is empty"),
        (Identify.Goal(model="bingham", output=str(tmp_path)), "no samples were heard"),
    ):
        ended = client.ended(client.send(goal))
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert not ended.result.success
        assert words in ended.result.message
        assert "\n" not in ended.result.message.strip()
        assert ended.result.message


def test_a_goal_has_the_options_of_the_tool(client, recorded, tmp_path, monkeypatch):
    methods = []

    def stop(*_arguments, method, **_options):
        methods.append(method)
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
    }
    for goal in (Identify.Goal(**common), Identify.Goal(**common, **options)):
        assert client.ended(client.send(goal)).result.message == "stopped"
    given = {name: value for name, value in options.items() if name != "no_profile"}
    given |= {"laws": {"viscous": "tanh"}, "fixed": {"offset": 1.5}, "profile": False}
    assert methods == [Method(laws=""), Method(**given)]


def test_one_goal_at_a_time_and_cancelled_on_request(client, recorded, tmp_path, monkeypatch):
    going, cancelled = threading.Event(), threading.Event()

    def endless(*_arguments, progress, **_options):
        while True:
            going.set()
            cancelled.wait(0.02)
            progress(1, 0.5)

    monkeypatch.setattr(identifier, "identify", endless)
    goal = Identify.Goal(runs=recorded, model="bingham", output=str(tmp_path))
    handle = client.send(goal)
    client.until(lambda: client.feedback)
    assert going.is_set()
    assert not client.send(goal).accepted
    handle.cancel_goal_async()
    ended = client.ended(handle)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert (ended.result.success, ended.result.message) == (False, "cancelled")
    client.feedback.clear()
    again = client.send(goal)
    assert again.accepted
    client.until(lambda: client.feedback)
    again.cancel_goal_async()
    assert client.ended(again).status == GoalStatus.STATUS_CANCELED
