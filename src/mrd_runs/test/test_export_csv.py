"""Exported CSV files hold the values of the bag."""

import sys
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_base.table import read_csv
from mrd_runs import read_run
from mrd_runs.bag import BagWriter
from mrd_runs.bag_import import write_bag
from mrd_runs.cli import export_csv
from mrd_runs.csv_export import export_csv as export
from mrd_runs.definitions import SAMPLES_TYPE, typestore

SERIES = ("time", "position", "velocity", "current", "force", "acceleration", "temperature")
TYPES = typestore().types


def test_exported_samples_are_those_of_the_bag(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns, skip=(7,)).close()
    assert export(tmp_path / "run", tmp_path / "run.csv") == {tmp_path / "run.csv": 980}
    bag, table = read_run(tmp_path / "run"), read_run(tmp_path / "run.csv")
    for name in SERIES:
        np.testing.assert_array_equal(getattr(table, name), getattr(bag, name), err_msg=name)
    assert (tmp_path / "run.csv").read_text().partition("\n")[0] == "time_s,position_m,current_A,force_N,acceleration_mps2"


def test_imported_and_exported_file_is_the_same(tmp_path: Path, columns, write_csv) -> None:
    columns["velocity_mps"] = np.gradient(columns["position_m"], columns["time_s"])
    columns["temperature_C"] = np.linspace(20, 30, 1000)
    columns["time_s"] = 5.1 + np.cumsum(np.random.default_rng(0).uniform(0.5e-3, 1.5e-3, 1000))
    source = write_csv(tmp_path / "run.csv", columns)
    write_bag(columns, [], source, tmp_path / "bag")
    export(tmp_path / "bag", tmp_path / "again.csv")
    old, new = (read_csv(path, list(columns)).columns for path in (source, tmp_path / "again.csv"))
    for name in columns:
        np.testing.assert_array_equal(new[name], old[name], err_msg=name)


def test_what_was_commanded_is_on_the_same_time(tmp_path: Path, columns, make_block) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/bench/samples", SAMPLES_TYPE)
        writer.add_topic("/bench/setpoint", "mrd_interfaces/msg/Setpoint")
        for first in range(0, 1000, 20):
            writer.write_message("/bench/samples", first, make_block(columns, first, first + 20))
            at = round((1.7e9 + first / 1000 + 0.25) * 1e9)
            header = TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](at // 10**9, at % 10**9), "")
            writer.write_message(
                "/bench/setpoint", first, TYPES["mrd_interfaces/msg/Setpoint"](header, first / 7, 2.0, 3.0, 0.4, 7)
            )
    paths = export(tmp_path / "run", tmp_path / "out.csv")
    assert paths == {tmp_path / "out.csv": 1000, tmp_path / "out.setpoint.csv": 50}
    names = ["time_s", "position_m", "velocity_mps", "acceleration_mps2", "current_A"]
    table = read_csv(tmp_path / "out.setpoint.csv", names).columns
    np.testing.assert_allclose(table["time_s"], np.arange(50) / 50 + 0.25, atol=1e-6)
    np.testing.assert_array_equal(table["position_m"], np.arange(0, 1000, 20) / 7)


def test_nothing_is_overwritten_and_nothing_is_left_behind(tmp_path: Path, columns, fill_bag, monkeypatch) -> None:
    fill_bag(tmp_path / "run", columns).close()
    (tmp_path / "run.csv").write_text("mine")
    with pytest.raises(InputError, match=r"run\.csv: exists already"):
        export(tmp_path / "run", tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text() == "mine"
    with pytest.raises(InputError, match=r"nowhere/x\.csv: cannot be written \(No such file"):
        export(tmp_path / "run", tmp_path / "nowhere/x.csv")

    def fail(_self: Path, _target: Path) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "rename", fail)
    with pytest.raises(InputError, match=r"new\.csv: cannot be written \(No space left on device\)"):
        export(tmp_path / "run", tmp_path / "new.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "run.csv"]


def test_tool(tmp_path: Path, columns, fill_bag, monkeypatch, capsys) -> None:
    fill_bag(tmp_path / "run", columns).close()
    monkeypatch.setattr(sys, "argv", ["export_csv", str(tmp_path / "run")])
    export_csv.main()
    assert capsys.readouterr().out == f"{tmp_path}/run.csv: 1000 rows\n"
    monkeypatch.setattr(sys, "argv", ["export_csv", str(tmp_path / "run/run.mcap"), "--output", str(tmp_path / "b.csv")])
    export_csv.main()
    assert (tmp_path / "b.csv").read_text() == (tmp_path / "run.csv").read_text()
    with pytest.raises(SystemExit) as end:
        export_csv.main()
    assert end.value.code == 2
