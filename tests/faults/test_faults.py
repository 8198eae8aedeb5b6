"""The fault campaign as a test: a few faults of each family, and all of them in the slow tests."""

import subprocess
import sys
from pathlib import Path

import pytest

from faults.__main__ import FAMILIES

pytestmark = pytest.mark.realtime

FEW = "^(pinion slips|coil: open|serial line: each reply comes after.*|LVDT: unplugged|disk: full|recorder: SIGTERM)$"


def campaign(*options: str, timeout: float) -> str:
    command = [sys.executable, "-m", "faults", *options]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.timeout(150)
def test_some_faults_are_within_their_limits() -> None:
    table = campaign("--rows", FEW, "--moments", "1", timeout=140)
    assert table.count("| ok |") == 6


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_all_faults_are_within_their_limits() -> None:
    table = campaign("--moments", "1", timeout=3500)
    assert table.count("| ok |") == sum(len(family.FAULTS) for family in FAMILIES)


def test_no_two_faults_have_one_name() -> None:
    names = [fault.name for family in FAMILIES for fault in family.FAULTS]
    assert len(set(names)) == len(names) > 50
