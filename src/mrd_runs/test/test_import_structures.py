"""Structures of other laboratories: what stands beside an array is used, or stops the import."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
from nptdms import ChannelObject, GroupObject, TdmsWriter

from mrd_runs import Run, read_run

COUNT, RATE = 300, 250
TIME = np.arange(COUNT) / RATE
INCH, LBF = 0.0254, 4.4482216152605


def position(time: np.ndarray) -> np.ndarray:
    return np.asarray(0.012 * np.sin(2 * np.pi * (0.8 * time + 0.2 * time**2)))


def force(time: np.ndarray) -> np.ndarray:
    return np.asarray(200 * np.cos(2 * np.pi * (0.8 * time + 0.2 * time**2)) + 30)


X, F, CURRENT = position(TIME), force(TIME), 0.4 + 0.1 * TIME
FOREIGN = np.column_stack([1e3 * TIME, X / INCH, F / LBF, 1e3 * CURRENT])
NAMES, UNITS = ["Time", "Position", "Force", "Current"], ["ms", "in", "lbf", "mA"]


def cells(items: Any) -> np.ndarray:
    """A cell array of MATLAB."""
    array = np.empty(len(items), object)
    array[:] = items
    return array


@pytest.fixture
def imported(import_tool: Any, tmp_path: Path) -> Callable[..., list[Run] | str]:
    def run(name: str, options: str = "") -> list[Run] | str:
        code, _, error = import_tool(f"{name} {options} --output bags")
        return [read_run(bag) for bag in sorted((tmp_path / "bags").iterdir())] if code == 0 else str(error)

    return run


def check(runs: list[Run] | str) -> None:
    assert isinstance(runs, list), runs
    (run,) = runs
    assert len(run) == COUNT
    np.testing.assert_allclose(run.position, position(run.time), atol=1e-7)
    np.testing.assert_allclose(run.force, force(run.time), atol=1e-3)
    np.testing.assert_allclose(run.current, 0.4 + 0.1 * run.time, atol=1e-6)


@pytest.mark.parametrize(
    "content",
    [
        {"data": FOREIGN, "names": cells(NAMES), "units": cells(UNITS)},
        {"log": {"data": FOREIGN.T, "channels": np.array(NAMES), "units": cells(UNITS)}},
        {"A": {"data": FOREIGN, "colheaders": cells([f"{n} ({u})" for n, u in zip(NAMES, UNITS, strict=True)])}},
        {**dict(zip("txFi", FOREIGN.T, strict=True)), "units": dict(zip("txFi", UNITS, strict=True))},
        {"d": {**dict(zip(NAMES, FOREIGN.T, strict=True)), "units": cells(UNITS)}},
        {
            "out": {
                "time": TIME,
                "signals": cells(
                    [
                        {"values": values, "label": label, "dimensions": 1}
                        for label, values in (("pos", X), ("force", F), ("current", CURRENT))
                    ]
                ),
            }
        },
        {
            "out": {
                "time": TIME,
                "signals": cells(
                    [
                        {"values": values.reshape(1, 1, -1), "label": label, "dimensions": 1}
                        for label, values in (("pos", X), ("force", F), ("current", CURRENT))
                    ]
                ),
            }
        },
    ],
)
def test_names_and_units_beside_arrays_of_matlab_are_used(imported: Any, tmp_path: Path, content: dict[str, Any]) -> None:
    scipy.io.savemat(tmp_path / "rig.mat", content)
    check(imported("rig.mat"))


@pytest.mark.parametrize("name", ["gain", "scale", "Offset", "sensitivity"])
def test_a_scale_beside_an_array_of_matlab_stops_the_import(imported: Any, tmp_path: Path, name: str) -> None:
    content = {"t": TIME, "x": X, "i": CURRENT, "force": {"data": (10 * F).astype(np.int16), name: 0.1}}
    scipy.io.savemat(tmp_path / "rig.mat", content)
    error = imported("rig.mat")
    assert isinstance(error, str)
    assert f"force.data has the attribute {name} = 0.1, which is not applied" in error


def test_names_beside_a_data_set_are_used(imported: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "rig.h5", "w") as file:
        file["run/data"] = FOREIGN
        file["run/channel_names"] = np.array(NAMES, "S10")
        file["run/units"] = np.array(UNITS, "S10")
    check(imported("rig.h5"))


@pytest.mark.parametrize("start", ["t0", "start", "time_offset"])
def test_data_sets_that_start_apart_are_put_onto_one_time(imported: Any, tmp_path: Path, start: str) -> None:
    with h5py.File(tmp_path / "rig.h5", "w") as file:
        for name, values, begin in (("position", X, 0.0), ("force", force(TIME + 0.02), 0.02), ("current", CURRENT, 0.0)):
            file[name] = values
            file[name].attrs["dt"] = 1 / RATE
            file[name].attrs[start] = begin
    (run,) = imported("rig.h5")
    np.testing.assert_allclose(run.position, position(run.time + 0.02), atol=1e-4)
    np.testing.assert_allclose(run.force, force(run.time + 0.02), atol=1)
    assert not run.clocks_agree("position", "force")


@pytest.mark.parametrize("name", ["unit_string", "NI_UnitDescription", "Unit", "description"])
def test_units_of_tdms_channels_stand_in_several_properties(imported: Any, tmp_path: Path, name: str) -> None:
    channels = [
        ChannelObject("rig", channel, values, properties={name: unit})
        for channel, values, unit in zip(NAMES[1:], FOREIGN.T[1:], UNITS[1:], strict=True)
    ]
    with TdmsWriter(tmp_path / "rig.tdms") as writer:
        writer.write_segment([GroupObject("rig", properties={"Sampling Rate": 250.0}), *channels])
    check(imported("rig.tdms"))


def book(path: Path, sheets: dict[str, tuple[list[str], np.ndarray]]) -> None:
    workbook = openpyxl.Workbook()
    workbook.remove(workbook.active)
    for title, (header, rows) in sheets.items():
        sheet = workbook.create_sheet(title)
        for row in (header, *rows.tolist()):
            sheet.append(row)
    workbook.save(path)


HEADER = ["Time (s)", "Position (m)", "Force (N)", "Current (A)"]
ROWS = np.column_stack([TIME, X, F, CURRENT])


def test_sheets_with_the_same_columns_are_runs_or_parts_of_one(imported: Any, import_tool: Any, tmp_path: Path) -> None:
    book(
        tmp_path / "parts.xlsx", {"a": (HEADER, ROWS[:120]), "b": (HEADER, ROWS[120:]), "peaks": (["v", "F"], ROWS[:9, 1:3])}
    )
    check(imported("parts.xlsx"))
    book(tmp_path / "runs.xlsx", {"a": (HEADER, ROWS[:120]), "b": (HEADER, ROWS[:200] * [1, 1, 2, 1])})
    code, out, _ = import_tool("runs.xlsx --output more")
    assert code == 0
    assert "2 passes" in out
    assert [len(read_run(bag)) for bag in sorted((tmp_path / "more").iterdir())] == [120, 200]


def test_sheets_that_are_not_read_are_named(import_tool: Any, tmp_path: Path) -> None:
    other = [*HEADER[:2], "Force (kN)", HEADER[3]]
    book(tmp_path / "rig.xlsx", {"a": (HEADER, ROWS), "b": (other, ROWS[:100])})
    code, out, _ = import_tool("rig.xlsx --output bags")
    assert code == 0
    assert "not read, because of other columns: b" in out


@pytest.mark.parametrize("first", [60, 100, 240])
def test_the_first_block_counts_however_short(import_tool: Any, tmp_path: Path, first: int) -> None:
    lines = [",".join(f"{value:.9g}" for value in row) for row in ROWS]
    lines[first - 1] = lines[first - 1].rpartition(",")[0]  # the rig was switched off in this row
    text = "\n".join([",".join(HEADER), *lines[:first], ",".join(HEADER), *lines[first:]])
    (tmp_path / "rig.csv").write_text(text)
    assert import_tool("rig.csv --output bags")[0] == 0
    run = read_run(tmp_path / "bags/rig")
    assert len(run) == COUNT - 1
    np.testing.assert_allclose(run.position, position(run.time), atol=1e-7)
    np.testing.assert_allclose(run.current, 0.4 + 0.1 * run.time, atol=1e-6)
