"""All tools take runs alike: a folder, a pattern, files, a bag, a folder of bags."""

import sys
from importlib import import_module
from pathlib import Path

import pytest

from mrd_base import InputError
from mrd_cli.cli import mrd
from mrd_runs import read_runs

WORN_JOINT = Path(__file__).resolve().parents[1] / "examples" / "worn_joint"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Two runs as CSV files in one folder, and as bags in another."""
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "csv").mkdir()
    for name in ("2_slow_stroke", "4_fast_sine"):
        (folder / "csv" / f"{name}.csv").symlink_to(WORN_JOINT / f"{name}.csv")
    with pytest.MonkeyPatch.context() as patched:
        call(patched, "import", str(folder / "csv"), "--output", str(folder / "bags"))
    return folder


def call(monkeypatch, tool, *arguments):
    monkeypatch.setattr(sys, "argv", [f"mrd {tool}", *map(str, arguments)])
    module = import_module(mrd.TOOLS[tool].module)
    module.work() if hasattr(module, "work") else module.main()


FORMS = {
    "folder": ["{0}/csv"],
    "pattern": ["{0}/csv/*.csv"],
    "files": ["{0}/csv/2_slow_stroke.csv", "{0}/csv/4_fast_sine.csv"],
    "bags": ["{0}/bags/2_slow_stroke", "{0}/bags/4_fast_sine"],
    "folder of bags": ["{0}/bags"],
}


@pytest.mark.parametrize("form", FORMS)
def test_runs_are_read_in_any_form(form, recordings):
    """By `read_runs`, as `diagnose`, `identify`, `compare`, `validate`, `accept` and `trend` do."""
    runs = read_runs([text.format(recordings) for text in FORMS[form]])
    assert [run.name for run in runs] == ["2_slow_stroke", "4_fast_sine"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("tool", ["info", "simulate", "plot", "characterise"])
def test_a_tool_takes_runs_in_any_form(tool, form, recordings, tmp_path, monkeypatch, capsys):
    options = {"info": [], "simulate": ["--model", "bingham"]}.get(tool, [])
    output = [] if tool == "info" else ["--output", tmp_path / "out"]
    call(monkeypatch, tool, *(text.format(recordings) for text in FORMS[form]), *options, *output)
    if tool == "simulate":
        assert [run.name for run in read_runs(tmp_path / "out")] == ["2_slow_stroke", "4_fast_sine"]
    elif tool == "info":
        printed = capsys.readouterr().out
        assert "2_slow_stroke" in printed
        assert "4_fast_sine" in printed


def test_one_recording_is_simulated_into_one_file(recordings, tmp_path, monkeypatch):
    for name in ("csv/4_fast_sine.csv", "bags/4_fast_sine"):
        output = tmp_path / f"{Path(name).parent}.csv"
        call(monkeypatch, "simulate", recordings / name, "--model", "bingham", "--output", output)
        assert output.is_file()


def test_experiments_and_recordings_are_not_simulated_together(recordings, tmp_path, monkeypatch):
    experiment = WORN_JOINT.with_name("experiments") / "4_fast_sine.yaml"
    with pytest.raises(InputError, match=r"csv: holds no experiment, as other inputs do"):
        call(monkeypatch, "simulate", experiment, recordings / "csv", "--model", "bingham", "--output", tmp_path / "out")
    with pytest.raises(InputError, match="has the name 4_fast_sine, as an experiment before"):
        call(monkeypatch, "simulate", experiment, experiment, "--model", "bingham", "--output", tmp_path / "out")
