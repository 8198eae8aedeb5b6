"""The tools `info` and `import`."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import make_run, read_run
from mrd_runs.bag_import import write_bag
from mrd_runs.cli import import_, info
from mrd_runs.summary import count_reversals, summarise


class Result(NamedTuple):
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    def run(name: str, *arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        try:
            {"import": import_.main, "info": info.main}[name]()
        except SystemExit as end:
            return Result(int(end.code or 0), *capsys.readouterr())
        return Result(0, *capsys.readouterr())

    return run


def test_executables_run_as_processes(tmp_path: Path) -> None:
    for name, arguments in (("import", [tmp_path / "absent.csv", "--output", tmp_path]), ("info", [tmp_path / "absent"])):
        process = subprocess.run(["ros2", "run", "mrd_runs", name, *map(str, arguments)], capture_output=True, text=True)
        assert (process.returncode, process.stdout, process.stderr.count("\n")) == (2, "", 1)


def test_imported_csv_reads_sample_for_sample(tool, tmp_path: Path, make_columns, write_csv) -> None:
    uneven = make_columns(777, seed=1)
    uneven["time_s"] = 12.5 + np.cumsum(np.random.default_rng(0).uniform(0.5e-3, 1.5e-3, 777))
    uneven["temperature_C"] = np.linspace(20, 31, 777)
    uneven["velocity_mps"] = np.gradient(uneven["position_m"], uneven["time_s"])
    plain = {key: value for key, value in make_columns(990, seed=2).items() if key != "acceleration_mps2"}
    files = [write_csv(tmp_path / "uneven.csv", uneven), write_csv(tmp_path / "plain.csv", plain)]
    result = tool("import", *files, "--output", tmp_path / "bags")
    assert (result.returncode, result.stderr) == (0, "")
    for file in files:
        there, back = read_run(file), read_run(tmp_path / "bags" / file.stem)
        for name in ("time", "position", "velocity", "current", "force", "acceleration", "temperature"):
            np.testing.assert_array_equal(getattr(back, name), getattr(there, name), err_msg=name)
        assert back.info["imported_from"] == file.name


def test_import_overwrites_nothing_and_leaves_no_part_behind(tool, tmp_path: Path, columns, write_csv) -> None:
    good = write_csv(tmp_path / "good.csv", columns)
    (tmp_path / "bad.csv").write_text("time_s\n1\n")
    result = tool("import", good, tmp_path / "bad.csv", "--output", tmp_path / "bags")
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "bags").exists()
    assert tool("import", good, "--output", tmp_path / "bags").returncode == 0
    before = (tmp_path / "bags/good/good.mcap").read_bytes()
    again = tool("import", good, "--output", tmp_path / "bags")
    assert again.returncode == 2
    assert "exists already" in again.stderr
    assert (tmp_path / "bags/good/good.mcap").read_bytes() == before


@pytest.mark.parametrize("start", [-5.0, 2.0**31 - 0.5, 1e11])
def test_times_without_a_ros_stamp_are_read_back(tmp_path: Path, columns, write_csv, start: float) -> None:
    file = write_csv(tmp_path / "run.csv", columns | {"time_s": start + columns["time_s"]})
    write_bag(columns | {"time_s": start + columns["time_s"]}, [], file, tmp_path / "bags/run")
    np.testing.assert_array_equal(read_run(tmp_path / "bags/run").time, read_run(file).time)


@pytest.mark.parametrize("failing", ["format_run_info", "_write"])
def test_failed_import_leaves_nothing_behind(tmp_path: Path, columns, write_csv, monkeypatch, failing: str) -> None:
    def fail(*_: object, **__: object) -> None:
        raise InputError("no")

    monkeypatch.setattr(f"mrd_runs.bag_import.{failing}", fail)
    with pytest.raises(InputError, match="no"):
        write_bag(columns, [], Path("run.csv"), tmp_path / "new/bags/run")
    assert not list(tmp_path.iterdir())


def test_recording_longer_than_stamps_reach(tmp_path: Path, columns, write_csv) -> None:
    columns["time_s"][-1] = 1e11
    with pytest.raises(InputError, match=r"run.csv: is 1e\+11 s long"):
        write_bag(columns, [], Path("run.csv"), tmp_path / "bags/run")
    assert not (tmp_path / "bags").exists()


def test_folders_without_a_bag_are_not_imported(tool, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    result = tool("import", tmp_path / "empty", "--output", tmp_path / "bags")
    assert result.stderr.endswith("or a bag\n")
    assert "empty: is a folder without a recording; expected .csv" in result.stderr


def test_info_shows_the_summary(tool, tmp_path: Path, columns, fill_bag) -> None:
    writer = fill_bag(tmp_path / "run", columns, skip=(3,))
    writer.flush()
    result = tool("info", tmp_path / "run")
    assert result.returncode == 0, result.stderr
    for expected in ("980", "recovered", "20.0", "94.", "lost", "µm"):
        assert expected in result.stdout
    writer.close()


def test_info_refuses_in_one_line(tool, tmp_path: Path) -> None:
    result = tool("info", tmp_path / "absent")
    assert result.returncode == 2
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("cycles", [1, 4])
def test_reversals(cycles: int) -> None:
    phase = 2 * np.pi * cycles * np.linspace(0, 1, 1000)
    assert count_reversals(np.cos(phase)) == 2 * cycles
    assert count_reversals(np.zeros(100)) == 0


def test_summary(columns) -> None:
    rows = summarise(make_run("run", columns, {"source": "here"}))
    assert float(rows["stroke"].split()[0]) == pytest.approx(20, rel=0.01)
    assert float(rows["peak speed"].split()[0]) == pytest.approx(10 * 2 * np.pi * 1.5, rel=0.02)
    assert rows["reversals"] == "3"
    assert rows["rate"] == "1000 Hz"
    assert "seed" not in rows


def test_info_takes_no_text_for_markup(tool, tmp_path: Path, columns, write_csv) -> None:
    result = tool("info", write_csv(tmp_path / "run.csv", columns | {"[/red]": columns["force_N"]}))
    assert result.returncode == 0, result.stderr
    assert "columns ignored: [/red]" in result.stdout
