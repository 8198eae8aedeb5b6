"""Identification and comparison look at the recordings before they fit them."""

import re
import sys
from dataclasses import replace

import pytest

from mrd_identification.cli import compare, identify
from mrd_runs import read_run
from mrd_sim.models import MODELS
from mrd_sim.models_page import EXAMPLE
from mrd_sim.own import own_catalogue
from mrd_sim.simulate import write_csv


@pytest.fixture
def tool(monkeypatch, capsys, tmp_path):
    def run(module, *arguments):
        output = ["--output", str(tmp_path / "out")]
        monkeypatch.setattr(sys, "argv", ["tool", *arguments, "--population", "8", "--generations", "2", *output])
        try:
            module.main()
        except SystemExit as end:
            return end.code, *capsys.readouterr()
        return 0, *capsys.readouterr()

    return run


@pytest.fixture
def flipped(recorded, tmp_path):
    """The recorded runs with the sign of the force turned."""
    paths = []
    for path in recorded:
        run = read_run(path)
        paths.append(str(tmp_path / f"{run.name}_flipped.csv"))
        write_csv(replace(run, force=-run.force), paths[-1])
    return paths


@pytest.mark.parametrize(("module", "models"), [(identify, ["--model", "bingham"]), (compare, ["--models", "bingham"])])
def test_a_wrong_sign_is_one_line_before_any_fit(tool, flipped, tmp_path, module, models):
    code, text, error = tool(module, *flipped, *models)
    assert (code, text, error.count("\n")) == (3, "", 1)
    assert error.startswith("error: all 3 runs: the damper drives the rod, expected that it resists: ")
    assert error.endswith("or fit them as they are with --anyway\n")
    assert not list(tmp_path.glob("out/**/fit.json"))


def test_a_wrong_sign_can_be_fitted_anyway(tool, flipped, tmp_path):
    code, _, error = tool(identify, *flipped, "--model", "bingham", "--anyway", "--no-profile")
    assert code == 0
    assert error.startswith("warning: all 3 runs: the damper drives the rod")
    assert (tmp_path / "out/fit.json").exists()


def test_models_of_ones_own_are_compared_with_all_others(tool, recorded, tmp_path):
    """The comparison takes all models where none are named; this one would take too long, and says of how many."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "mine.py").write_text(EXAMPLE)
    with own_catalogue():
        code, _, error = tool(compare, *recorded, "--models-folder", str(tmp_path / "own"), "--seeds", "1000000")
    assert code == 2
    assert f"with {len(MODELS) + 1} models" in error


def test_kilonewtons_are_named(tool, recorded, tmp_path):
    run = read_run(recorded[0])
    write_csv(replace(run, force=1e-3 * run.force), str(tmp_path / "kilo.csv"))
    code, _, error = tool(identify, str(tmp_path / "kilo.csv"), "--model", "bingham")
    assert code == 0
    assert "limitation: force: the force spans at most " in error
    assert "If it is in kN or V, convert it to N" in error


def test_what_is_about_to_be_computed_is_said_before(tool, recorded):
    """A pattern such as runs/*/bag easily names other runs, too; all models of ten runs take minutes."""
    code, _, error = tool(compare, *recorded, "--models", "bingham")
    assert code == 0
    assert error.startswith("3 runs in ")
    assert "1 model (--models), each fitted 4 times: to all runs, and without each\n" in error
    code, _, error = tool(compare, *recorded[:2], "--models", "bingham,biviscous", "--held-out", recorded[2])
    assert "2 models (--models), each fitted once\n" in error


def test_every_fault_that_a_diagnosis_finds_stops_a_fit(tool, recorded, tmp_path):
    """A load cell that is not plugged in was fitted without a word."""
    run = read_run(recorded[0])
    write_csv(replace(run, force=0 * run.force + 3.0), str(tmp_path / "dead.csv"))
    code, text, error = tool(identify, str(tmp_path / "dead.csv"), "--model", "bingham")
    assert (code, text, error.count("\n")) == (3, "", 1)
    assert error.startswith("error: dead: force: ")


def test_what_narrows_the_conclusions_is_said_before_the_fit(tool, recorded, tmp_path):
    run = read_run(recorded[0])
    write_csv(replace(run, current=0 * run.current + 0.2), str(tmp_path / "one_current.csv"))
    code, _, error = tool(identify, str(tmp_path / "one_current.csv"), "--model", "bingham", "--no-profile")
    assert code == 0
    assert "limitation: " in error


def test_a_comparison_of_hours_has_to_be_asked_for(monkeypatch, capsys, recorded, tmp_path):
    """The word stands before the work: nothing is fitted, and nothing is written."""
    arguments = [*map(str, recorded), "--generations", "100000", "--output", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", ["compare", *arguments])
    with pytest.raises(SystemExit) as end:
        compare.main()
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert re.search(r"this takes about \d+ min with 16 models; .* or ask for it with --long", said)
    assert not (tmp_path / "out").exists()
