"""Faults that are named before any fit: the sign of the force, and its unit."""

from dataclasses import replace

import numpy as np
import pytest

from mrd_runs import Run, make_run, read_runs
from mrd_runs.faults import find_faults, relative_work

TIME = np.arange(2000) / 500
POSITION = 0.01 * np.sin(2 * np.pi * 1.5 * TIME)
VELOCITY = 0.03 * np.pi * np.cos(2 * np.pi * 1.5 * TIME)


def run_of(force: np.ndarray, position: np.ndarray = POSITION, name: str = "a") -> Run:
    noise = np.random.default_rng(0)
    columns = {"time_s": TIME, "position_m": position + noise.normal(0, 1e-5, 2000), "current_A": np.zeros(2000)}
    return make_run(name, columns | {"force_N": force})


DAMPER = 200 * np.tanh(50 * VELOCITY) + 800 * VELOCITY


def test_a_damper_has_no_fault() -> None:
    assert find_faults([run_of(DAMPER + 2000 * POSITION + np.random.default_rng(1).normal(0, 5, 2000))]) == []
    assert relative_work(run_of(DAMPER)) > 0.9


@pytest.mark.parametrize("late", [0.005, 0.02, 0.05])
def test_a_late_force_is_no_wrong_sign(late: float) -> None:
    assert find_faults([run_of(np.interp(TIME - late, TIME, DAMPER))]) == []


@pytest.mark.parametrize("offset", [0.0, 500.0, -500.0])
def test_a_force_or_a_position_of_the_wrong_sign_is_named(offset: float) -> None:
    for run in (run_of(-DAMPER + offset), run_of(DAMPER + offset, -POSITION)):
        (fault,) = find_faults([run])
        assert fault.startswith(
            "a: the damper drives the rod, expected that it resists: the force or the position has the wr"
        )
        assert "--flip force" in fault


def test_a_velocity_against_the_position_is_named() -> None:
    run = run_of(DAMPER)
    (fault,) = find_faults([replace(run, velocity=-VELOCITY)])
    assert fault.startswith("a: the velocity falls where the position rises")
    assert find_faults([replace(run, velocity=VELOCITY), replace(run, velocity=0 * VELOCITY)]) == []


def test_a_spring_and_a_rod_at_rest_are_no_faults() -> None:
    assert find_faults([run_of(5e4 * POSITION), run_of(np.random.default_rng(0).normal(0, 1, 2000), np.zeros(2000))]) == []


def test_the_runs_that_show_a_fault_are_named_in_one_clause() -> None:
    wrong = [replace(run_of(-DAMPER), name=name) for name in "abcdefg"]
    assert find_faults(wrong)[0].startswith("all 7 runs: ")
    assert find_faults([run_of(DAMPER, name="x"), *wrong])[0].startswith("a, b, c, d, e and 2 more runs: ")


def test_measured_dampers_have_no_fault(measured) -> None:
    assert find_faults(read_runs(measured)) == []
