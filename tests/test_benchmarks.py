"""The benchmarks fit the packages that they measure; `make bench` runs them."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


def test_all_benchmarks_can_be_imported() -> None:
    scripts = ", ".join(sorted(path.stem for path in FOLDER.glob("*.py")))
    done = subprocess.run([sys.executable, "-c", f"import {scripts}"], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_recorder_loses_nothing_in_five_minutes_at_2_khz() -> None:
    """Half an hour of it: `make soak`."""
    command = [sys.executable, "recorder.py", "--duration", "300", "--kills", "1"]
    done = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr
    lost, samples = map(int, re.findall(r"lost: (\d+) of (\d+) samples", done.stdout)[0])
    assert lost == 0
    assert samples > 0.95 * 300 * 2000
    first, last = map(float, re.findall(r"memory: ([\d.]+) MB at first, ([\d.]+) MB at last", done.stdout)[0])
    assert last < first + 10
    assert "latency from the stamp of a block to the recorder: 50 %: " in done.stdout
