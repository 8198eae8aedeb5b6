"""An exported model gives the same force as the fitted one."""

import ctypes
import io
import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_identification import identify, load_damper, write_fit
from mrd_identification.cli import export as cli
from mrd_identification.export import export_damper
from mrd_runs import Run
from mrd_runs.signals.smoothed_run import smooth_run
from mrd_sim import effects
from mrd_sim.models import find_model
from mrd_sim.path import make_path, run_path

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc)")


@pytest.fixture(scope="module")
def run():
    time = np.arange(1500) / 500
    w, u = 2 * np.pi * 1.3, 2 * np.pi * 4.1
    x = 0.008 * np.sin(w * time) + 0.002 * np.sin(u * time)
    v = 0.008 * w * np.cos(w * time) + 0.002 * u * np.cos(u * time)
    a = -0.008 * w**2 * np.sin(w * time) - 0.002 * u**2 * np.sin(u * time)
    current = np.where(time % 1 < 0.5, 0.1, 0.5)
    model = find_model("bingham")
    force = model.force(model.defaults, make_path(time, x, v, a, current))
    return Run("run", time, x, v, current, force + 5 * np.random.default_rng(1).standard_normal(len(time)))


@pytest.fixture(scope="module")
def fit(run):
    """A fit with current laws that are not the default ones of the model."""
    return identify(
        [run],
        "bingham",
        laws={"yield_force": "tanh", "viscous": "quadratic"},
        population=20,
        generations=3,
        seeds=1,
        profile=False,
    )


@pytest.fixture(scope="module")
def path(fit, tmp_path_factory):
    return write_fit(fit, tmp_path_factory.mktemp("fit"))


def test_the_callable_gives_the_force_of_the_fit(fit, path, run):
    expected = fit.model.force(fit.model.vector(fit.values), run_path(smooth_run(run)))
    force = load_damper(path).force
    assert np.ptp(expected) > 100.0
    assert np.allclose(force(run.time, run.position, run.current), expected, rtol=0, atol=1e-9 * np.ptp(expected))
    with pytest.raises(InputError, match="1500 times, 1500 positions, 1 currents, expected as many of each"):
        force(run.time, run.position, run.current[:1])


def test_the_callable_gives_the_same_force_block_by_block(path, run):
    damper, whole = load_damper(path), load_damper(path)
    series = run.position, run.velocity, np.zeros(len(run)), run.current
    blocks = [damper.advance(1 / 500, *(s[k : k + 100] for s in series)) for k in range(0, len(run), 100)]
    assert np.allclose(np.concatenate(blocks), whole.advance(1 / 500, *series), atol=1e-8)


@needs_compiler
def test_c_file_gives_the_force_of_the_fit(fit, path, run, tmp_path):
    export_damper(path, tmp_path / "damper.c", prefix="front")
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Werror", "-fPIC", "-shared", "damper.c", "-o", "damper.so", "-lm"],
        cwd=tmp_path,
        check=True,
    )
    library = ctypes.CDLL(tmp_path / "damper.so")
    library.front_step.restype = ctypes.c_double
    library.front_step.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 5]
    path_of_rows = make_path(run.time, run.position, run.velocity, 0 * run.time, run.current)
    state = ctypes.create_string_buffer(8 * (len(fit.model.parameters) + len(fit.model.initial_state(path_of_rows)) + 5))
    library.front_init(state)
    rows = np.stack([np.diff(run.time, prepend=0.0), run.position, run.velocity, 0 * run.time, run.current], axis=1)
    force = np.array([library.front_step(state, *row) for row in rows.tolist()])
    expected = fit.model.force(fit.model.vector(fit.values), path_of_rows)
    assert np.abs(force - expected).max() <= 1e-9 * np.abs(expected).max()


@needs_compiler
def test_the_tool_writes_an_fmu(fit, path, tmp_path, monkeypatch, capsys):
    output = tmp_path / "damper.fmu"
    monkeypatch.setattr(sys, "argv", ["export", str(path), "--output", str(output)])
    cli.work()
    assert capsys.readouterr().out == f"{output}: bingham, {len(fit.model.parameters)} parameters (FMI 2.0)\n"
    with zipfile.ZipFile(io.BytesIO(output.read_bytes())) as archive:
        text = archive.read("modelDescription.xml").decode()
        assert archive.testzip() is None
    for name, value in fit.values.items():
        assert f'name="{name}"' in text
        assert f'start="{value!r}"' in text


def test_what_cannot_be_exported_is_refused(path, tmp_path):
    with pytest.raises(InputError, match=r"damper\.slx: expected a name that ends in \.c .* or \.fmu"):
        export_damper(path, tmp_path / "damper.slx")
    export_damper(path, tmp_path / "damper.c")
    with pytest.raises(InputError, match=r"damper\.c: exists already; choose another name"):
        export_damper(path, tmp_path / "damper.c")
    with pytest.raises(InputError, match=r"nowhere/damper\.c: cannot be written"):
        export_damper(path, tmp_path / "nowhere" / "damper.c")
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        export_damper(tmp_path / "none.json", tmp_path / "other.c")
    content = json.loads(path.read_text())
    content["model"] = "bingam"
    (tmp_path / "fit.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"fit\.json: unknown model bingam"):
        load_damper(tmp_path / "fit.json")


GAP = {
    "schema": "mrd-gap/5",
    "verdict": "explained",
    "model": "bingham",
    "laws": {},
    "corrected": {"effects": ["gas_spring"], "parameters": {"viscous": 1234.0, "gas_spring.stiffness": 500.0}},
}
PLANT = """\
/**/plant:
  ros__parameters:
    damper:
      model: bingham
      parameters: "viscous: 1234.0"
      effects: "gas_spring: {stiffness: 500.0}"
"""


@pytest.fixture(params=["gap_report.json", "corrected.yaml"])
def corrected(request, tmp_path):
    """A corrected simulator in each of its files."""
    file = tmp_path / request.param
    file.write_text(json.dumps(GAP) if file.suffix == ".json" else PLANT)
    return file


def test_a_corrected_simulator_is_read_with_its_effects(corrected):
    damper = load_damper(corrected)
    found = dict(zip(damper.model.names, damper.theta, strict=True))
    assert damper.description == "bingham with gas_spring"
    assert (found["viscous"], found["gas_spring.stiffness"]) == (1234.0, 500.0)


def test_effects_are_left_out_of_an_export_only_where_that_is_asked_for(corrected, tmp_path):
    for without_effects, description in ((False, "bingham with gas_spring"), (True, "bingham")):
        file = tmp_path / f"{description}.c"
        assert export_damper(corrected, file, without_effects=without_effects).damper.description == description
        assert '{"viscous", "N s/m", 1234' in file.read_text()
        assert ('{"gas_spring.stiffness", "N/m", 500.0, ' in file.read_text()) is not without_effects


def test_an_effect_of_the_users_own_that_has_no_translation_is_refused_in_one_line(tmp_path, monkeypatch):
    own = (Path(effects.__file__).parent / "gas_spring.py").read_text().replace('id="gas_spring"', 'id="own_spring"')
    folder, plant, output = tmp_path / "own", tmp_path / "plant.yaml", tmp_path / "damper.c"
    folder.mkdir()
    (folder / "own_spring.py").write_text(own.replace("in range(len(x)):", "in list(range(len(x))):"))
    plant.write_text(PLANT.replace("gas_spring", "own_spring"))
    for catalogue in ("EFFECTS", "EFFECT_FOLDERS"):
        monkeypatch.setattr(effects, catalogue, dict(getattr(effects, catalogue)))
    arguments = ["export", str(plant), "--effects-folder", str(folder), "--output", str(output)]
    monkeypatch.setattr(sys, "argv", arguments)
    line = 1 + own[: own.index("in range(len(x)):")].count("\n")
    with pytest.raises(InputError, match=rf"own_spring\._apply, line {line}: for k in list.* has no translation to C"):
        cli.work()
    assert not output.exists()


def test_a_diagnosis_that_proves_nothing_is_not_exported(tmp_path):
    report = tmp_path / "gap_report.json"
    for change, message in (
        ({"verdict": "ambiguous"}, "the verdict is ambiguous, so gas_spring is not proven; record the experiment"),
        ({"verdict": "data_fault", "corrected": None}, "the recordings are faulty, so there is nothing to apply"),
        ({"model": "nosuch"}, "gap_report.json: unknown model nosuch"),
        ({"corrected": {}}, "has no field 'parameters', expected a gap_report.json"),
        (
            {"causes": [{"effect": "gas_spring", "probability": 0.42}]},
            "probability of gas_spring is below 50 %, so it is not proven",
        ),
        ({"causes": [{"effect": "coil_lag", "probability": 0.9}]}, "probability of gas_spring is below 50 %"),
    ):
        report.write_text(json.dumps({**GAP, **change}))
        with pytest.raises(InputError, match=message):
            load_damper(report)
    report.write_text(json.dumps({**GAP, "verdict": "no_gap", "causes": []}))
    assert load_damper(report).description == "bingham"
    report.write_text(json.dumps({**GAP, "causes": [{"effect": "gas_spring", "probability": 0.9}]}))
    assert load_damper(report).description == "bingham with gas_spring"
