"""The diagnoser node: results, options and messages of the tool. `test_analysis_node.py` tests what all analyses share."""

import json
import re
from pathlib import Path

import pytest
from action_msgs.msg import GoalStatus

from mrd_base import InputError
from mrd_diagnosis.cli import diagnose as diagnose_tool
from mrd_diagnosis.nodes import diagnoser
from mrd_interfaces.action import Diagnose
from mrd_runs import read_run
from mrd_sim.effects import EFFECTS
from mrd_sim.models import MODELS
from mrd_sim.models_page import EXAMPLE
from mrd_trajectory.settings import read_settings

SHIPPED_BENCH = Path(__file__).parents[3] / "config" / "bench.yaml"


@pytest.fixture
def client(serve_action, user_effects, tmp_path):
    trusted = f"trusted_folders:={user_effects}:{tmp_path}"
    return serve_action(diagnoser.Diagnoser, Diagnose, "diagnose", "--ros-args", "-p", trusted)


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
        (Diagnose.Goal(model="bingham", output=str(tmp_path)), "no samples were heard"),
        (Diagnose.Goal(runs=recorded, model="bingham", parameters="no", output=str(tmp_path)), "no: cannot be read"),
        (Diagnose.Goal(runs=recorded, model="bingham", laws="cubic", output=str(tmp_path)), "cubic"),
        (Diagnose.Goal(runs=recorded, model="bingham", bench="no.yaml", output=str(tmp_path)), "no.yaml"),
        (Diagnose.Goal(runs=recorded, model="bingham", reference=["no.csv"], output=str(tmp_path)), "no.csv"),
        (
            Diagnose.Goal(runs=recorded, model="bingham", force_filters=["z=lowpass:5"], output=str(tmp_path)),
            "name of a run",
        ),
        (Diagnose.Goal(runs=recorded, model="bingham", skip=-1.0, output=str(tmp_path)), "skip is -1 s"),
        (Diagnose.Goal(runs=recorded, model="bingham", effects_folder="nowhere", output=str(tmp_path)), "nowhere"),
    ):
        why = client.failure(goal)
        assert message in why
        assert "\n" not in why.strip()


def test_a_goal_executes_nothing_that_the_node_was_not_started_with(client, recorded, tmp_path):
    strange = tmp_path / "strange"
    strange.mkdir()
    (strange / "effect.py").write_text(f"open({str(tmp_path / 'executed')!r}, 'w')")
    goal = Diagnose.Goal(runs=recorded, model="bingham", effects_folder=str(strange), output=str(tmp_path / "out"))
    assert client.failure(goal).startswith(f"effects_folder is {strange}: its files are executed, so a goal may only name")
    assert not (tmp_path / "executed").exists()


def test_a_goal_has_the_options_of_the_tool(client, recorded, tmp_path, monkeypatch, user_effects):
    used = {}

    def recording(runs, model, **options):
        used.update(options, runs=runs, model=model, catalogue={*EFFECTS, *MODELS})
        raise InputError("far enough")

    monkeypatch.setattr(diagnoser, "diagnose", recording)
    monkeypatch.delenv("MRD_BENCH", raising=False)
    (tmp_path / "mine.py").write_text(EXAMPLE)
    bench = tmp_path / "bench.yaml"
    bench.write_text(SHIPPED_BENCH.read_text())
    goal = Diagnose.Goal(
        runs=recorded[:2],
        held_out=recorded[2:],
        reference=recorded[:1],
        skip=0.5,
        force_filters=["lowpass:20", "b=average:0.02"],
        model="asymmetric_bingham",
        laws="friction_in=quadratic",
        effects=["own_spring"],
        effects_folder=str(user_effects),
        models_folder=str(tmp_path),
        bench=str(bench),
        seed=7,
        output=str(tmp_path / "out"),
    )
    assert client.ended(client.send(goal)).result.message == "far enough"
    assert [run.name for run in used["runs"]] == ["a", "b"]
    assert [run.name for run in used["held_out"]] == ["c"]
    assert [run.name for run in used["reference"]] == ["a"]
    groups = (used["runs"], used["held_out"], used["reference"])
    words = [[run.info["force_filter"] for run in group] for group in groups]
    assert words == [["lowpass:20", "average:0.02"], ["lowpass:20"], ["lowpass:20"]]
    assert all(len(run) < len(read_run(run.info["source"])) for group in groups for run in group)
    assert (used["model"], used["laws"], used["effects"], used["seed"]) == (
        "asymmetric_bingham",
        {"friction_in": "quadratic"},
        ("own_spring",),
        7,
    )
    assert used["bench"] == read_settings(bench)
    # Effects and models of a folder are known during one goal only.
    assert {"own_spring", "asymmetric_bingham"} <= used["catalogue"]
    assert "own_spring" not in EFFECTS
    assert "asymmetric_bingham" not in MODELS
    assert client.failure(Diagnose.Goal(runs=recorded, model="asymmetric_bingham")).startswith("unknown model")
    goal.laws = goal.bench = goal.effects_folder = goal.models_folder = ""
    goal.model = "bingham"
    assert client.ended(client.send(goal)).result.message == "far enough"
    assert (used["laws"], used["bench"]) == (None, read_settings(None))


def test_every_option_of_the_tool_is_a_field_of_the_goal(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["diagnose", "--help"])
    with pytest.raises(SystemExit):
        diagnose_tool.main()
    options = set(re.findall(r"^  --([\w-]+)", capsys.readouterr().out, re.MULTILINE))
    assert {"reference", "law", "bench"} <= options
    renamed = {"law": "laws", "force-filter": "force_filters"}
    # A simulator is a program: nobody may start one on this machine by a message.
    options -= {"simulator", "inputs", "output-variable", "simulator-limit", "set", "free"}
    # A goal names all of its recordings, the slow strokes among them.
    options -= {"characterisation"}
    fields = {renamed.get(option, option.replace("-", "_")) for option in options}
    assert fields <= set(Diagnose.Goal.get_fields_and_field_types())


def test_a_diagnosis_ends_when_its_goal_is_cancelled(client, recorded, tmp_path, user_effects):
    goal = Diagnose.Goal(runs=recorded, model="bingham", effects_folder=str(user_effects), output=str(tmp_path / "out"))
    handle = client.send(goal)
    client.until(lambda: client.feedback)
    handle.cancel_goal_async()
    assert client.ended(handle).status == GoalStatus.STATUS_CANCELED
    assert list((tmp_path / "out").iterdir()) == []
    assert "own_spring" not in EFFECTS
