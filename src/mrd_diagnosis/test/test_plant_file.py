"""apply puts all of a diagnosis into the simulator, and says what is not proven."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_diagnosis.cli import apply as apply_tool
from mrd_diagnosis.cli import diagnose as diagnose_tool
from mrd_diagnosis.cli import trend as trend_tool
from mrd_diagnosis.cli.apply import identify_arguments
from mrd_diagnosis.closure.plant_file import write_plant
from mrd_identification.cli import identify as identify_tool
from mrd_identification.correction import Correction, correction
from mrd_runs import Run, read_run
from mrd_sim.cli import simulate as simulate_tool
from mrd_sim.effects import EFFECTS, load_effects
from mrd_sim.models import MODELS, find_model
from mrd_sim.models_page import EXAMPLE
from mrd_sim.own import own_catalogue
from mrd_sim.path import make_path
from mrd_sim.plant import Plant, PlantConfig, read_damper
from mrd_sim.simulate import write_csv

SHIPPED = Path(__file__).parents[3] / "config" / "plant.yaml"


def diagnosed(model="bouc_wen", laws=None, effects=(), seed=0):
    """Return a model with effects, random parameters within their bounds, and these parameters by name."""
    built = find_model(model, laws, effects)
    random = np.random.default_rng(seed)
    theta = np.array([random.uniform(p.lower, p.upper) if p.free else p.default for p in built.parameters])
    return built, theta, dict(zip(built.names, map(float, theta), strict=True))


def corrected(model, effects, verdict="explained", laws=None, **more):
    built, theta, values = diagnosed(model, laws, effects)
    return built, theta, correction(verdict, model, built.laws, values, effects, **more)


@given(
    model=st.sampled_from(list(MODELS)),
    effects=st.lists(st.sampled_from(list(EFFECTS)), max_size=3, unique=True),
    law=st.sampled_from(["", "quadratic", "tanh"]),
)
@settings(max_examples=25)
def test_the_written_simulator_is_the_diagnosed_one(tmp_path_factory, model, effects, law):
    built, theta, made = corrected(model, effects, laws=law)
    output = write_plant(made, SHIPPED, tmp_path_factory.mktemp("apply") / "plant.yaml")
    damper = read_damper(output).build()
    assert damper.model.names == built.names
    assert damper.model.laws == built.laws
    assert np.array_equal(damper.theta, theta)


def test_the_plant_runs_with_the_effect_in_it(tmp_path):
    made = correction("explained", "bingham", {}, {"yield_force": 150.0, "force_sensor_lag.lag": 0.02}, ["force_sensor_lag"])
    config = read_damper(write_plant(made, SHIPPED, tmp_path / "plant.yaml"))
    plant = Plant(PlantConfig(damper=config))
    assert plant.advance(0.1) is not None
    time = np.arange(500) / 500
    path = make_path(time, 5e-3 * np.sin(9 * time), 45e-3 * np.cos(9 * time), -0.405 * np.sin(9 * time), 0.1 + 0 * time)
    model = find_model("bingham", effects=["force_sensor_lag"])
    expected = model.force(model.vector({"yield_force": 150.0, "force_sensor_lag.lag": 0.02}), path)
    assert np.array_equal(plant.damper.model.force(plant.damper.theta, path), expected)
    assert not np.allclose(expected, find_model("bingham").force(find_model("bingham").vector({"yield_force": 150.0}), path))


def test_everything_else_of_the_file_stays(tmp_path):
    _, _, made = corrected("bouc_wen", ["coil_lag", "gas_spring"])
    written = write_plant(made, SHIPPED, tmp_path / "plant.yaml").read_text()
    before = [line for line in SHIPPED.read_text().splitlines() if not line.startswith("        ")]
    for line in before:
        name, marked, comment = line.partition("#")
        assert (comment if marked else line) in written, line
        assert name.split(":")[0] in written
    assert written.splitlines()[0] == (
        "# The damper is bouc_wen with refitted parameters and the effects coil_lag, gas_spring: this explains the gap."
    )
    again = write_plant(made, tmp_path / "plant.yaml", tmp_path / "again.yaml").read_text()
    assert again == f"{written.splitlines()[0]}\n{written}"


@pytest.mark.parametrize(
    "text",
    [
        "/**/plant:\n  ros__parameters:\n    seed: 2  # of noise\n",
        "plant:\n    ros__parameters:\n        damper:\n            laws: tanh\n            parameters: '{viscous: 3.0}'",
        "/**:\n ros__parameters:\n  damper:\n   effects: |-\n    settling: {excess: 0.1}\n\n   # next\n   stroke_mm: 40.0\n",
        "/**:\n  ros__parameters: {seed: 3}\n/**/plant:\n  ros__parameters:\n    damper:\n      model: bingham",
        "plant:\n ros__parameters:\n  damper:\n   model: dahl\n/**/plant:\n ros__parameters:\n  damper:\n   model: dahl",
    ],
)
def test_other_ways_to_write_a_plant(tmp_path, text):
    (tmp_path / "plant.yaml").write_text(text)
    built, theta, made = corrected("bouc_wen", ["coil_lag"])
    output = write_plant(made, tmp_path / "plant.yaml", tmp_path / "corrected.yaml")
    damper = read_damper(output).build()
    assert damper.model.names == built.names
    assert np.array_equal(damper.theta, theta)
    assert read_damper(output).stroke == read_damper(tmp_path / "plant.yaml").stroke


def test_no_gap_applies_the_parameters_alone():
    _, _, made = corrected("bouc_wen", [], "no_gap")
    assert made.effects == {}
    assert made.remark.endswith("the diagnosis found no missing effect.")


def test_a_part_of_the_gap_is_applied_and_said_to_be_one(tmp_path):
    built, theta, made = corrected("bouc_wen", ["coil_lag"], "partly_explained", closed_fraction=0.38)
    output = write_plant(made, SHIPPED, tmp_path / "plant.yaml")
    assert output.read_text().startswith(
        "# The damper is bouc_wen with refitted parameters and the effect coil_lag: this explains 38 % of the gap; "
        "62 % stays open.\n"
    )
    damper = read_damper(output).build()
    assert damper.model.names == built.names
    assert np.array_equal(damper.theta, theta)
    _, _, made = corrected("bouc_wen", ["coil_lag"], "partly_explained")
    assert made.remark.endswith("this explains a part of the gap; the rest stays open.")


def test_apply_takes_the_share_from_the_report(tmp_path, monkeypatch, capsys):
    _, _, values = diagnosed("bingham", effects=["force_sensor_lag"])
    gap = {"closed_fraction": {"value": 0.38, "ci95": [0.3, 0.4]}}
    report = {"verdict": "partly_explained", "model": "bingham", "laws": find_model("bingham").laws, "gap": gap}
    report |= {"corrected": {"parameters": values, "effects": ["force_sensor_lag"]}, "runs": {"reference": []}}
    monkeypatch.setattr(apply_tool, "read_gap_report", lambda path: report)
    monkeypatch.setattr("sys.argv", ["apply", "-", "--plant", str(SHIPPED), "--output", str(tmp_path / "plant.yaml")])
    apply_tool.work()
    assert "force_sensor_lag: this explains 38 % of the gap; 62 % stays open." in capsys.readouterr().out
    assert "62 % stays open" in (tmp_path / "plant.yaml").read_text().splitlines()[0]


def test_what_is_not_proven_needs_anyway():
    for verdict in ("ambiguous", "unknown_effect"):
        with pytest.raises(InputError, match=rf"^gap\.json: the verdict is {verdict}, so coil_lag is not proven; .*--any"):
            corrected("bouc_wen", ["coil_lag"], verdict, where="gap.json")
        _, _, made = corrected("bouc_wen", ["coil_lag"], verdict, anyway=True)
        assert list(made.effects) == ["coil_lag"]
        assert "NOT proven" in made.remark
    with pytest.raises(InputError, match="recordings are faulty"):
        corrected("bouc_wen", [], "data_fault", anyway=True)
    with pytest.raises(InputError, match=r"the verdict is unknown_effect, so no effect is known .*; .*--anyway"):
        corrected("bouc_wen", [], "unknown_effect")
    _, _, made = corrected("bouc_wen", [], "unknown_effect", anyway=True)
    assert made.effects == {}
    assert made.remark == "The damper is bouc_wen with refitted parameters: an effect is missing that is NOT known."


@pytest.mark.parametrize("causes", [{"coil_lag": 0.42}, {"gas_spring": 0.9}, {}])
def test_a_cause_that_is_not_named_or_rather_improbable_needs_anyway(causes):
    for verdict in ("explained", "partly_explained"):
        with pytest.raises(InputError, match=r"^gap\.json: the probability of coil_lag is below 50 %, .*--anyway"):
            corrected("bouc_wen", ["coil_lag"], verdict, causes=causes, where="gap.json")
        _, _, made = corrected("bouc_wen", ["coil_lag"], verdict, causes=causes, anyway=True)
        assert "NOT proven" in made.remark
    _, _, made = corrected("bouc_wen", ["coil_lag"], causes={"coil_lag": 0.95})
    assert "explains the gap" in made.remark


def test_effects_of_the_user_go_with_their_folder(tmp_path, user_effects):
    laws = find_model("bingham").laws
    made = Correction("bingham", laws, {}, {"own_spring": {"rate": 500.0}}, "-")
    load_effects(user_effects)
    output = write_plant(made, SHIPPED, tmp_path / "plant.yaml")
    del EFFECTS["own_spring"]
    assert read_damper(output).build().theta[-1] == 500.0
    assert identify_arguments(made) == f"--model bingham --effects-folder {user_effects} --effect own_spring"


def test_the_command_that_is_advised_for_a_model_of_the_user_does(recorded, tmp_path, monkeypatch, capsys):
    """diagnose, and then apply as diagnose advises it, each as in a process of its own."""
    (tmp_path / "my models").mkdir()
    (tmp_path / "my models" / "mine.py").write_text(EXAMPLE)
    arguments = ["--models-folder", str(tmp_path / "my models"), "--model", "asymmetric_bingham"]
    arguments += ["--effects", "force_sensor_lag,gas_spring", "--output", str(tmp_path / "gap")]
    monkeypatch.setattr("sys.argv", ["mrd diagnose", *recorded, *arguments])
    with own_catalogue():
        diagnose_tool.work()
    advised = capsys.readouterr().out.partition("next command: ")[2].partition("\n")[0]
    assert advised.startswith("mrd apply ")
    plant = str(tmp_path / "corrected.yaml")
    words = shlex.split(advised.replace("PLANT.yaml", str(SHIPPED)).replace("CORRECTED.yaml", plant))
    monkeypatch.setattr("sys.argv", ["mrd apply", *words[2:]])
    with own_catalogue():
        apply_tool.work()
    with own_catalogue():
        damper = read_damper(plant).build()
        assert damper.description == "asymmetric_bingham with force_sensor_lag"
        assert "--model asymmetric_bingham --models-folder" in capsys.readouterr().out
    assert "asymmetric_bingham" not in MODELS


def test_effects_of_the_user_are_identified(tmp_path, user_effects, monkeypatch):
    time = np.arange(1000) / 250
    x, v, a = (9e-3 * w * np.sin(4 * time + phase) for w, phase in ((1, 0), (4, np.pi / 2), (16, np.pi)))
    damper = find_model("bingham")
    force = damper.force(damper.vector({"coil_lag": 0.0}), make_path(time, x, v, a, np.full(1000, 0.2))) + 800.0 * x
    write_csv(Run("a", time, x, v, np.full(1000, 0.2), force), str(tmp_path / "a.csv"))
    arguments = [str(tmp_path / "a.csv"), "--model", "bingham", "--generations", "3", "--no-profile"]
    folder = ["--effects-folder", str(user_effects), "--effect", "own_spring", "--output", str(tmp_path / "fit")]
    monkeypatch.setattr("sys.argv", ["identify", *arguments, *folder, "--scheduler", "tcp://nowhere:1"])
    with pytest.raises(InputError, match="do not know the effects of --effects-folder"):
        identify_tool.work()
    monkeypatch.setattr("sys.argv", ["identify", *arguments, *folder])
    identify_tool.work()
    stored = json.loads((tmp_path / "fit" / "fit.json").read_text())
    assert stored["parameters"]["own_spring.rate"]["value"] == pytest.approx(800.0, rel=0.02)


def test_unusable_files_are_refused_in_one_line(tmp_path):
    _, _, made = corrected("bouc_wen", [])
    (tmp_path / "flow.yaml").write_text("plant: {ros__parameters: {damper: {model: bingham}}}")
    with pytest.raises(InputError, match="section damper cannot be edited"):
        write_plant(made, tmp_path / "flow.yaml", tmp_path / "out.yaml")
    assert not (tmp_path / "out.yaml").exists()
    (tmp_path / "out.yaml").touch()
    with pytest.raises(InputError, match=r"out\.yaml: exists already"):
        write_plant(made, SHIPPED, tmp_path / "out.yaml")
    with pytest.raises(InputError, match="cannot be written"):
        write_plant(made, SHIPPED, tmp_path / "nowhere" / "out.yaml")
    (tmp_path / "elsewhere.yaml").write_text("/bench/plant: {ros__parameters: {seed: 1}}")
    with pytest.raises(InputError, match=r"elsewhere\.yaml: found the sections /bench/plant, expected plant or"):
        write_plant(made, tmp_path / "elsewhere.yaml", tmp_path / "new.yaml")
    (tmp_path / "other.yaml").write_text("damper: {model: bingham}")
    with pytest.raises(InputError, match="expected a parameter file"):
        write_plant(made, tmp_path / "other.yaml", tmp_path / "new.yaml")


def test_the_tool_from_report_to_simulation(recorded, tmp_path, monkeypatch, capsys):
    """diagnose, apply and simulate in turn give the recorded force again."""

    def call(tool, *arguments):
        monkeypatch.setattr("sys.argv", [tool.__name__, *map(str, arguments)])
        tool.main()
        return capsys.readouterr().out

    printed = call(
        diagnose_tool, *recorded, "--model", "bingham", "--effects", "force_sensor_lag,gas_spring", "--output", tmp_path
    )
    report = tmp_path / "gap_report.json"
    sentence = json.loads(report.read_text())["sentence"]
    assert printed.startswith(sentence)
    assert "force_sensor_lag" in printed.removeprefix(sentence)
    assert printed.rstrip().endswith(str(report))
    printed = call(apply_tool, report, "--plant", SHIPPED, "--output", tmp_path / "plant.yaml")
    assert "bingham with refitted parameters and the effect force_sensor_lag: this explains the gap." in printed
    assert "identify RUN... --model bingham --effect force_sensor_lag --output" in printed
    call(simulate_tool, recorded[0], "--plant", tmp_path / "plant.yaml", "--output", tmp_path / "again.csv")
    measured, again = read_run(recorded[0]).force, read_run(tmp_path / "again.csv").force
    assert np.sqrt(np.mean((measured - again)[100:] ** 2)) < 2.0
    printed = call(trend_tool, *recorded, "--report", report, "--output", tmp_path)
    # The true lag is 20 ms; the runs were made without vertices between their samples, which are 4 ms apart.
    assert printed.startswith("force_sensor_lag.lag shows no trend from run 1 to run 3: its mean is 20.1 ms")
