"""The fault campaign as a test: a few faults of each family, and all of them in the slow tests."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from faults.__main__ import FAMILIES
from faults.broken_machine import BrokenMachine
from faults.campaign import Bench
from mrd_interfaces.msg import ServoState

pytestmark = pytest.mark.realtime

FEW = (
    "^(pinion slips|coil: open|serial line: each reply comes after.*|disk: full|recorder: SIGTERM"
    "|hybrid test: controller: SIGKILL)$"
)


def campaign(*options: str, timeout: float) -> str:
    command = [sys.executable, "-m", "faults", *options]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.timeout(600)
def test_some_faults_are_within_their_limits() -> None:
    table = campaign("--rows", FEW, "--moments", "1", timeout=590)
    assert table.count("| ok |") == 6


@pytest.mark.slow
@pytest.mark.timeout(7500)
def test_all_faults_are_within_their_limits() -> None:
    table = campaign("--moments", "1", timeout=7400)
    assert table.count("| ok |") == sum(len(family.FAULTS) for family in FAMILIES)


def test_a_state_of_the_servo_of_the_row_before_is_not_taken_for_its_answer() -> None:
    """Once, the cause of the row before was read: the state after the fault was still on its way."""
    states = [ServoState(message="old"), ServoState(message="new"), ServoState(message="newest")]
    for second, state in enumerate(states):
        state.header.stamp.sec = second
    bench = Bench.__new__(Bench)
    bench.servo = states[:1]

    def spin(condition: Callable[[], bool], _timeout: float, **_options: bool) -> bool:
        while not condition() and len(bench.servo) < len(states):
            bench.servo.append(states[len(bench.servo)])
        return condition()

    bench.client = SimpleNamespace(spin=spin)
    bench.hear_the_servo(1.5)
    assert bench.servo[-1].message == "newest"
    with pytest.raises(AssertionError):
        bench.hear_the_servo(2.5)


def test_no_two_faults_have_one_name() -> None:
    names = [fault.name for family in FAMILIES for fault in family.FAULTS]
    assert len(set(names)) == len(names) > 50


def test_a_step_of_the_wall_clock_moves_no_bench_time(tmp_path: Path) -> None:
    """The bench time of a real bench; the rows of the campaign try the simulated one."""
    machine = BrokenMachine(tmp_path)
    program = "import time; from mrd_base import BenchClock; clock = BenchClock(); print(flush=True); input()\n"
    program += "print(clock.now(), time.time())"
    command = [sys.executable, "-c", program]
    environment = os.environ | machine.environment
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        process.stdout.readline()
        machine.set(clock_step=-3600)
        answer, _ = process.communicate("\n", timeout=20)
    bench_time, wall_time = map(float, answer.split())
    assert bench_time == pytest.approx(time.time(), abs=5)
    assert wall_time == pytest.approx(time.time() - 3600, abs=5)
