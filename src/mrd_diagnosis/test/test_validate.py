"""Prediction of new runs by a damper as it was fitted."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_base.quantities import per_cent
from mrd_diagnosis import validate, write_validation
from mrd_diagnosis.cli import validate as tool
from mrd_diagnosis.report.validation_page import validation_sentence
from mrd_runs import Run, read_run, read_runs
from mrd_sim.damper import Damper

NOISE = 2.0
PARAMETERS = {"yield_force": 60.0, "yield_force_per_A": 800.0, "viscous": 700.0}


def run(name, seed, parameters=PARAMETERS, stroke=8e-3, offset=0.0, gain=0.0, rate=500.0, seconds=4.0):
    """Record a Bouc-Wen damper along two sines at a current that steps."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    w, phase = 2 * np.pi * np.array([[0.9], [2.7]]), rng.uniform(0, 6, (2, 1))
    size = np.array([[stroke], [0.3 * stroke]])
    x, v = (size * np.sin(w * t + phase)).sum(axis=0), (size * w * np.cos(w * t + phase)).sum(axis=0)
    current = np.where(t < 0.5 * seconds, 0.1, 0.4)
    force = Damper("bouc_wen", parameters).force(t, x, current)
    return Run(name, t, x, v, current, (1 + gain) * force + offset + rng.normal(0, NOISE, len(t)))


@pytest.fixture(scope="module")
def damper():
    return Damper("bouc_wen", PARAMETERS)


def test_a_true_damper_predicts_new_runs_down_to_the_noise(damper):
    found = validate(damper, [run("a", 1), run("b", 2)])
    assert found.nrmse == pytest.approx(found.noise_floor, rel=0.25)
    assert found.rmse == pytest.approx(NOISE, rel=0.25)
    assert "hardly more than noise" in validation_sentence(found)
    assert not found.fitted_known


def test_a_wrong_parameter_is_seen_and_nothing_is_fitted(damper):
    wrong = Damper("bouc_wen", PARAMETERS | {"viscous": 1100.0})
    found = validate(wrong, [run("a", 1), run("b", 2)])
    assert found.nrmse > 3 * found.noise_floor
    assert (found.damper.theta == wrong.theta).all()
    sentence = validation_sentence(found)
    assert "hardly more" not in sentence
    # What lies somewhere is a share of the excess; where there is none, no place is named.
    assert "of the error beyond noise" in sentence
    near = replace(found, nrmse=1.3 * found.noise_floor)
    assert "hardly more" not in validation_sentence(near)
    noise = validation_sentence(replace(found, nrmse=1.2 * found.noise_floor))
    assert "hardly more than noise" in noise
    assert "of the error" not in noise


@pytest.mark.parametrize("asked", [{}, {"offsets": True}, {"gains": True}, {"offsets": True, "gains": True}])
def test_offset_and_gain_are_taken_out_only_where_asked_for(damper, asked):
    measured = run("a", 3, offset=40.0, gain=0.1)
    (found,) = validate(damper, [measured], **asked).runs
    if asked.get("offsets") and asked.get("gains"):
        assert found.offset == pytest.approx(40.0, abs=2.0)
        assert found.gain == pytest.approx(0.1, abs=0.01)
        assert found.result.metrics.rmse == pytest.approx(NOISE, rel=0.3)
    if not asked.get("offsets"):
        assert found.offset == 0.0
    if not asked.get("gains"):
        assert found.gain == 0.0


def test_what_exceeds_the_fitted_runs_is_said(damper):
    fitted = [run("fitted", 1)]
    near, far = run("near", 2), run("far", 3, stroke=20e-3)
    found = validate(damper, [near, far], fitted=fitted)
    assert found.fitted_known
    assert not found.runs[0].exceeds
    assert "stroke" in found.runs[1].exceeds
    assert "far (stroke" in validation_sentence(found)


@given(st.floats(0.01, 100.0))
def test_the_relative_error_does_not_depend_on_the_unit_of_force(scale):
    measured = run("a", 5, seconds=2.0)
    wrong = {"yield_force": 66.0, "yield_force_per_A": 800.0, "viscous": 700.0}
    reference = validate(Damper("bouc_wen", wrong), [measured], offsets=True, gains=True)
    other = replace(measured, force=measured.force * scale)
    found = validate(Damper("bouc_wen", wrong), [other], offsets=True, gains=True)
    # A gain in force is taken out with the gain error, so that the error over the force stays the same.
    assert found.nrmse == pytest.approx(reference.nrmse, rel=0.02)


def test_no_runs_are_refused(damper):
    with pytest.raises(InputError, match="runs is empty, expected at least one run"):
        validate(damper, [])


@pytest.fixture
def files(tmp_path):
    """A plant.yaml of the damper, and two recordings."""
    plant = tmp_path / "plant.yaml"
    values = ", ".join(f"{name}: {value}" for name, value in PARAMETERS.items())
    plant.write_text(f'plant:\n  ros__parameters:\n    damper:\n      model: bouc_wen\n      parameters: "{{{values}}}"\n')
    recorded = []
    for seed in (1, 2):
        measured = run(f"run{seed}", seed)
        path = tmp_path / f"run{seed}.csv"
        table = np.stack([measured.time, measured.position, measured.current, measured.force], axis=1)
        np.savetxt(path, table, delimiter=",", header="time_s,position_m,current_A,force_N", comments="")
        recorded.append(str(path))
    return str(plant), recorded


def test_a_run_to_which_the_damper_was_fitted_is_no_proof(damper):
    fitted = [run("a", 1), run("b", 2)]
    found = validate(damper, [fitted[1], run("c", 3)], fitted=fitted)
    assert [validated.was_fitted for validated in found.runs] == [True, False]
    assert "The damper was fitted to b; that error says nothing about new runs." in validation_sentence(found)
    assert "was fitted to all of them" in validation_sentence(validate(damper, fitted, fitted=fitted))


def test_a_run_that_was_fitted_is_known_without_its_start(damper, files):
    _, (first, second) = files
    whole, part, other = read_run(first), read_runs([first], 0.5)[0], read_run(second)
    assert len(part) < len(whole)
    found = validate(damper, [part, other], fitted=[whole])
    assert [validated.was_fitted for validated in found.runs] == [True, False]
    made = [replace(each, info={}) for each in (whole, part)]
    assert validate(damper, made[1:], fitted=made[:1]).runs[0].was_fitted


def test_a_limit_is_for_runs_that_were_not_fitted(files, tmp_path, monkeypatch, capsys):
    plant, (first, second) = files
    monkeypatch.setattr(tool, "fitted_sources", lambda _: [first, "gone.csv", first])
    arguments = ["--limit", "20", "--output", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["validate", plant, first, second, *arguments])
    tool.work()
    printed = capsys.readouterr().out
    assert "The damper was fitted to run1; that error says nothing about new runs." in printed
    assert "may not go beyond them: gone.csv." in printed
    content = json.loads((tmp_path / "out" / "validation.json").read_text())
    (of_new,) = (entry["nrmse"] for entry in content["runs"] if not entry["was_fitted"])
    assert f"Within the limit of 20 %: {per_cent(of_new)} on the runs that were not fitted." in printed
    monkeypatch.setattr(sys, "argv", ["validate", plant, first, *arguments])
    with pytest.raises(InputError, match="was fitted to all of these runs"):
        tool.work()


@pytest.mark.parametrize(("limit", "status"), [("20", None), ("0.1", 1)])
def test_the_tool_passes_or_fails_by_its_limit(files, tmp_path, monkeypatch, capsys, limit, status):
    plant, recorded = files
    arguments = ["validate", plant, *recorded, "--limit", limit, "--output", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", arguments)
    if status is None:
        tool.work()
    else:
        with pytest.raises(SystemExit) as raised:
            tool.work()
        assert raised.value.code == status
    printed = capsys.readouterr().out
    assert ("Within the limit" if status is None else "Above the limit") in printed
    content = json.loads((tmp_path / "out" / "validation.json").read_text())
    assert [entry["name"] for entry in content["runs"]] == ["run1", "run2"]
    assert content["runs"][0]["exceeds"] is None
    page = (tmp_path / "out" / "validation.html").read_text()
    assert "run1" in page
    assert "not known" in page


def test_a_limit_that_is_no_error_is_refused(files, tmp_path, monkeypatch):
    plant, recorded = files
    monkeypatch.setattr(sys, "argv", ["validate", plant, *recorded, "--limit", "-1", "--output", str(tmp_path / "out")])
    with pytest.raises(InputError, match="--limit is -1, expected a positive number"):
        tool.work()


def test_the_page_is_written_for_a_library_user_too(damper, tmp_path):
    page = write_validation(validate(damper, [run("a", 1)]), tmp_path)
    assert page.name == "validation.html"
    assert page.stat().st_size < 8e6
