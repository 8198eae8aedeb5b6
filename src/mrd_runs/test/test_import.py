"""Recordings of other benches and programs: each format, made by its own library, becomes a bag with the same values."""

import datetime
import io
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
from nptdms import ChannelObject, RootObject, TdmsWriter

from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.importing import Mapped, read_foreign
from mrd_runs.importing.integration import integrate_velocity
from mrd_runs.importing.matlab import read_matlab_table
from mrd_runs.importing.sheet import read_sheet_table
from mrd_runs.importing.tdms import read_tdms_table

RATE, COUNT = 500, 1000
TIME = np.arange(COUNT) / RATE
ANGLE = 2 * np.pi * 1.5 * TIME
POSITION = 0.01 * np.sin(ANGLE)  # m
VELOCITY = 0.01 * 2 * np.pi * 1.5 * np.cos(ANGLE)
FORCE = 200 * np.tanh(20 * VELOCITY) + 800 * VELOCITY
CURRENT = 0.2 + 0.1 * np.sin(0.3 * ANGLE)


def german(path: Path, encoding: str = "utf-8") -> Path:
    """A file as German programs write it: preamble, semicolons, decimal commas, ms, mm, kN."""
    rows = zip(1e3 * TIME, 1e3 * POSITION, 1e-3 * FORCE, strict=True)
    lines = ["Prüfstand 3;;", "Datum;12.03.2024;", "Abtastrate;500 Hz;", "", "Time [ms];Weg [mm];Kraft [kN]"]
    lines += [";".join(f"{value:.9f}".replace(".", ",") for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def check(bag: Path, current: object = 0.5) -> None:
    run = read_run(bag)
    np.testing.assert_allclose(run.time, TIME, atol=1e-9)
    np.testing.assert_allclose(run.position, POSITION, atol=2e-9)
    np.testing.assert_allclose(run.force, FORCE, atol=2e-5)
    np.testing.assert_allclose(run.current, current, atol=1e-9)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_german_text_is_understood_by_itself(import_tool, tmp_path: Path, encoding: str) -> None:
    german(tmp_path / "a.txt", encoding)
    code, text, error = import_tool("a.txt --current 0.5 --output bags")
    assert (code, error) == (0, "")
    check(tmp_path / "bags/a")
    assert "semicolons between the columns, decimal comma, numbers from line 6 (4 lines above)" in text
    assert "time is Time [ms] in ms; position is Weg [mm] in mm; force is Kraft [kN] in kN" in text
    assert "current of 0.5 A as given" in read_run(tmp_path / "bags/a").info["notes"]


def asked_mapping(error: str) -> str:
    """Return the options that the line of an error proposes."""
    return error.partition("right of: ")[2].partition(" (columns: ")[0]


def test_long_names_leave_the_mapping_whole(import_tool, tmp_path: Path) -> None:
    names = [f"Prüfstand 7, Messkarte {number}, Verstärker mit langer Beschreibung des Aufnehmers" for number in range(25)]
    table = np.column_stack([TIME, POSITION, FORCE, *np.random.default_rng(0).normal(size=(22, COUNT))])
    np.savetxt(tmp_path / "a.txt", table, delimiter=";", header=";".join(names), comments="", encoding="utf-8")
    code, _, error = import_tool("a.txt --current 0.5 --output bags")
    assert code == 2
    assert error.rstrip().endswith("...")
    assert import_tool(f"a.txt --current 0.5 {asked_mapping(error)} --output bags")[0] == 0
    check(tmp_path / "bags/a")


def test_the_mapping_that_is_asked_for_is_named_and_does(import_tool, tmp_path: Path) -> None:
    text = german(tmp_path / "a.txt").read_text().replace("Weg [mm]", "Kanal 2").replace("Kraft [kN]", "Kanal 3")
    (tmp_path / "a.txt").write_text(text)
    code, _, error = import_tool("a.txt --output bags")
    assert code == 2
    assert error == (
        "error: a.txt: the columns do not tell the position and the force and the current; say so with what is right of: "
        "--map time='Time [ms]' position='Kanal 2' force='Kanal 3' --units position=mm --current 0 "
        "(columns: Time [ms], Kanal 2, Kanal 3)\n"
    )
    mapping = asked_mapping(error).replace("--current 0", "--current 0.5")
    assert import_tool(f"a.txt {mapping} --units position=mm force=kN --output bags")[0] == 0
    check(tmp_path / "bags/a")


def test_units_that_are_not_told_are_asked_for(import_tool, tmp_path: Path) -> None:
    text = german(tmp_path / "a.txt").read_text().replace("Weg [mm]", "Weg").replace("Kraft [kN]", "Kraft [V]")
    (tmp_path / "a.txt").write_text(text)
    code, _, error = import_tool("a.txt --current 0 --output bags")
    assert code == 2
    assert "the force is in V, expected N, kN" in error
    assert '--units force="NUMBER UNIT"' in error
    code, _, error = import_tool('a.txt --current 0 --units force="1000 N" --output bags')
    assert "position_m spans 20, expected at most 2 m peak to peak; is it in mm?" in error
    assert import_tool('a.txt --current 0.5 --units force="1000 N" position=mm --output bags')[0] == 0
    check(tmp_path / "bags/a")


def test_a_sign_is_turned(import_tool, tmp_path: Path) -> None:
    german(tmp_path / "a.txt")
    code, text, _ = import_tool("a.txt --current 0.5 --flip force --output bags")
    assert code == 0
    assert "the sign of the force was turned" in text
    np.testing.assert_allclose(read_run(tmp_path / "bags/a").force, -FORCE, atol=2e-5)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (
            "--map force=Kraft",
            "--map force: unknown column Kraft; did you mean Kraft [kN]? (known: Time [ms], Weg [mm], Kraft",
        ),
        ("--map load=Kraft", "--map: unknown quantity load (known: time, position, velocity"),
        ("--map force", "--map: force is not a pair, expected QUANTITY=..."),
        ("--flip weight", "--flip: unknown quantity weight"),
        ("--flip temperature", "--units or --flip names the temperature, which is not read"),
        ("--rate 0", "--rate is 0, expected a sample rate in Hz"),
        ("--topics force=/f.data", "--topics is for bags; name the columns of this file with --map"),
    ],
)
def test_wrong_options_are_one_line(import_tool, tmp_path: Path, arguments: str, line: str) -> None:
    german(tmp_path / "a.txt")
    code, text, error = import_tool(f"a.txt --current 0 {arguments} --output bags")
    assert (code, text, error.count("\n")) == (2, "", 1)
    assert line in error
    assert not (tmp_path / "bags").exists()


def test_a_bad_cell_is_named_with_its_line(import_tool, tmp_path: Path) -> None:
    lines = german(tmp_path / "a.txt").read_text().split("\n")
    lines[700] = lines[700].rpartition(";")[0] + ";Überlast"
    (tmp_path / "a.txt").write_text("\n".join(lines))
    assert (
        "a.txt: line 701: Kraft [kN] is 'Überlast', expected a number" in import_tool("a.txt --current 0 --output bags")[2]
    )


def test_bags_of_other_files_are_not_left_behind_when_one_fails(import_tool, tmp_path: Path) -> None:
    german(tmp_path / "a.txt")
    (tmp_path / "b.txt").write_text("nothing\n")
    code, _, error = import_tool("a.txt b.txt --current 0 --output deep/bags")
    assert (code, error) == (2, "error: b.txt: holds no rows of at least two numbers; expected a table of samples\n")
    assert not (tmp_path / "deep").exists()


def test_a_workbook(import_tool, tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.title = "Notizen"
    book.active.append(["Prüfling", 7])
    sheet = book.create_sheet("Daten")
    sheet.append(["Versuch vom", datetime.date(2024, 3, 12)])
    sheet.append([])
    sheet.append(["Zeit", "Kolbenweg", "Dämpferkraft", "Bemerkung"])
    sheet.append(["ms", "mm", "kN", None])
    for row in zip(1e3 * TIME, 1e3 * POSITION, 1e-3 * FORCE, strict=True):
        sheet.append([*row, None])
    book.save(tmp_path / "a.xlsx")
    code, text, error = import_tool("a.xlsx --current 0.5 --output bags")
    assert (code, error) == (0, "")
    assert "sheet Daten, numbers from row 5" in text
    check(tmp_path / "bags/a")
    sheet["C503"] = "n/a"
    book.save(tmp_path / "b.xlsx")
    assert "b.xlsx: row 503: Dämpferkraft is 'n/a', expected a number" in import_tool("b.xlsx --current 0 --output bags")[2]


def test_times_of_day_in_a_workbook(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["time", "position [m]", "force [N]"])
    start = datetime.datetime(2024, 3, 12, 23, 59, 59)
    for time, position, force in zip(TIME, POSITION, FORCE, strict=True):
        book.active.append([start + datetime.timedelta(seconds=float(time)), position, force])
    book.save(tmp_path / "a.xlsx")
    columns = read_foreign(tmp_path / "a.xlsx", Mapped(current=0.0)).columns
    # Excel keeps times as days in floating point.
    np.testing.assert_allclose(columns["time_s"] - columns["time_s"][0], TIME, atol=1e-3)


def test_matlab_vectors_structures_and_matrices(import_tool, tmp_path: Path) -> None:
    scipy.io.savemat(
        tmp_path / "a.mat", {"t": TIME, "x": POSITION[:, None], "F": FORCE[None, :], "fs": 500.0, "note": "text"}
    )
    log = {"time": TIME, "signals": {"position": POSITION, "force": FORCE, "current": np.full(COUNT, 0.5)}}
    scipy.io.savemat(tmp_path / "b.mat", {"log": log})
    scipy.io.savemat(tmp_path / "c.mat", {"data": np.column_stack([TIME, POSITION, FORCE])})
    assert import_tool("a.mat --current 0.5 --output bags")[0] == 0
    assert import_tool("b.mat --output bags")[0] == 0
    check(tmp_path / "bags/a")
    check(tmp_path / "bags/b")
    code, _, error = import_tool("c.mat --current 0.5 --output bags")
    assert code == 2
    mapping = asked_mapping(error)
    assert mapping == "--map time='data(1)' position='data(2)' force='data(3)'"
    assert import_tool(f"c.mat --current 0.5 {mapping} --output bags")[0] == 0
    check(tmp_path / "bags/c")


def test_a_matlab_file_that_ends_its_reader_is_refused_in_one_line(tmp_path: Path) -> None:
    """SciPy trusts the type in which it reads the header of an array; with another one it ends the process."""
    whole, damaged = tmp_path / "whole.mat", tmp_path / "damaged.mat"
    scipy.io.savemat(whole, {"data": {"time": np.arange(40.0), "force": np.arange(40.0)}})
    content = whole.read_bytes()
    refusals = []
    for place in (place for place in range(128, len(content), 4) if content[place : place + 4] == b"\6\0\0\0"):
        damaged.write_bytes(content[:place] + b"\5" + content[place + 1 :])
        try:
            read_matlab_table(damaged)
        except InputError as error:
            refusals.append(str(error))
    assert f"{damaged}: is damaged, so that no reader survives it; save it anew" in refusals


def test_hdf5_and_matlab_7_3(import_tool, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        run = file.create_group("run")
        for name, values, unit in (("time", 1e3 * TIME, "ms"), ("displacement", 1e3 * POSITION, "mm"), ("load", FORCE, "N")):
            run.create_dataset(name, data=values, compression="gzip").attrs["unit"] = unit
        file.create_dataset("image", data=np.zeros((300, 400)))
    # MATLAB 7.3: 512 bytes of its own, vectors as (1, n), cells under #refs#.
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        for name, values in (("time", TIME), ("position", POSITION), ("force", FORCE)):
            file.create_dataset(f"log/{name}", data=values[None, :])
        file.create_dataset("#refs#/a", data=np.arange(50.0))
        letters = np.frombuffer("Force of channel 2".encode("utf-16-le"), np.uint16)
        file.create_dataset("force", data=letters[:, None]).attrs["MATLAB_class"] = np.bytes_("char")
    with (tmp_path / "b.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    rows = np.zeros(COUNT, [("t", "f8"), ("x", "f8"), ("F", "f4")])
    rows["t"], rows["x"], rows["F"] = TIME, POSITION, FORCE
    with h5py.File(tmp_path / "c.hdf5", "w") as file:
        file["data"] = rows
    for name in ("a.h5", "b.mat", "c.hdf5"):
        code, _, error = import_tool(f"{name} --current 0.5 --output bags")
        assert (code, error) == (0, "")
        check(tmp_path / "bags" / name[0])


def test_tdms_with_times_and_with_waveforms(import_tool, tmp_path: Path) -> None:
    wave = {"wf_increment": 1 / RATE, "wf_start_offset": 0.0}
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        channels = [
            ChannelObject("Messung", "Weg", 1e3 * POSITION, wave | {"unit_string": "mm"}),
            ChannelObject("Messung", "Kraft", FORCE, wave | {"unit_string": "N"}),
            ChannelObject("Messung", "Bemerkung", ["a", "b"]),
        ]
        writer.write_segment([RootObject({"Titel": "Versuch"}), *channels])
    with TdmsWriter(tmp_path / "b.tdms") as writer:
        stamps = np.datetime64("2024-03-12T10:00:00") + (1e6 * TIME).astype("timedelta64[us]")
        writer.write_segment(
            [ChannelObject("A", "time", stamps), ChannelObject("A", "pos", POSITION), ChannelObject("A", "force", FORCE)]
        )
        writer.write_segment([ChannelObject("B", "setpoint", POSITION)])
    for name in ("a", "b"):
        code, _, error = import_tool(f"{name}.tdms --current 0.5 --output bags")
        assert (code, error) == (0, "")
        check(tmp_path / "bags" / name)


def test_of_a_tdms_file_that_is_cut_off_a_note_tells(tmp_path: Path, caplog) -> None:
    with TdmsWriter(tmp_path / "whole.tdms") as writer:
        names = {"time": TIME, "position": POSITION, "force": FORCE}
        writer.write_segment([ChannelObject("log", name, values) for name, values in names.items()])
    (tmp_path / "cut.tdms").write_bytes((tmp_path / "whole.tdms").read_bytes()[:-8])
    assert read_tdms_table(tmp_path / "whole.tdms").layout == ""
    assert read_tdms_table(tmp_path / "cut.tdms").layout == "the file is cut off: its last segment is incomplete"
    recording = read_foreign(tmp_path / "cut.tdms", Mapped(current=0.0))
    assert len(recording.columns["time_s"]) == 999
    assert "times: cut to 999 samples (1000 of time, 1000 of position, 999 of force)" in recording.info["notes"]
    assert caplog.records == []  # npTDMS itself would tell of the file in many lines


@pytest.mark.parametrize("name", ["a.xlsx", "a.mat", "a.h5", "a.tdms", "a.mcap", "a.db3", "a.txt"])
def test_damaged_files_are_one_line(import_tool, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"\x89HDF\r\n\x1a\n" if name == "a.h5" else b"TDSmPK\3\4\0nonsense" * 50)
    code, text, error = import_tool(f"{name} --current 0 --output bags")
    assert (code, text, error.count("\n")) == (2, "", 1)
    assert error.startswith(f"error: {name}: ")


@pytest.mark.parametrize(
    ("name", "module", "package", "extra"),
    [("a.xlsx", "openpyxl", "openpyxl", "xlsx"), ("a.h5", "h5py", "h5py", "hdf5"), ("a.tdms", "nptdms", "npTDMS", "tdms")],
)
def test_a_library_that_is_missing_is_named_with_its_extra(
    import_tool, tmp_path: Path, monkeypatch, name: str, module: str, package: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"x")
    error = import_tool(f"{name} --output bags")[2]
    assert error == (
        f"error: {name}: this format needs the package {package}; run: pip install {package} (or, in the folder of this "
        f"software, pip install '.[{extra}]')\n"
    )


def test_a_file_without_time_needs_its_rate(import_tool, tmp_path: Path) -> None:
    table = np.column_stack([POSITION, FORCE])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="position [m],force [N]", comments="")
    assert "--rate HZ" in import_tool("a.csv --current 0.5 --output bags")[2]
    assert import_tool("a.csv --current 0.5 --rate 500 --output bags")[0] == 0
    check(tmp_path / "bags/a")


@pytest.mark.parametrize(
    ("stamp", "decimal"), [("%H:%M:%S.%f", ","), ("%Y-%m-%dT%H:%M:%S.%fZ", "."), ("%d.%m.%Y %H:%M:%S.%f", ",")]
)
def test_times_of_day_in_text(tmp_path: Path, stamp: str, decimal: str) -> None:
    start = datetime.datetime(2024, 3, 12, 9, 59, 59)
    lines = ["Zeit;Weg [mm];Kraft [N]"]
    for time, position, force in zip(TIME, POSITION, FORCE, strict=True):
        # The first dots of a date are none of a decimal sign.
        clock, _, fraction = (start + datetime.timedelta(seconds=float(time))).strftime(stamp).rpartition(".")
        lines.append(f"{clock}{decimal}{fraction};" + f"{1e3 * position:.6f};{force:.6f}".replace(".", decimal))
    (tmp_path / "a.txt").write_text("\n".join(lines))
    columns = read_foreign(tmp_path / "a.txt", Mapped(current=0.0)).columns
    np.testing.assert_allclose(columns["time_s"] - columns["time_s"][0], TIME, atol=1e-6)
    np.testing.assert_allclose(columns["position_m"], POSITION, atol=1e-9)


def test_a_sign_that_looks_wrong_is_named(import_tool, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "a.csv", np.column_stack([TIME, POSITION, -FORCE]), delimiter=",", header="t,x,F", comments="")
    code, _, error = import_tool("a.csv --current 0 --output bags")
    assert code == 0
    assert error.startswith("warning: a: the damper drives the rod, expected that it resists")
    assert import_tool("a.csv --current 0 --flip force --output turned")[::2] == (0, "")
    # Once it is a bag, the same advice still does; all else stays bit by bit.
    assert import_tool("bags/a --flip force --output again")[::2] == (0, "")
    wrong, turned = read_run(tmp_path / "bags/a"), read_run(tmp_path / "again/a")
    np.testing.assert_array_equal(turned.force, -wrong.force)
    np.testing.assert_array_equal(turned.time, wrong.time)
    np.testing.assert_array_equal(turned.position, wrong.position)
    assert set(turned.info["notes"]) == {*wrong.info["notes"], "the sign of the force was turned"}


@pytest.mark.parametrize("bias", [0.0, 2e-3])
def test_velocity_only_is_integrated_without_drift(import_tool, tmp_path: Path, bias: float) -> None:
    noise = np.random.default_rng(1).normal(0, 1e-3, COUNT)
    table = np.column_stack([TIME, VELOCITY + bias + noise, FORCE])
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header="time [s],velocity [m/s],force [N]", comments="")
    code, text, _ = import_tool("a.csv --current 0.5 --output bags")
    assert code == 0
    assert "there is no position: it is the integral of the velocity, with its middle at zero; a drift of" in text
    run = read_run(tmp_path / "bags/a")
    np.testing.assert_allclose(run.position, POSITION, atol=0.02 * np.ptp(POSITION))
    assert abs(np.polyfit(run.time, run.position - POSITION, 1)[0]) < 2e-4  # a tenth of the zero error


def test_motion_that_does_not_turn_tells_no_drift() -> None:
    position, note = integrate_velocity(TIME, np.full(COUNT, 0.01))
    np.testing.assert_allclose(np.ptp(position), 0.01 * TIME[-1])
    assert "turns too rarely to tell a drift" in note


def test_the_memory_of_a_long_text_is_bounded_by_its_numbers(tmp_path: Path) -> None:
    rows = 200_000
    line = "{:.3f};0,002;0,003;a remark that nobody reads, again and again and again\n"
    lines = (line.format(1e-3 * number).replace(".", ",") for number in range(rows))
    (tmp_path / "a.txt").write_text("t [s];x [m];F [N];remark\n" + "".join(lines))
    tracemalloc.start()
    read_foreign(tmp_path / "a.txt", Mapped(current=0.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * rows * 4 * 6  # the file itself has 14 MB


def test_a_workbook_that_unpacks_to_too_much_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("mrd_runs.importing.sheet._LARGEST_PART", 1000)
    book = openpyxl.Workbook()
    for _ in range(200):
        book.active.append([1.0, 2.0, 3.0])
    book.save(tmp_path / "a.xlsx")
    with pytest.raises(InputError, match="unpacks to more than"):
        read_foreign(tmp_path / "a.xlsx")


def test_no_workbook_stays_open(tmp_path: Path, monkeypatch) -> None:
    book = openpyxl.Workbook()
    for row in np.column_stack([TIME, POSITION, FORCE])[:50].tolist():
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    opened: list[Any] = []
    open_file = io.open

    def listed(*arguments: Any, **options: Any) -> Any:
        opened.append(open_file(*arguments, **options))
        return opened[-1]

    monkeypatch.setattr("io.open", listed)
    read_sheet_table(tmp_path / "a.xlsx")
    assert opened
    assert all(file.closed for file in opened)


@pytest.mark.parametrize("name", ["a.mat", "a.h5", "a.tdms"])
def test_files_of_too_many_values_are_refused(tmp_path: Path, monkeypatch, name: str) -> None:
    for module in ("matlab", "hdf5", "tdms"):
        monkeypatch.setattr(f"mrd_runs.importing.{module}.MOST_VALUES", 500)
    series = {"time": TIME, "position": POSITION, "force": FORCE}
    path = tmp_path / name
    if name == "a.mat":
        scipy.io.savemat(path, series)
    elif name == "a.h5":
        with h5py.File(path, "w") as file:
            for key, values in series.items():
                file[key] = values
    else:
        with TdmsWriter(path) as writer:
            writer.write_segment([ChannelObject("g", key, values) for key, values in series.items()])
    with pytest.raises(InputError, match=r"values; split"):
        read_foreign(path, Mapped(current=0.0))
