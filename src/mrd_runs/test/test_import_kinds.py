"""Clocks, units and structures of other laboratories: each is read right, or refused in a line that names it.

Every kind has several variants. Where the shared cases are present, they are read as well.
"""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from mrd_runs import Run, read_run
from mrd_runs.importing.rates import facts_of_lines, stated_rate
from mrd_runs.importing.units import find_unit

RATE, COUNT = 200, 600
TIME = np.arange(COUNT) / RATE
CASES = Path(__file__).parents[4] / "shared/cases/imports"


def position(time: np.ndarray) -> np.ndarray:
    """In m; no shift of it looks like it."""
    return np.asarray(0.012 * np.sin(2 * np.pi * (0.8 * time + 0.2 * time**2)))


def force(time: np.ndarray) -> np.ndarray:
    """In N."""
    velocity = 0.012 * 2 * np.pi * (0.8 + 0.4 * time) * np.cos(2 * np.pi * (0.8 * time + 0.2 * time**2))
    return np.asarray(200 * np.tanh(30 * velocity) + 600 * velocity)


def shift(run: Run, values: np.ndarray, signal: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return how much later than the time of a run a channel runs, in s."""
    trials = np.arange(-0.2, 0.2, 2e-4)
    errors = [np.sqrt(np.mean((signal(run.time + trial) - values) ** 2)) for trial in trials]
    assert min(errors) < 0.02 * np.std(values), "is no recording of the motion"
    return float(trials[int(np.argmin(errors))])


def delay(run: Run) -> float:
    """Return how much later the force is than the position, in s."""
    return shift(run, run.position, position) - shift(run, run.force, force)


def check(run: Run, count: int = COUNT, rate: float = RATE, tolerance: float = 0.0) -> None:
    assert abs(len(run) - count) <= tolerance * count
    assert run.rate == pytest.approx(rate, rel=1e-3)
    assert abs(delay(run)) < 1.001e-3


@pytest.fixture
def imported(import_tool: Any, tmp_path: Path) -> Callable[..., list[Run] | str]:
    """Import a file as typed; the runs in the order of their bags' names, or the line of the refusal."""
    turns = iter(range(1000))

    def run(arguments: str) -> list[Run] | str:
        folder = tmp_path / f"bags{next(turns)}"
        code, _, error = import_tool(f"{arguments} --output {folder}")
        if code:
            assert code == 2
            assert error.count("\n") == 1
            assert not folder.exists()
            return error
        return [read_run(bag) for bag in sorted(folder.iterdir())]

    return run


def only(runs: list[Run] | str) -> Run:
    assert isinstance(runs, list), runs
    (run,) = runs
    return run


def proposal(error: list[Run] | str) -> str:
    """Return the options that a refusal proposes."""
    assert isinstance(error, str)
    return error.partition("right of: ")[2].partition(" (columns: ")[0].partition(" (numbers in it")[0]


def table(path: Path, header: str, *columns: Any, above: str = "", delimiter: str = ",") -> Path:
    rows = (
        delimiter.join(cell if isinstance(cell, str) else f"{cell:.6f}" for cell in row)
        for row in zip(*columns, strict=True)
    )
    path.write_text(above + header + "\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


# Units

UNITS = {"position": 1e3 * position(TIME), "force": force(TIME)}


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("Time (sec),Displacement (inches),Force (lbs)", (1, 1 / 0.0254, 1 / 4.4482216)),
        ("Time [ms],Stroke [mils],Load [kip]", (1e3, 1 / 2.54e-5, 1 / 4448.2216)),
        ("time_ms,disp_in,force_kN", (1e3, 1 / 0.0254, 1e-3)),
        ("Time (min),Position (ft),Force (kgf)", (1 / 60, 1 / 0.3048, 1 / 9.80665)),
        ("t_us,position_um,load_lbf", (1e6, 1e6, 1 / 4.4482216)),
        ("Time/s,Weg/cm,Kraft/daN", (1, 100, 0.1)),
        ("timeMs,positionMm,forceN", (1e3, 1e3, 1)),
        ("Time,Position,Force\nSec,Inches,Pounds", (1, 1 / 0.0254, 1 / 4.4482216)),
        ("Time,Position,Force\n(s),(mm),(kg)", (1, 1e3, 1 / 9.80665)),
        ("Time (s) ch0,Position (mm) ch1,Force (kN) ch2", (1, 1e3, 1e-3)),
    ],
)
def test_units_are_converted_wherever_they_stand(imported: Any, tmp_path: Path, header: str, factors: Any) -> None:
    values = (TIME, position(TIME), force(TIME))
    columns = [[f"{value:.9g}" for value in factor * column] for factor, column in zip(factors, values, strict=True)]
    table(tmp_path / "a.csv", header, *columns)
    run = only(imported("a.csv --current 0.5"))
    np.testing.assert_allclose(run.time, TIME, atol=1e-6)
    np.testing.assert_allclose(run.position, position(TIME), atol=1e-7)
    np.testing.assert_allclose(run.force, force(TIME), atol=1e-3)


@pytest.mark.parametrize(("name", "factor"), [("Amps", 1.0), ("coil amperage", 1.0), ("Milliamps mA", 1e3)])
def test_a_current_may_be_named_by_its_unit(imported: Any, tmp_path: Path, name: str, factor: float) -> None:
    """The proposed mapping left such a column out, and gave a constant current instead."""
    current = 0.5 + 0.4 * np.sin(TIME)
    values = TIME, position(TIME), force(TIME), factor * current
    table(tmp_path / "a.csv", f"time_s,position_m,force_N,{name}", *([f"{value:.9g}" for value in each] for each in values))
    np.testing.assert_allclose(only(imported("a.csv")).current, current, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("velocity_mm_s", 1e3),
        ("velocity (in/s)", 1 / 0.0254),
        ("v [km/h]", 3.6),
        ("Speed_ft_per_s", 1 / 0.3048),
        ("vel mm/min", 6e4),
    ],
)
def test_velocities_are_converted(imported: Any, tmp_path: Path, name: str, factor: float) -> None:
    velocity = np.gradient(position(TIME), TIME)
    columns = [[f"{value:.9g}" for value in column] for column in (TIME, position(TIME), factor * velocity, force(TIME))]
    table(tmp_path / "a.csv", f"time_s,position_m,{name},force_N", *columns)
    np.testing.assert_allclose(only(imported("a.csv --current 0")).velocity, velocity, atol=1e-6)


@pytest.mark.parametrize(
    ("quantity", "unit", "expected"),
    [
        *(("velocity", text, "mm/s") for text in ("mm_s", "mm s^-1", "mm/sec", "mm·s⁻¹", "mm per s", "mmps")),
        *(("acceleration", text, "m/s2") for text in ("m/s²", "m_s2", "m/s^2", "m s-2", "m/s/s", "m/sec^2", "m_per_s2")),
        *(("force", text, "lbf") for text in ("lbs", "lb", "LBF", "pounds")),
        *(("position", text, "in") for text in ('"', "inch", "Inches")),
        *(("temperature", text, "°F") for text in ("degF", "F", "deg F", "Fahrenheit")),
        ("force", "MN", "MN"),
        ("force", "mN", "mN"),
        ("position", "μm", "µm"),
        ("force", "furlongs", None),
        ("velocity", "mm", None),
    ],
)
def test_a_unit_is_known_however_it_is_written(quantity: str, unit: str, expected: str | None) -> None:
    assert find_unit(quantity, unit) == expected


@pytest.mark.parametrize("name", ["Force (foo)", "Force [ADC]", "Force [V]", "force_mV", "Force <psi>", "force_foo/s"])
def test_an_unknown_unit_is_refused_by_its_name(imported: Any, tmp_path: Path, name: str) -> None:
    table(tmp_path / "a.csv", f"Time (s),Position (mm),{name}", TIME, 1e3 * position(TIME), 1e-3 * force(TIME))
    error = imported("a.csv --current 0.5")
    assert isinstance(error, str)
    unit = re.split(r"[\[(<_]", name)[1].strip("])>")
    assert f"the force is in {unit}, expected N, kN" in error
    check(only(imported('a.csv --current 0.5 --units force="1000 N"')))


def test_an_unknown_unit_in_a_row_of_units_is_refused(imported: Any, tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "Time,Position,Force\ns,mm,furlong", TIME, 1e3 * position(TIME), force(TIME))
    assert "the force is in furlong" in imported("a.csv --current 0.5")


def test_a_quantity_in_volts_and_in_its_unit_is_taken_in_its_unit(imported: Any, tmp_path: Path) -> None:
    both = (TIME, force(TIME) / 200, force(TIME), 0.1e3 * position(TIME), 1e3 * position(TIME))
    table(tmp_path / "a.csv", "Time (s),Force (V),Force (N),Displacement (V),Displacement (mm)", *both)
    table(tmp_path / "b.csv", "Time_s,Load_mV,Load_kN,LVDT_V,LVDT_mm", TIME, 5 * both[1], 1e-3 * both[2], *both[3:])
    proposed = proposal(imported("a.csv"))
    assert proposed == "--map time='Time (s)' position='Displacement (mm)' force='Force (N)' --current 0"
    check(only(imported(f"a.csv {proposed}")))
    check(only(imported("b.csv --current 0")))


# Structures


def test_a_text_in_a_column_drops_no_rows_and_no_names(imported: Any, tmp_path: Path) -> None:
    marks = [""] * COUNT
    marks[150], marks[420] = "marker 1", "marker 2"
    table(tmp_path / "a.csv", "Time (s),Position (mm),Force (N),Event", TIME, 1e3 * position(TIME), force(TIME), marks)
    states = np.where(np.arange(COUNT) % 7, "ok", "").tolist()
    table(
        tmp_path / "b.txt",
        "State;Time (s);Position (mm);Force (N)",
        states,
        TIME,
        1e3 * position(TIME),
        force(TIME),
        delimiter=";",
    )
    rows = (f"{t:.4f}\t{1e3 * position(t):.5f}\t{force(t):.4f}" + ("\tDAQ Start" if t == 0 else "") for t in TIME)
    (tmp_path / "c.txt").write_text("Time (s)\tPosition (mm)\tForce (N)\tEvents\n" + "\n".join(rows))
    for name, column in (("a.csv", "Event"), ("b.txt", "State"), ("c.txt", "Events")):
        run = only(imported(f"{name} --current 0.5"))
        check(run)
        assert any(f"not used: {column} (text)" in note for note in run.info["notes"])


def test_a_rate_above_a_table_without_times_is_used(imported: Any, tmp_path: Path) -> None:
    columns = (1e3 * position(TIME), force(TIME))
    table(tmp_path / "a.txt", "Position mm, Force N", *columns, above="Header Size: 3\nSampling Rate:  200\n")
    table(tmp_path / "b.csv", "Weg [mm];Kraft [N]", *columns, above="Abtastintervall;5 ms\n", delimiter=";")
    scipy.io.savemat(tmp_path / "c.mat", {"fs": 200.0, "x_mm": columns[0], "F_N": columns[1]})
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file.attrs["sample_rate"] = 200.0
        file["position"], file["force"] = columns[0] / 1e3, columns[1]
    book = openpyxl.Workbook()
    for row in (["Scan rate [Hz]", 200], ["Position (mm)", "Force (N)"], *np.transpose(columns).tolist()):
        book.active.append(row)
    book.save(tmp_path / "e.xlsx")
    for name in ("a.txt", "b.csv", "c.mat", "d.h5", "e.xlsx"):
        run = only(imported(f"{name} --current 0.5"))
        check(run)
        assert "the sample rate of 200 Hz is the one that the file states" in run.info["notes"]


@pytest.mark.parametrize(
    ("line", "rate"),
    [
        *((f"{name} 2{mark}000 Hz", 2000.0) for name in ("Sample Rate:", "Abtastrate;") for mark in " '’\u00a0\u202f"),
        *(("Sample Rate: 1,000 Hz", 1000.0), ("Sample Rate: 10,000.5 Hz", 10000.5), ("Rate of 3", None)),
        *(("Sample Rate: 2.048 kHz", 2048.0), ("Abtastrate;1000,5", 1000.5), ("Sample interval: 1.000 ms", 1000.0)),
        *(("Sample Rate: 10,000 Hz", None), ("Abtastrate;10.000", None), ("Sample Rate,10,000 Hz", None)),
        *(("Sample Rate,1000,4096", None), ("Sample Rate: 100 1000", None), ("Sample interval,0.004,s", 250.0)),
        ("Sample Rate;1000;1000", 1000.0),
    ],
)
def test_a_stated_rate_is_read_whole_or_not_at_all(line: str, rate: float | None) -> None:
    assert stated_rate(facts_of_lines([line])) == pytest.approx(rate)
    assert stated_rate([("Sample Rate", 10.125)]) == 10.125  # a number of a file that holds numbers is no text


def test_a_rate_that_may_be_two_is_asked_for(imported: Any, tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "Position mm,Force N", 1e3 * position(TIME), force(TIME), above="Sample Rate: 10,000 Hz\n")
    assert "--rate HZ" in imported("a.csv --current 0.5")


def test_a_counter_tells_which_samples_are_missing(imported: Any, tmp_path: Path) -> None:
    kept = np.r_[0:300, 320:COUNT]
    counter = [str(number % 65536) for number in kept + 65400]  # of 16 bits
    table(
        tmp_path / "a.txt",
        "Sample Number,Position mm,Force N",
        counter,
        1e3 * position(TIME[kept]),
        force(TIME[kept]),
        above="Sampling Rate: 200\n",
    )
    run = only(imported("a.txt --current 0.5"))
    np.testing.assert_allclose(run.time, TIME[kept], atol=1e-9)
    assert any("20 samples are missing by Sample Number" in note for note in run.info["notes"])


@pytest.mark.parametrize("counter", ["frame", "Sample", "Row"])
def test_a_counter_is_not_proposed_as_time(imported: Any, tmp_path: Path, counter: str) -> None:
    numbers = [str(number) for number in range(COUNT)]
    table(tmp_path / "a.txt", f"{counter},Position mm,Force N", numbers, 1e3 * position(TIME), force(TIME))
    error = imported("a.txt --current 0.5")
    assert "--rate HZ" in error
    assert f"time={counter}" not in error
    check(only(imported("a.txt --current 0.5 --rate 200")))


def simulink(time: Any, signals: dict[str, np.ndarray]) -> dict[str, Any]:
    entries = np.zeros(len(signals), [("values", object), ("dimensions", object), ("label", object)])
    for entry, (label, values) in zip(entries, signals.items(), strict=True):
        entry["values"], entry["dimensions"], entry["label"] = values[:, None], 1.0, label
    return {"time": time, "signals": entries, "blockName": "rig/To Workspace"}


def test_structures_of_matlab_are_read(imported: Any, tmp_path: Path) -> None:
    x, F = 1e3 * position(TIME), force(TIME)
    scipy.io.savemat(tmp_path / "a.mat", {"log": simulink(TIME[:, None], {"Position_mm": x, "Force_N": F})})
    other = {"out": simulink(TIME, {"rod displacement [mm]": x}), "out2": simulink(TIME, {"load (kN)": 1e-3 * F})}
    scipy.io.savemat(tmp_path / "b.mat", other)
    late = {"Time": TIME[4:], "Data": F[4:] * 1e-3, "DataInfo": {"Units": "kN"}, "Name": "force"}
    scipy.io.savemat(
        tmp_path / "c.mat", {"ts1": {"Time": TIME, "Data": x, "DataInfo": {"Units": "mm"}, "Name": "position"}, "ts2": late}
    )
    scipy.io.savemat(
        tmp_path / "d.mat",
        {
            "rig": {
                "time": {"values": TIME, "units": "s"},
                "stroke": {"values": x, "units": "mm"},
                "load": {"values": F, "units": "N"},
            }
        },
    )
    rows = np.zeros(COUNT, [("t", object), ("x_mm", object), ("F_N", object)])
    for row, values in zip(rows, zip(TIME, x, F, strict=True), strict=True):
        row["t"], row["x_mm"], row["F_N"] = values
    scipy.io.savemat(tmp_path / "e.mat", {"samples": rows})
    for name in ("a.mat", "b.mat", "d.mat", "e.mat"):
        check(only(imported(f"{name} --current 0.5")))
    run = only(imported("c.mat --current 0.5"))
    check(run, COUNT - 4)
    assert not run.clocks_agree("position", "force")


def test_objects_of_matlab_are_named(imported: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        for name, kind in (("log", "timeseries"), ("runs", "table")):
            file[name] = np.array([[3707764736, 2, 1, 1, 1, 1]], np.uint32)
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
            file[name].attrs["MATLAB_object_decode"] = np.int32(3)
    with (tmp_path / "a.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    error = imported("a.mat --current 0")
    assert "log is a timeseries of MATLAB" in error
    assert "runs is a table of MATLAB" in error
    scipy.io.savemat(tmp_path / "b.mat", {"note": "no numbers here", "cells": np.array(["a", "b"], object)})
    assert "note is text" in imported("b.mat --current 0")


def packed(path: Path, attributes: dict[str, Any], values: np.ndarray) -> Path:
    with h5py.File(path, "w") as file:
        file["time"], file["position"] = TIME, 1e3 * position(TIME)
        file["position"].attrs["units"] = "mm"
        file["force"] = values
        file["force"].attrs.update({"units": "N"} | attributes)
    return path


def test_packed_numbers_are_unpacked(imported: Any, tmp_path: Path) -> None:
    counts = np.round(force(TIME) / 0.01).astype(np.int16)
    packed(tmp_path / "a.h5", {"scale_factor": 0.01, "add_offset": 0.0}, counts)
    packed(
        tmp_path / "b.nc",
        {"scale_factor": np.array([0.02]), "add_offset": 50.0},
        np.round((force(TIME) - 50) / 0.02).astype(np.int16),
    )
    for name in ("a.h5", "b.nc"):
        np.testing.assert_allclose(only(imported(f"{name} --current 0")).force, force(TIME), atol=0.02)


@pytest.mark.parametrize("name", ["gain", "calibration_factor", "Offset", "slope"])
def test_a_scale_that_is_not_understood_is_named(imported: Any, tmp_path: Path, name: str) -> None:
    packed(tmp_path / "a.h5", {name: 0.5}, force(TIME) / 2)
    error = imported("a.h5 --current 0")
    assert f"force has the attribute {name} = 0.5, which is not applied" in error
    check(only(imported('a.h5 --current 0 --units force="2 N"')))
    with TdmsWriter(tmp_path / "b.tdms") as writer:
        channels = {"time": TIME, "position": position(TIME), "force": force(TIME)}
        writer.write_segment(
            [ChannelObject("g", key, values, {name: 0.5} if key == "force" else {}) for key, values in channels.items()]
        )
    assert f"force has the attribute {name} = 0.5" in imported("b.tdms --current 0")


@pytest.mark.parametrize("end", ["mat", "h5"])
def test_a_unit_and_a_scale_beside_a_channel_are_told(imported: Any, tmp_path: Path, end: str) -> None:
    def written(name: str, **beside: Any) -> None:
        content = {
            "time": TIME,
            "position": 1e3 * position(TIME),
            "force": 1e-3 * force(TIME),
            "position_unit": "mm",
        } | beside
        if end == "mat":
            scipy.io.savemat(tmp_path / f"{name}.mat", content)
            return
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            for key, value in content.items():
                file[f"rig/{key}"] = value

    written("units", unit_force="kN", gain=4.0)
    run = only(imported(f"units.{end} --current 0"))
    check(run)
    assert any(note.startswith("gain = 4") for note in run.info["notes"])
    written("unknown", force_unit="smoots")
    assert "the force is in smoots, expected N" in imported(f"unknown.{end} --current 0")
    written("scaled", force_unit="N", force_scale=1e3)
    assert "force_scale = 1000, which is not applied" in imported(f"scaled.{end} --current 0")
    check(only(imported(f'scaled.{end} --current 0 --units force="1000 N"')))


@pytest.mark.parametrize("number", ["-9999", "-999.25", "1e30", "-32768", "99999"])
@pytest.mark.parametrize("channel", ["force", "position"])
def test_a_number_that_stands_for_a_missing_value_is_refused(
    imported: Any, tmp_path: Path, number: str, channel: str
) -> None:
    columns = {"time": TIME, "position": 1e3 * position(TIME), "force": 0.1 * force(TIME), "temperature": 20 + 0 * TIME}
    rows = [[f"{value:.9g}" for value in row] for row in zip(*columns.values(), strict=True)]
    header = "time (s),position (mm),force (N),temperature (degC)"

    def written(name: str) -> None:
        (tmp_path / name).write_text("\n".join([header, *(",".join(row) for row in rows)]))

    rows[50][3] = rows[51][3] = number
    written("optional.csv")
    run = only(imported("optional.csv --current 0"))
    assert run.temperature is None
    assert "the temperature is left out: 2 of 600 values are not numbers" in run.info["notes"]
    rows[70][list(columns).index(channel)] = number
    written("needed.csv")
    error = imported("needed.csv --current 0")
    assert f"line 72: {channel} (" in error
    assert f"is {float(number):.9g}, as in 1 sample, and all others lie between" in error


@pytest.mark.parametrize(
    "header", ["Velocity (mm/s),Rebound force (N),Compression force (N)", "Speed [m/s],Force [N]", "v,F"]
)
def test_a_table_of_peak_forces_is_no_time_series(imported: Any, tmp_path: Path, header: str) -> None:
    speeds = np.tile(np.arange(1.0, 21.0), 4)
    others = [120 + 0.6 * speeds] * header.count(",")
    table(tmp_path / "a.csv", header, speeds, *others)
    table(tmp_path / "b.csv", header, speeds[:20], *(other[:20] for other in others))
    for name in ("a.csv", "b.csv"):
        error = imported(f"{name} --current 0")
        assert "no time series" in error
        assert "--map" not in error


# Times in tables


def clock(form: str, time: np.ndarray, start: float = 3600 * 12 + 59 * 60 + 59) -> list[str]:
    """Times of day as text; H, I, M, S stand for hour, hour of twelve, minute, second, f for the milliseconds, p for AM."""
    texts = []
    for of_day in (start + time) % 86400:
        total = round(1000 * of_day)
        hour, minute, second, part = total // 3600000 % 24, total // 60000 % 60, total // 1000 % 60, total % 1000
        fields = {"H": f"{hour:02d}", "I": f"{(hour - 1) % 12 + 1:02d}", "M": f"{minute:02d}", "S": f"{second:02d}"}
        fields |= {"f": f"{part:03d}", "p": "AM" if hour < 12 else "PM"}
        texts.append(re.sub(r"[HIMSfp](?![a-z])", lambda match, of=fields: of[match[0]], form))
    return texts


@pytest.mark.parametrize("start", [46799.0, 86399.0], ids=["over an hour", "over midnight"])
@pytest.mark.parametrize(
    "form",
    ["H:M:S.f", "I:M:S.f p", "01/05/2026 I:M:S.f p", "5/1/26 H:M:S.f", "M:S.f", "H:M:S:f", "H:M:S.f+01:00", "H:M:S.f UTC"],
)
def test_times_of_day_of_every_kind(imported: Any, tmp_path: Path, form: str, start: float) -> None:
    table(tmp_path / "a.csv", "Time,Position (mm),Force (N)", clock(form, TIME, start), 1e3 * position(TIME), force(TIME))
    check(only(imported("a.csv --current 0.5")))


def test_date_and_time_in_two_columns(imported: Any, tmp_path: Path) -> None:
    for number, date in enumerate(("2026-01-05", "05.01.2026", "1/5/2026")):
        dates = [date] * COUNT
        table(
            tmp_path / f"{number}.csv",
            "Date,Time,Position (mm),Force (N)",
            dates,
            clock("H:M:S.f", TIME),
            1e3 * position(TIME),
            force(TIME),
        )
        check(only(imported(f"{number}.csv --current 0.5")))


@pytest.mark.parametrize("digits", [0, 2])
def test_coarse_stamps_are_answered_with_the_option_that_cures(imported: Any, tmp_path: Path, digits: int) -> None:
    time = [f"{np.floor(value * 10**digits) / 10**digits:.{digits}f}" for value in TIME + 0.0001]
    columns = (time, 1e3 * position(TIME), force(TIME))
    table(tmp_path / "a.csv", "Time (s),Position (mm),Force (N)", *columns)
    error = imported("a.csv --current 0.5")
    assert isinstance(error, str)
    option = re.search(r"--rate [\d.]+", error)
    assert option is not None
    check(only(imported(f"a.csv --current 0.5 {option[0]}")))
    table(tmp_path / "b.csv", "Time (s),Position (mm),Force (N)", *columns, above="Sample Rate: 200 Hz\n")
    check(only(imported("b.csv --current 0.5")))


def test_rows_that_come_twice_are_dropped_with_a_word(imported: Any, tmp_path: Path) -> None:
    twice = np.sort(np.r_[np.arange(COUNT), 100, 101, 333])
    table(
        tmp_path / "a.csv", "Time (s),Position (mm),Force (N)", TIME[twice], 1e3 * position(TIME[twice]), force(TIME[twice])
    )
    run = only(imported("a.csv --current 0.5"))
    check(run)
    assert any("3 with the time of another one were dropped" in note for note in run.info["notes"])


@pytest.mark.parametrize("bits", [16, 32])
def test_counters_of_time_that_wrap_go_on(imported: Any, tmp_path: Path, bits: int) -> None:
    unit, factor = ("ms", 1e3) if bits == 16 else ("us", 1e6)
    ticks = [str(int(tick) % 2**bits) for tick in np.round(factor * TIME) + 2**bits - factor]
    table(tmp_path / "a.csv", f"Time ({unit}),Position (mm),Force (N)", ticks, 1e3 * position(TIME), force(TIME))
    run = only(imported("a.csv --current 0.5"))
    check(run)
    assert any("begin again" in note for note in run.info["notes"])


def test_a_clock_that_is_set_back_makes_passes(imported: Any, tmp_path: Path) -> None:
    half = TIME[: COUNT // 2]
    for name, later in (("a", half), ("b", half[:200]), ("c", half + 0.5)):
        written = np.r_[half, later] if name != "c" else np.r_[half + 5, later]
        moved = np.r_[half, later] if name != "c" else np.r_[half, half]
        noise = np.random.default_rng(0).normal(0, 1e-3, len(moved))
        table(
            tmp_path / f"{name}.csv",
            "Time (s),Position (mm),Force (N)",
            written,
            1e3 * position(moved) + noise,
            force(moved),
        )
        runs = imported(f"{name}.csv --current 0.5")
        assert isinstance(runs, list)
        assert [len(run) for run in runs] == [300, 200 if name == "b" else 300]
        for run in runs:
            check(run, len(run))
            assert any("jump back by" in note for note in run.info["notes"])


def test_blocks_of_one_file_are_passes(imported: Any, tmp_path: Path) -> None:
    half = TIME[: COUNT // 2]
    header = "Time (s),Position (mm),Force (N)"
    block = table(tmp_path / "a.csv", header, half, 1e3 * position(half), force(half)).read_text()
    text = block + "\nData Acquisition,2\n" + block.replace(header, f"{header}\ns,mm,N")
    (tmp_path / "a.csv").write_text(text)
    runs = imported("a.csv --current 0.5")
    assert isinstance(runs, str), "two blocks of the same samples are one recording twice"
    later = table(tmp_path / "b.csv", header, half, 1.1e3 * position(half), 1.1 * force(half)).read_text()
    (tmp_path / "b.csv").write_text(f"{block}\nData Acquisition,2\n{later}")
    runs = imported("b.csv --current 0.5")
    assert isinstance(runs, list)
    assert [len(run) for run in runs] == [300, 300]
    (tmp_path / "c.csv").write_text(block + later.replace(header, "Time (s),Force (N),Position (mm)"))
    assert "line 302: begins a table with other columns or units" in imported("c.csv --current 0.5")


def test_a_wrong_time_is_dropped_with_a_word(imported: Any, tmp_path: Path) -> None:
    for name, index, wrong in (("a", 0, 0.0), ("b", 300, 0.0), ("c", 599, 3e8), ("d", 17, 3e8)):
        time = TIME + 1000.0
        time[index] = wrong
        table(tmp_path / f"{name}.csv", "Time (s),Position (mm),Force (N)", time, 1e3 * position(TIME), force(TIME))
        run = only(imported(f"{name}.csv --current 0.5"))
        assert len(run) == COUNT - 1
        assert any("1 of 600 has a time far from all others" in note for note in run.info["notes"])
        assert run.duration < 3.0


# Formats of programs

MTS = "MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\nData Acquisition: 1\t\t\tTime:\t3.0\tSec\n"
LVM = "LabVIEW Measurement\nX_Columns\t{}\n***End_of_Header***\t\nDelta_X\t0.005\t0.005\n***End_of_Header***\t\t\n"


def test_files_of_labview_and_of_test_machines(imported: Any, tmp_path: Path) -> None:
    x, F = 1e3 * position(TIME), force(TIME)
    names = ["X_Value", "Position (mm)", "X_Value", "Force (N)", "Comment"]
    table(
        tmp_path / "a.lvm",
        "\t".join(names),
        TIME[20:],
        x[20:],
        TIME[16:-4],
        F[16:-4],
        above=LVM.format("Multi"),
        delimiter="\t",
    )
    empty = [""] * COUNT
    table(
        tmp_path / "b.lvm", "X_Value\tPosition (mm)\tForce (N)\tComment", empty, x, F, above=LVM.format("No"), delimiter="\t"
    )
    index = [str(number) for number in range(COUNT)]
    table(tmp_path / "c.csv", "Index,Time,Position,Force\n-,s,mm,N", index, TIME, x, F)
    for name in ("a.lvm", "b.lvm", "c.csv"):
        run = only(imported(f"{name} --current 0"))
        assert abs(delay(run)) < 1e-3
        assert len(run) >= COUNT - 24


def test_blocks_of_one_running_clock_are_passes_where_it_has_a_gap(imported: Any, tmp_path: Path) -> None:
    names = "Time\tAxial Displacement\tAxial Force\nSec\tmm\tkN\n"
    blocks = []
    for start, factor in ((0.0, 1.0), (20.0, 1.1)):
        rows = (f"{t + start:.6f}\t{1e3 * factor * position(t):.6f}\t{1e-3 * force(t):.6f}" for t in TIME[:300])
        blocks.append(MTS + names + "\n".join(rows))
    (tmp_path / "a.dat").write_text("\n\n".join(blocks) + "\n")
    runs = imported("a.dat --current 0")
    assert isinstance(runs, list)
    assert [len(run) for run in runs] == [300, 300]
    assert any("the times jump on by 18.5 s: 2 passes" in note for note in runs[0].info["notes"])


def test_columns_that_attributes_name_are_called_so(imported: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["rig/data"] = np.column_stack([TIME, 1e3 * position(TIME), force(TIME)])
        file["rig/data"].attrs.update({"columns": ["time", "position", "force"], "units": ["s", "mm", "N"]})
    check(only(imported("a.h5 --current 0")))


def test_a_unit_that_is_not_told_is_asked_for_with_its_option(imported: Any, tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "time,disp,load", TIME, 1e3 * position(TIME), force(TIME))
    error = imported("a.csv --current 0")
    assert isinstance(error, str)
    assert error.endswith("is it in mm? Say so with --units position=UNIT\n")
    check(only(imported("a.csv --current 0 --units position=mm")))


# Several times in a table

FIRST, SECOND = TIME[20:], TIME[16:-4]  # of the same length, 20 ms apart


def two_times(header: str) -> Callable[[Path], None]:
    return lambda path: table(path, header, FIRST, 1e3 * position(FIRST), SECOND, force(SECOND)) and None


def write_workbook(path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.append(["Time (s)", "Position (mm)", "Time (s)", "Force (N)"])
    fast = np.arange(0, 3, 1e-3)
    for row in range(len(fast)):
        slow = [TIME[row], 1e3 * position(TIME[row])] if row < COUNT else [None, None]
        book.active.append(
            [*(None if cell is None else float(cell) for cell in slow), float(fast[row]), float(force(fast[row]))]
        )
    book.save(path)


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["lvdt/time"], file["lvdt/position"] = FIRST, position(FIRST)
        file["cell/time"], file["cell/force"] = SECOND, force(SECOND)


def write_tdms(path: Path, **properties: Any) -> None:
    start = np.datetime64("2026-01-05T10:00:00")
    waves = {
        "Position": (1e3 * position(FIRST), {"wf_increment": 1 / RATE, "unit_string": "mm"}, FIRST[0]),
        "Force": (force(SECOND), {"wf_increment": 1 / RATE, "unit_string": "N"}, SECOND[0]),
    }
    channels = []
    for name, (values, facts, begin) in waves.items():
        facts |= (
            {"wf_start_time": start + np.timedelta64(round(1e6 * begin), "us")}
            if not properties
            else {"wf_start_offset": begin}
        )
        channels.append(ChannelObject("Rig", name, values, facts))
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)


def write_tdms_groups(path: Path) -> None:
    stamps = np.datetime64("2026-01-05T10:00:00") + (1e6 * TIME).astype("timedelta64[us]")
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [ChannelObject("lvdt", "time", stamps[20:]), ChannelObject("lvdt", "position", position(FIRST))]
        )
        writer.write_segment([ChannelObject("cell", "time", stamps[16:-4]), ChannelObject("cell", "force", force(SECOND))])


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.csv", two_times("Time (s),Position (mm),Time (s),Force (N)")),
        ("b.csv", two_times("X_Time,Position (mm),Y_Time,Force (N)")),
        ("c.csv", two_times("Position time [s],Position [mm],Force time [s],Force [N]")),
        ("d.xlsx", write_workbook),
        ("e.h5", write_hdf5),
        ("f.tdms", write_tdms),
        ("g.tdms", lambda path: write_tdms(path, offset=True)),
        ("h.tdms", write_tdms_groups),
    ],
)
def test_columns_with_times_of_their_own_are_put_onto_one(imported: Any, tmp_path: Path, name: str, write: Any) -> None:
    write(tmp_path / name)
    run = only(imported(f"{name} --current 0.5"))
    assert abs(delay(run)) < 1e-3
    assert not run.clocks_agree()
    assert not run.clocks_agree("position", "force")
    assert run.clocks_agree("position", "current")
    assert sum(note.startswith("times: ") for note in run.info["notes"]) == 1


def test_increments_that_differ_are_resampled_with_a_word(imported: Any, tmp_path: Path) -> None:
    fast = np.arange(0, 3, 1e-3)
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        slow = ChannelObject("Rig", "Position", 1e3 * position(TIME), {"wf_increment": 0.005, "unit_string": "mm"})
        writer.write_segment([slow, ChannelObject("Rig", "Force", force(fast), {"wf_increment": 0.001, "unit_string": "N"})])
    run = only(imported("a.tdms --current 0.5"))
    check(run, COUNT, tolerance=0.01)
    assert any("force is averaged between them" in note for note in run.info["notes"])


def test_waveforms_of_which_some_have_no_start_are_refused(imported: Any, tmp_path: Path) -> None:
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        start = {"wf_start_time": np.datetime64("2026-01-05T10:00:00"), "wf_increment": 0.005}
        channels = [
            ChannelObject("Rig", "Position", position(TIME), start),
            ChannelObject("Rig", "Force", force(TIME), {"wf_increment": 0.005}),
        ]
        writer.write_segment(channels)
    assert "some channels have a wf_start_time and others have none" in imported("a.tdms --current 0.5")


def test_one_time_of_a_table_is_one_clock(imported: Any, tmp_path: Path) -> None:
    table(tmp_path / "a.csv", "Time (s),Position (mm),Force (N)", TIME, 1e3 * position(TIME), force(TIME))
    table(tmp_path / "b.csv", "Time (s),Position (mm),Time (s),Force (N)", TIME, 1e3 * position(TIME), TIME, force(TIME))
    for name in ("a.csv", "b.csv"):
        run = only(imported(f"{name} --current 0.5"))
        assert run.clocks == {}
        assert run.clocks_agree("position", "force")


# Files


def test_files_of_one_channel_each_are_one_recording(imported: Any, tmp_path: Path) -> None:
    above = "Model,TBS1000\nSample Interval,0.005\n"
    table(tmp_path / "F1_position.csv", "Time (s),CH1 (mm)", TIME, 1e3 * position(TIME), above=above)
    table(tmp_path / "F1_force.csv", "Time (s),CH2 (N)", FIRST, force(FIRST), above=above)
    run = only(imported("F1_position.csv F1_force.csv --current 0.5"))
    assert abs(delay(run)) < 1e-3
    assert not run.clocks_agree("position", "force")
    assert "2 files of one channel each are one recording" in "; ".join(run.info["notes"])


@pytest.mark.parametrize("header", ["Position [mm],Force [N]", "x [mm],F [N]", "Weg,Kraft"])
def test_files_without_times_are_recordings_of_their_own(imported: Any, tmp_path: Path, header: str) -> None:
    factor = 1e3 if "mm" in header else 1.0
    for number in range(2):
        table(tmp_path / f"r{number}.csv", header, (factor + number) * position(TIME), (1 + number) * force(TIME))
    runs = imported(f"r0.csv r1.csv --current 0 --rate {RATE}")
    assert [len(run) for run in runs] == [len(TIME)] * 2
    error = imported("r0.csv r1.csv --current 0")
    assert "r0.csv" in error
    assert "time" in error


def test_folders_and_patterns_mean_what_is_in_them(import_tool: Any, imported: Any, tmp_path: Path) -> None:
    (tmp_path / "day").mkdir()
    for number in range(3):
        table(
            tmp_path / f"day/run{number}.csv",
            "Time (s),Position (mm),Force (N)",
            TIME,
            (1e3 + number) * position(TIME),
            force(TIME),
        )
    (tmp_path / "day/notes.pdf").write_bytes(b"%PDF")
    for arguments in ("day", "day/run*.csv", shlex.quote("day/run?.csv")):
        assert len(imported(f"{arguments} --current 0.5")) == 3
    assert "day/notes.pdf: not read, because of its ending" in import_tool("day --current 0.5 --output again")[2]
    assert "no file fits this pattern" in imported("'none*.csv' --current 0.5")
    (tmp_path / "empty").mkdir()
    assert "is a folder without a recording" in imported("empty --current 0.5")


# The shared cases

BAG = "--topics position='/joint_states.position[rod]' force={} --current 0.5"


@pytest.fixture
def case() -> Callable[[str], str]:
    def find(name: str) -> str:
        if not (CASES / name).exists():
            pytest.skip(f"no shared cases beside the workspace: {name}")
        return str(CASES / name)

    return find


def lag_of_peaks(run: Run) -> float:
    """Return by how much the force lags behind the velocity of the rod, in s, from their cross-correlation."""
    velocity = np.gradient(run.position, run.time)
    sign, other = np.tanh(20 * velocity / velocity.std()), run.force / run.force.std()
    lags = np.arange(-20, 21)
    scores = [np.mean(sign[25:-25] * np.roll(other, -lag)[25:-25]) for lag in lags]
    return float(lags[int(np.argmax(scores))] / run.rate)


@pytest.mark.parametrize(
    ("name", "options", "counts", "rate"),
    [
        ("zero_stamp.mcap", BAG.format("/ft.wrench.force.z"), [499], 200),
        ("two_clocks.mcap", BAG.format("/force.data"), [500], 200),
        ("sim_reset.mcap", BAG.format("/ft.wrench.force.z"), [250, 250], 200),
        ("far_stamp.mcap", BAG.format("/ft.wrench.force.z"), [499], 200),
        ("start_times.tdms", "--current 0.5", [1592], 200),
        ("cut.tdms", "--current 0.5", [900], 200),
        ("two_times.csv", "--current 0.5", [244], 100),
        ("lbs.csv", "--current 0.5", [300], 200),
        ("events.csv", "--current 0.5", [500], 200),
        ("daq_ampm.txt", "--current 0.5", [300], 200),
        ("volts_and_units.csv", "--current 0.5", [300], 200),
        ("simulink.mat", "--current 0.5", [1200], 200),
        ("packed.h5", "--current 0.5", [1200], 200),
    ],
)
def test_the_shared_cases(imported: Any, case: Any, name: str, options: str, counts: list[int], rate: float) -> None:
    runs = imported(f"{case(name)} {options}")
    assert isinstance(runs, list)
    assert [len(run) for run in runs] == pytest.approx(counts, abs=3)
    for run in runs:
        assert run.rate == pytest.approx(rate, rel=5e-3)
        assert 0.005 < np.ptp(run.position) < 0.03
        assert 250 < np.abs(run.force).max() < 290
        assert abs(lag_of_peaks(run)) <= 1.01 / run.rate
    if name in ("two_clocks.mcap", "start_times.tdms", "two_times.csv"):
        assert not runs[0].clocks_agree("position", "force")
    else:
        assert runs[0].clocks_agree("position", "force")


def test_the_shared_cases_that_are_refused(imported: Any, case: Any) -> None:
    error = imported(f"{case('no_definitions.db3')} --current 0.5")
    assert "no definition of this type in the bag: rig_msgs/msg/Sample" in error
    error = imported(f"{case('array20.mcap')} --current 0.5")
    assert "/rig.data[1]" in proposal(error)
    assert len(only(imported(f"{case('array20.mcap')} --current 0.5 {proposal(error)}"))) == 500
    assert "Position 5.995 s (1200 samples at 200 Hz) and Force 1.199 s (1200 samples at 1000 Hz)" in imported(
        f"{case('two_increments.tdms')} --current 0.5"
    )
    assert "no time series" in imported(f"{case('fv.xlsx')} --current 0.5")


@pytest.mark.parametrize(
    ("header", "usual", "spike", "option"),
    [
        ("temperature (degC)", 20.0, 1372.0, "--map temperature='temperature (degC)'"),
        ("acceleration (m/s2)", 0.1, 2e4, "--units acceleration=m/s2"),
        ("velocity (m/s)", 0.05, 300.0, "--units velocity=m/s"),
    ],
)
def test_a_channel_that_is_not_needed_does_not_stop_the_import(
    imported: Any, tmp_path: Path, header: str, usual: float, spike: float, option: str
) -> None:
    other = usual * np.cos(2 * np.pi * 0.8 * TIME)
    other[300] = spike
    table = np.stack([TIME, position(TIME), force(TIME), other], axis=1)
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=f"time (s),position (m),force (N),{header}", comments="")
    run = only(imported("a.csv --current 0"))
    assert getattr(run, header.split()[0]) is None or np.abs(run.velocity).max() < 1.0
    assert any(note.startswith(f"the {header.split()[0]} is left out: ") for note in run.info["notes"])
    assert isinstance(imported(f"a.csv --current 0 {option}"), str)


@pytest.mark.parametrize(
    ("quantity", "factor", "unit", "problem"),
    [
        ("time", 1e3, "ms", "the rod would move at up to 0.000"),
        ("position", 60.0, "mm", "the stroke would be 1.44 m, expected at most 0.4 m"),
        ("current", 15.0, "mA", "the current would be up to 15 A"),
    ],
)
def test_numbers_without_a_unit_are_doubted_at_the_ends_of_what_dampers_have(
    imported: Any, tmp_path: Path, quantity: str, factor: float, unit: str, problem: str
) -> None:
    time = np.arange(12_000) / 4000
    columns = {"time": time, "position": position(time), "force": force(time), "current": np.ones(len(time))}
    columns[quantity] = factor * columns[quantity]
    table(tmp_path / "a.csv", ",".join(columns), *columns.values())
    error = imported("a.csv")
    assert isinstance(error, str), error[0].info["notes"]
    assert problem in error
    assert f"{quantity}=UNIT" in error
    only(imported(f"a.csv --units {quantity}={unit}"))
    if quantity != "time":
        only(imported("a.csv --units time=s position=m current=A"))
