"""Fits that know the slow strokes of a characterisation of the same damper."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from mrd_base import InputError
from mrd_characterisation import characterise, write_characterisation
from mrd_identification.cli import identify as tool
from mrd_runs import read_runs

EXAMPLE = Path(__file__).parents[3] / "examples" / "worn_joint"


@pytest.fixture
def characterisation(tmp_path):
    """Recordings with slow strokes, and what was measured in them."""
    folder = tmp_path / "tests"
    shutil.copytree(EXAMPLE, folder)
    return write_characterisation(characterise(read_runs(folder)), tmp_path)[0]


def fitted_runs(monkeypatch, folder, *arguments):
    options = ["--model", "bingham", "--population", "16", "--generations", "2", "--seeds", "1", "--no-profile"]
    monkeypatch.setattr(sys, "argv", ["identify", *arguments, *options, "--output", str(folder / "fit")])
    tool.work()
    return [run["name"] for run in json.loads((folder / "fit" / "fit.json").read_text())["runs"]["fit"]]


def test_the_slow_strokes_are_fitted_too(characterisation, tmp_path, monkeypatch):
    fast, slow = str(EXAMPLE / "4_fast_sine.csv"), str(EXAMPLE / "2_slow_stroke.csv")
    given = ("--characterisation", str(characterisation))
    assert fitted_runs(monkeypatch, tmp_path, fast, *given) == ["4_fast_sine", "2_slow_stroke"]
    # A recording that is given already counts once.
    assert fitted_runs(monkeypatch, tmp_path, fast, slow, *given) == ["4_fast_sine", "2_slow_stroke"]


def test_a_characterisation_without_its_recordings_is_refused(characterisation, tmp_path, monkeypatch):
    shutil.rmtree(tmp_path / "tests")
    with pytest.raises(InputError, match=r"2_slow_stroke is not at .* any more; characterise the runs once more"):
        fitted_runs(monkeypatch, tmp_path, str(EXAMPLE / "4_fast_sine.csv"), "--characterisation", str(characterisation))


def test_a_characterisation_without_slow_strokes_is_refused(tmp_path, monkeypatch):
    fast = EXAMPLE / "3_current_steps.csv"
    path = write_characterisation(characterise(read_runs(fast)), tmp_path)[0]
    with pytest.raises(InputError, match="has no gas force and no seal drag"):
        fitted_runs(monkeypatch, tmp_path, str(EXAMPLE / "4_fast_sine.csv"), "--characterisation", str(path))
