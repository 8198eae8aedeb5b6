"""The benchmarks fit the packages that they measure; `make bench` runs them."""

import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "benchmarks"


def test_all_benchmarks_can_be_imported() -> None:
    scripts = ", ".join(sorted(path.stem for path in FOLDER.glob("*.py")))
    done = subprocess.run([sys.executable, "-c", f"import {scripts}"], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
