"""The library in a notebook: what it takes, what it refuses in one line, and how its results look."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_diagnosis import diagnose, validate
from mrd_identification import compare, identify
from mrd_runs import make_run, read_runs
from mrd_runs.read import read_groups

EXAMPLE = Path(__file__).parents[3] / "examples" / "worn_joint"
BRIEF = {"population": 8, "generations": 2, "profile": False}


@pytest.fixture(scope="module")
def runs():
    return read_runs(EXAMPLE)


def test_runs_are_read_from_a_folder_a_pattern_and_a_path(runs):
    assert [run.name for run in runs] == ["1_multisine", "2_slow_stroke", "3_current_steps", "4_fast_sine"]
    assert [run.name for run in read_runs(EXAMPLE / "*.csv")] == [run.name for run in runs]
    assert [run.name for run in read_runs(str(EXAMPLE / "4_fast_sine.csv"))] == ["4_fast_sine"]
    assert [run.name for run in read_runs([EXAMPLE])] == [run.name for run in runs]


def test_files_of_other_programs_are_read(runs, tmp_path):
    run = runs[0]
    table = np.stack([run.time, 1e3 * run.position, 1e3 * run.current, 1e-3 * run.force], axis=1)
    for name in ("rig.csv", "rig2.txt"):
        header = "Time [s];Travel [mm];Current [mA];Force [kN]"
        np.savetxt(tmp_path / name, table + (name == "rig2.txt") * 1e-3, delimiter=";", header=header, comments="")
    shutil.copy(EXAMPLE / "2_slow_stroke.csv", tmp_path)
    read = read_runs(tmp_path)
    assert [each.name for each in read] == ["2_slow_stroke", "rig", "rig2"]
    np.testing.assert_allclose(read[1].force, run.force, rtol=1e-9)


def test_groups_keep_their_runs(runs):
    fitted, held_out = read_groups([EXAMPLE / "[123]*.csv", [EXAMPLE / "4_fast_sine.csv"]])
    assert [len(fitted), len(held_out)] == [3, 1]
    with pytest.raises(InputError, match="is the same recording as"):
        read_groups([EXAMPLE, EXAMPLE / "4_fast_sine.csv"])


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda runs: read_runs("a.csv"), "a.csv: no such file or folder"),
        (lambda runs: read_runs("no/*.csv"), "no/*.csv: no file fits this pattern"),
        (lambda runs: read_runs(runs[0]), "paths is the run 1_multisine, expected paths of recordings"),
        (lambda runs: read_runs([3]), "paths holds int, expected paths of recordings"),
        (lambda runs: identify("a.csv", "bingham"), "runs is the path a.csv, expected runs: read_runs('a.csv')"),
        (lambda runs: identify(["a.csv"], "bingham"), "runs holds the path a.csv, expected runs, as read_runs gives them"),
        (lambda runs: identify(None, "bingham"), "runs is NoneType, expected a list of runs"),
        (lambda runs: diagnose([], "bingham"), "runs is empty, expected at least one run"),
        (lambda runs: diagnose(runs, "bingham", reference="b.csv"), "reference is the path b.csv, expected runs"),
        (lambda runs: validate("fit.json", "a.csv"), "runs is the path a.csv"),
        (lambda runs: make_run("a", {}), "a: has no column time_s (columns: none), expected time_s, position_m"),
        (lambda runs: make_run("a", {"time": [1.0]}), "a: has no column time_s (columns: time), expected"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(runs, work, message):
    with pytest.raises(InputError) as error:
        work(runs)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_run_shows_itself(runs):
    assert repr(runs[3]) == "<Run 4_fast_sine: 6.716 s at 250 Hz>"
    assert "peak speed" in runs[3].summary()
    assert "<th>stroke</th>" in runs[3]._repr_html_()
    assert [axis.title.text for axis in runs[3].plot().select_yaxes()] == ["force, N", "position, mm", "current, A"]


def test_a_fit_shows_itself_and_is_judged_on_new_runs(runs):
    fit = identify(runs[3], "bingham", **BRIEF)
    assert repr(fit).startswith("<Fit of <DamperModel bingham> to 1 runs: NRMSE ")
    assert "<td>yield_force</td>" in fit._repr_html_()
    assert fit.validate(runs[:1]).nrmse > fit.pooled.nrmse


def test_a_comparison_shows_itself(runs):
    comparison = compare(runs, ["bingham", "linear_viscous"], **BRIEF)
    assert repr(comparison).startswith("<Comparison of 2 models: bingham is best")
    assert comparison.summary().splitlines()[1].startswith("bingham")
    assert "<td>linear_viscous</td>" in comparison._repr_html_()
    assert len(comparison.plot().data) > 0


def test_a_diagnosis_shows_itself(runs):
    diagnosis = diagnose(runs, "bouc_wen", effects=["joint_play", "seal_friction"])
    assert repr(diagnosis) == "<Diagnosis explained: joint_play>"
    assert diagnosis.summary().startswith(diagnosis.sentence)
    assert "<td>joint_play</td>" in diagnosis._repr_html_()
    assert "joint_play" in diagnosis.plot().data[0].y
