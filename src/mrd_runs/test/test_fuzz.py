"""The fuzzer of the readers runs and finds nothing in a short time; a long run of it is a part of a release."""

import subprocess
import sys
from pathlib import Path

import pytest

FUZZER = Path(__file__).resolve().parents[3] / "fuzz/readers.py"


@pytest.mark.timeout(240)
def test_some_changed_inputs(tmp_path: Path) -> None:
    command = [sys.executable, FUZZER, "--count", "60", "--seconds", "3", "--failures", tmp_path / "failures"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, timeout=220)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    recordings, foreign = ["csv", "mcap", "db3", "yaml", "recover"], ["text", "xlsx", "mat", "h5", "tdms"]
    others = ["replies", "experiment", "control", "goal", "bench", "plant", "fit", "gap_report", "run_info"]
    assert [line.split()[0] for line in lines] == [*recordings, *foreign, *others]
    assert all(int(line.split()[1]) > 0 for line in lines)
    assert not (tmp_path / "failures").exists()


def test_failures_are_found(tmp_path: Path) -> None:
    """With a reader that raises another error for a certain line, the fuzzer fails and keeps the input."""
    code = f"""
import runpy, sys
import mrd_runs.formats.csv_file as csv_file

sys.path.insert(0, {str(FUZZER.parent)!r})
sys.argv = ["readers.py", "--targets", "csv", "--count", "1500", "--failures", {str(tmp_path / "failures")!r}]
read_csv = csv_file.read_csv

def fail(path, *columns):
    if b"nan" in path.read_bytes():
        raise KeyError("planted")
    return read_csv(path, *columns)

csv_file.read_csv = fail
runpy.run_path({str(FUZZER)!r}, run_name="__main__")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=110)
    assert done.returncode == 1, done.stderr
    assert "KeyError: 'planted'" in done.stderr
    (kept,) = (tmp_path / "failures").iterdir()
    assert b"nan" in kept.read_bytes()
