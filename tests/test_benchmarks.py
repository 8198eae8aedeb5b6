"""The benchmarks fit the packages that they measure; `make bench` runs them."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


@pytest.mark.parametrize("script", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_each_benchmark_can_be_imported(script: str) -> None:
    done = subprocess.run([sys.executable, "-c", f"import {script}"], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
