"""The diagnoser node: one goal at a time, with the results of the tool, and cancelled on request."""

import json
import threading
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus

from mrd_base import InputError
from mrd_diagnosis.nodes import diagnoser
from mrd_interfaces.action import Diagnose
from mrd_sim.effects import EFFECTS
from mrd_trajectory.settings import read_settings

SHIPPED_BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"

OWN_EFFECT = """
from numba import njit
from mrd_sim.effects import Effect
from mrd_sim.parameter import Parameter

@njit
def kernel(p, state, dt, x, v, a, u, force):
    for k in range(len(force)):
        force[k] += p[0] * x[k]

EFFECT = Effect(
    id="own_spring", title="Spring", stage="structure", equation="F + k x", source="mine",
    parameters=(Parameter("rate", "N/m", 0.0, 0.0, 1e4, "rate"),), typical={"rate": 1e3},
    signature="-", confused_with=("gas_spring",), separated_by="-", kernel=kernel,
)
"""


@pytest.fixture
def client(serve_action):
    return serve_action(diagnoser.Diagnoser, Diagnose, "diagnose")


def test_diagnose_answers_as_the_tool_does(client, recorded, tmp_path):
    effects = ["force_sensor_lag", "gas_spring"]
    handle = client.send(Diagnose.Goal(runs=recorded, model="bingham", effects=effects, output=str(tmp_path / "out")))
    assert handle.accepted
    ended = client.ended(handle)
    assert ended.status == GoalStatus.STATUS_SUCCEEDED
    answer = ended.result
    assert answer.success
    report = json.loads((tmp_path / "out" / "gap_report.json").read_text())
    assert answer.report == str(tmp_path / "out" / "gap_report.html")
    assert (answer.message, answer.verdict) == (report["sentence"], report["verdict"])
    assert list(answer.causes) == [cause["effect"] for cause in report["causes"]] == ["force_sensor_lag"]
    assert list(answer.probability) == [cause["probability"] for cause in report["causes"]]
    assert answer.next_command.startswith("ros2 run mrd_diagnosis apply ")
    assert answer.closed_fraction == report["gap"]["closed_fraction"]["value"] > 0.9
    fractions = [feedback.fraction for feedback in client.feedback]
    assert fractions == sorted(fractions)
    assert fractions
    assert all(feedback.stage for feedback in client.feedback)


def test_bad_input_is_refused_in_one_line(client, recorded, tmp_path):
    for goal, message in (
        (Diagnose.Goal(runs=recorded, model="bingham", effects=["ghost"], output=str(tmp_path)), "unknown effect ghost"),
        (Diagnose.Goal(runs=recorded, model="bingham"), "--output is empty"),
        (Diagnose.Goal(model="bingham", output=str(tmp_path)), ""),
        (Diagnose.Goal(runs=recorded, model="bingham", parameters="no", output=str(tmp_path)), "no: cannot be read"),
        (Diagnose.Goal(runs=recorded, model="bingham", laws="cubic", output=str(tmp_path)), "cubic"),
        (Diagnose.Goal(runs=recorded, model="bingham", bench="no.yaml", output=str(tmp_path)), "no.yaml"),
        (Diagnose.Goal(runs=recorded, model="bingham", effects_folder="nowhere", output=str(tmp_path)), "nowhere"),
    ):
        ended = client.ended(client.send(goal))
        assert ended.status == GoalStatus.STATUS_ABORTED
        assert not ended.result.success
        assert message in ended.result.message
        assert "\n" not in ended.result.message.strip()
        assert ended.result.message


def test_a_goal_has_the_options_of_the_tool(client, recorded, tmp_path, monkeypatch):
    used = {}

    def recording(runs, model, **options):
        used.update(options, runs=runs, model=model, catalogue=set(EFFECTS))
        raise InputError("far enough")

    monkeypatch.setattr(diagnoser, "diagnose", recording)
    monkeypatch.delenv("MRD_BENCH", raising=False)
    (tmp_path / "effects").mkdir()
    (tmp_path / "effects" / "own_spring.py").write_text(OWN_EFFECT)
    bench = tmp_path / "bench.yaml"
    bench.write_text(SHIPPED_BENCH.read_text())
    goal = Diagnose.Goal(
        runs=recorded[:2],
        held_out=recorded[2:],
        model="bingham",
        laws="yield_force=quadratic",
        effects=["own_spring"],
        effects_folder=str(tmp_path / "effects"),
        bench=str(bench),
        seed=7,
        output=str(tmp_path / "out"),
    )
    assert client.ended(client.send(goal)).result.message == "far enough"
    assert [run.name for run in used["runs"]] == ["a", "b"]
    assert [run.name for run in used["held_out"]] == ["c"]
    assert (used["model"], used["laws"], used["effects"], used["seed"]) == (
        "bingham",
        {"yield_force": "quadratic"},
        ("own_spring",),
        7,
    )
    assert used["bench"] == read_settings(bench)
    # Effects of a folder are known during one goal only.
    assert "own_spring" in used["catalogue"]
    assert "own_spring" not in EFFECTS
    goal.laws = goal.bench = goal.effects_folder = ""
    assert client.ended(client.send(goal)).result.message == "far enough"
    assert (used["laws"], used["bench"]) == (None, read_settings(None))


def test_one_at_a_time_and_cancelled_on_request(client, recorded, tmp_path, monkeypatch):
    going, cancelled = threading.Event(), threading.Event()

    def endless(*_arguments, progress, **_options):
        while True:
            going.set()
            cancelled.wait(0.02)
            progress("trying effects", 0.5)

    monkeypatch.setattr(diagnoser, "diagnose", endless)
    goal = Diagnose.Goal(runs=recorded, model="bingham", output=str(tmp_path))
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
