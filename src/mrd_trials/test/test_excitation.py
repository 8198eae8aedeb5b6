"""Sets of runs, random experiments, and recordings of measured dampers."""

import numpy as np
import pytest

from mrd_trials.excitation import FRESH_RUNS, commands_of_runs, parse_tier, random_command, read_recorded_dampers


@pytest.mark.parametrize("tier", ["rich@500", "sine@500", "paper@25"])
def test_runs_begin_at_rest_and_keep_within_the_stroke(tier):
    runs = commands_of_runs(parse_tier(tier), np.random.default_rng(5))
    assert len({name for name, _ in runs}) == len(runs) > FRESH_RUNS
    for _, command in runs:
        assert np.abs(command.position).max() < 0.0265
        assert command.current.min() >= 0.0
        assert abs(command.position[1] - command.position[0]) < 1e-6


def test_recordings_are_read_by_damper(tmp_path):
    for gain, name in enumerate("abc", 1):
        rows = "".join(f"{0.01 * k},{1e-4 * k},0,{gain * k}\n" for k in range(50))
        path = tmp_path / "press" / f"{name}.csv"
        path.parent.mkdir(exist_ok=True)
        path.write_text("time_s,position_m,current_A,force_N\n" + rows)
    (tmp_path / "few").mkdir()
    dampers = read_recorded_dampers(tmp_path)
    assert [run.name for run in dampers["press"]] == ["a", "b", "c"]
    assert dampers.keys() == {"press"}


def test_random_experiments_differ_and_keep_within_the_stroke():
    commands = [random_command(np.random.default_rng(seed)) for seed in range(12)]
    assert len({(command.position.tobytes(), command.current.tobytes()) for command in commands}) > 6
    for command in commands:
        assert np.abs(command.position).max() < 0.0265
        assert command.current.min() >= 0.0
