"""Names of columns as other laboratories write them: each unit is found, and nothing but a measurement is taken as one."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_runs import read_run
from mrd_runs.importing.quantities import unit_of
from mrd_runs.importing.table import Column
from mrd_runs.importing.units import UNITS, find_unit
from mrd_runs.importing.words import WORDS, is_measured, words_of

COUNT = 300
TIME = np.arange(COUNT) / 250
POSITION = 0.012 * np.sin(2 * np.pi * (0.8 * TIME + 0.2 * TIME**2))
VELOCITY = np.gradient(POSITION, TIME)
SIGNALS = {
    "time": TIME,
    "position": POSITION,
    "force": 200 * np.tanh(30 * VELOCITY) + 600 * VELOCITY,
    "current": 0.4 + 0.1 * TIME,
}
INCH, LBF = 0.0254, 4.4482216152605


def write(path: Path, header: str, *columns: Any) -> None:
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))
    path.write_text(f"{header}\n{rows}\n", encoding="utf-8")


@pytest.mark.parametrize(
    "header",
    [
        "Time {ms},Position {in},Force {lbf},Current {mA}",
        "Time.ms,Position.in,Force.lbf,Current.mA",
        "Time..ms.,Position..in.,Force..lbf.,Current..mA.",
        "Time:ms,Position:in,Force:lbf,Current:mA",
        "timems,posin,forcelbf,currentmA",
        "TimeMs,PosInches,ForceLbs,CurrentmA",
        "ms time,inch pos,lbf force,mA current",
        "[ms] Time,[in] Pos,[lbf] Force,[mA] Current",
        "ms,in,lbf,mA\nTime,Pos,Force,Current",
        "Time,Pos,Force,Current\nms,in,lbf,mA\nch0,ch1,ch2,ch3",
        "Time,Pos,Force,Current\nms,in,lbf,mA\nfloat,float,float,float",
        "Time,Pos,Force,Current\nms,in,lbf,mA\n----,----,----,----",
        "ch0,ch1,ch2,ch3\nTime,Pos,Force,Current\n\n{ms},{in},{lbf},{mA}",
    ],
)
def test_units_are_found_wherever_they_stand(import_tool: Any, tmp_path: Path, header: str) -> None:
    columns = (1e3 * TIME, POSITION / INCH, SIGNALS["force"] / LBF, 1e3 * SIGNALS["current"])
    write(tmp_path / "rig.csv", header, *columns)
    code, _, error = import_tool("rig.csv --output bags")
    assert code == 0, error
    run = read_run(tmp_path / "bags/rig")
    for values, expected in ((run.time, TIME), (run.position, POSITION), (run.force, SIGNALS["force"])):
        np.testing.assert_allclose(values, expected, atol=1e-6 * np.ptp(expected))
    np.testing.assert_allclose(run.current, SIGNALS["current"], atol=1e-6)


@given(st.data())
def test_a_unit_behind_a_word_is_found_with_any_mark_between(data: st.DataObject) -> None:
    quantity = data.draw(st.sampled_from(sorted(UNITS)))
    word = data.draw(st.sampled_from(sorted(word for word in WORDS[quantity] if len(word) > 2)))
    unit = data.draw(st.sampled_from(sorted(UNITS[quantity])))
    name = data.draw(
        st.sampled_from(["{} ({})", "{} [{}]", "{}{{{}}}", "{}_{}", "{} {}", "{}:{}", "{}.{}", "{}, {}", "{} / {}"])
    )
    assert find_unit(quantity, unit_of(quantity, Column(name.format(word, unit)))) == unit


@pytest.mark.parametrize(
    ("quantity", "name"),
    [
        ("position", "Position Demand (mm)"),
        ("position", "consigne deplacement (mm)"),
        ("position", "posicion consigna (mm)"),
        ("position", "Position Error (mm)"),
        ("force", "Peak Force (N)"),
        ("force", "Kraft Mittelwert (N)"),
        ("current", "Motor Current (A)"),
        ("current", "Servo_Current_A"),
    ],
)
def test_what_is_no_measurement_of_the_damper_is_never_taken(
    import_tool: Any, tmp_path: Path, quantity: str, name: str
) -> None:
    names = {"time": "Time (s)", "position": "Stroke (m)", "force": "Load (N)", "current": "Coil Current (A)"}
    write(tmp_path / "both.csv", ",".join([name, *names.values()]), 0.5 * SIGNALS[quantity], *SIGNALS.values())
    code, _, error = import_tool("both.csv --output bags")
    assert code == 0, error
    taken = {"position": "position", "force": "force", "current": "current"}[quantity]
    np.testing.assert_allclose(getattr(read_run(tmp_path / "bags/both"), taken), SIGNALS[quantity], rtol=1e-6, atol=1e-9)
    write(tmp_path / "alone.csv", ",".join({**names, quantity: name}.values()), *SIGNALS.values())
    code, _, error = import_tool("alone.csv --output more")
    assert code == 2
    assert f"the columns do not tell the {quantity}" in error


def test_minutes_are_no_minimum() -> None:
    assert is_measured("time", "Time")
    assert not is_measured("force", "Force min")
    assert words_of("Force_min") == ["force", "min"]


def test_a_current_is_no_acceleration(import_tool: Any, tmp_path: Path) -> None:
    write(tmp_path / "rig.csv", "time_s,pos_m,force_N,sensor_A", *SIGNALS.values())
    assert import_tool("rig.csv --current 0.5 --output bags")[0] == 0
    assert read_run(tmp_path / "bags/rig").acceleration is None


@pytest.mark.parametrize("name", ["Position x10 (mm)", "Position *100 [mm]", "Position/10 (mm)", "Position 10^3 (mm)"])
def test_a_factor_in_a_name_is_not_passed_over(import_tool: Any, tmp_path: Path, name: str) -> None:
    write(tmp_path / "rig.csv", f"Time (s),{name},Force (N)", TIME, POSITION, SIGNALS["force"])
    code, _, error = import_tool("rig.csv --current 0.5 --output bags")
    assert code == 2
    assert "10" in error.partition("the position is in ")[2][:8]
    assert import_tool('rig.csv --current 0.5 --units position="0.1 mm" --output bags')[0] == 0


def test_of_a_name_that_counts_compression_a_note_tells(import_tool: Any, tmp_path: Path) -> None:
    write(tmp_path / "rig.csv", "Time (s),Compression (m),Compressive Force (N)", TIME, -POSITION, -SIGNALS["force"])
    code, out, _ = import_tool("rig.csv --current 0.5 --output bags")
    assert code == 0
    assert "turn them with --flip position" in out
    assert "turn them with --flip force" in out
    out = import_tool("rig.csv --current 0.5 --flip position force --output turned")[1]
    assert "grow in compression" not in out
    np.testing.assert_allclose(read_run(tmp_path / "turned/rig").position, POSITION, atol=1e-9)
