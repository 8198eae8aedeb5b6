"""Tables of other laboratories: grouped thousands, dates, footers, further headers, times of few digits or none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_runs import Run, read_run
from mrd_runs.importing.clocks import find_passes, without_rounding
from mrd_runs.importing.text import guess_dialect
from mrd_runs.importing.time_of_day import clock_seconds

COUNT, RATE = 400, 250
TIME = np.arange(COUNT) / RATE
HEADER = "Time (s);Position (mm);Force (N)\n"


def position(time: np.ndarray) -> np.ndarray:
    return np.asarray(0.012 * np.sin(2 * np.pi * (0.8 * time + 0.2 * time**2)))


def force(time: np.ndarray) -> np.ndarray:
    return np.asarray(4000 * np.cos(2 * np.pi * (0.8 * time + 0.2 * time**2)) + 500)


def lines(time: np.ndarray = TIME, decimal: str = ".", grouped: str = "") -> list[str]:
    rows = zip(time, 1e3 * position(time), force(time), strict=True)
    marks = str.maketrans({",": grouped, ".": decimal})
    return [f"{t:.6f};{x:.6f}".replace(".", decimal) + ";" + f"{f:,.3f}".translate(marks) for t, x, f in rows]


@pytest.fixture
def imported(import_tool: Any, tmp_path: Path) -> Any:
    """Import a text; its run, or the line of the refusal."""

    def run(text: str, options: str = "") -> Run | str:
        (tmp_path / "rig.csv").write_text(text, encoding="utf-8")
        code, _, error = import_tool(f"rig.csv --current 0.5 {options} --output bags")
        assert error.count("\n") == (code != 0)
        return str(error) if code else read_run(tmp_path / "bags/rig")

    return run


def check(run: Run | str, count: int = COUNT) -> Run:
    assert isinstance(run, Run), run
    assert len(run) == count
    np.testing.assert_allclose(run.position, position(run.time), atol=1e-7)
    np.testing.assert_allclose(run.force, force(run.time), atol=1e-2)
    return run


@pytest.mark.parametrize(
    ("decimal", "grouped"), [(".", ","), (",", "."), (".", "'"), (".", "’"), (",", " "), (",", "\u202f"), (".", "\u00a0")]
)
def test_grouped_thousands_are_read(imported: Any, decimal: str, grouped: str) -> None:
    check(imported(HEADER + "\n".join(lines(decimal=decimal, grouped=grouped))))


@pytest.mark.parametrize("cell", ["1.034", "-12.345", "1.5"])
def test_a_point_among_decimal_commas_is_no_decimal_sign(imported: Any, cell: str) -> None:
    rows = lines(decimal=",")
    rows[200] = rows[200].rpartition(";")[0] + ";" + cell
    error = imported(HEADER + "\n".join(rows))
    assert f"line 202: Force (N) is '{cell}', expected a number" in error
    rows = [row + ";1.034" for row in lines(decimal=",")]
    check(imported(HEADER.replace("\n", ";Note\n") + "\n".join(rows)))


@given(st.lists(st.floats(-1e6, 1e6), min_size=4, max_size=4), st.sampled_from([".", ","]), st.booleans())
def test_three_decimals_are_never_taken_for_thousands(values: list[float], decimal: str, whole: bool) -> None:
    text = [f"{value:.3f}".replace(".", decimal) for value in values]
    dialect = guess_dialect(["a;b;c;d"] + [";".join([*text[:3], "7" if whole else text[3]])] * 3)
    assert dialect is not None
    assert dialect.cells(";".join(text)) == [float(f"{value:.3f}") for value in values]


def test_exponents_of_fortran_are_read(imported: Any) -> None:
    check(
        imported(
            HEADER + "\n".join(";".join(f"{float(v):.9E}".replace("E", "D") for v in row.split(";")) for row in lines())
        )
    )


@pytest.mark.parametrize(
    "text", ["06-May-2024 12:00:01.25", "20240506T120001.25", "Mon, 06 May 2024 12:00:01.25", "6 may 2024 12:00:01.25 PM"]
)
def test_dates_with_names_of_months_and_without_marks(text: str) -> None:
    assert clock_seconds(text) == clock_seconds("2024-05-06 12:00:01.25")


def test_what_begins_like_a_date_is_none() -> None:
    assert clock_seconds("06-Xyz-2024 12:00:01") is None
    assert clock_seconds("20241306T120001") is None


@pytest.mark.parametrize(
    "footer", ["End of data", "\nSummary\nPeak force (N);313.6\nCycles;12\n1;2;3", "\nStatistics\nMax\n", "\n\n"]
)
def test_what_stands_below_a_table_ends_no_import(imported: Any, footer: str) -> None:
    check(imported(HEADER + "\n".join(lines()) + "\n" + footer + "\n"))


@pytest.mark.parametrize(
    "header",
    [
        "Time (s);Force (N);Position (mm)",
        "Time (s);Position (m);Force (N)",
        "Time (s);Position (mm);Force (kN)",
        "Zeit (s);Weg (mm);Kraft (N)",
        "Time (s);Position (mm);Force (N)\ns;mm;kN",
    ],
)
def test_a_further_header_with_other_columns_or_units_is_refused(imported: Any, header: str) -> None:
    first, second = lines(TIME[:200]), lines(TIME[200:])
    error = imported(HEADER + "\n".join([*first, header, *second]))
    assert isinstance(error, str)
    assert "line 202: begins a table with other columns or units" in error
    check(imported(HEADER + "\n".join([*first, HEADER.strip(), *second])))


def test_a_row_without_a_time_is_dropped_with_a_word(imported: Any) -> None:
    rows = lines()
    rows[100] = "nan" + rows[100][rows[100].index(";") :]
    run = check(imported(HEADER + "\n".join(rows)), COUNT - 1)
    assert any("1 of 400 without a time dropped" in note for note in run.info["notes"])


def test_rows_that_were_all_written_twice_are_halved(imported: Any) -> None:
    check(imported(HEADER + "\n".join(row for row in lines() for _ in range(2))))


def test_an_optional_quantity_without_numbers_is_left_out(imported: Any) -> None:
    rows = "\n".join(f"{row};nan" for row in lines())
    run = check(imported(f"{HEADER.strip()};Temperature (C)\n{rows}"))
    assert run.temperature is None
    assert "the temperature is left out: 400 of 400 values are not numbers" in run.info["notes"]
    named = '--map temperature="Temperature (C)"'
    assert "temperature_C is nan" in imported(f"{HEADER.strip()};Temperature (C)\n{rows}", named)


@given(
    rate=st.floats(20, 450),
    start=st.integers(0, 10**6),
    way=st.sampled_from([np.round, np.floor, np.ceil]),
    count=st.integers(60, 500),
)
def test_the_rounding_of_whole_milliseconds_is_removed(rate: float, start: int, way: Any, count: int) -> None:
    exact = start / 1e3 + np.arange(count) / rate
    rounded = way(1e3 * exact) / 1e3
    even, told = without_rounding(rounded, find_passes(rounded))
    error = even - exact
    assert np.abs(error).max() < 1.5e-3
    if told:
        assert np.std(error) < 0.2e-3


@given(
    rate=st.sampled_from([100, 200, 250, 500, 1000]),
    hours=st.floats(0.2, 20),
    digits=st.sampled_from([7, 9]),
    count=st.integers(60, 2000),
)
def test_the_rounding_of_single_precision_is_removed(rate: int, hours: float, digits: int, count: int) -> None:
    exact = 3600 * hours + np.arange(count) / rate
    written = np.array(
        [float(f"{time:.{digits}g}") if digits > 7 else float(str(time)) for time in exact.astype(np.float32)]
    )
    order = find_passes(written)
    if order.repeats:  # too coarse a clock is refused elsewhere
        return
    even, told = without_rounding(written, order)
    apart = np.spacing(np.float32(exact[-1]))
    assert np.abs(even - exact).max() < 1.2 * apart
    if apart * rate > 0.03 and count > 500:
        assert np.std(np.diff(even)) < 0.01 * apart, told


@given(rate=st.sampled_from([50, 100, 250, 1000]), lost=st.lists(st.integers(1, 298), min_size=1, max_size=30, unique=True))
def test_missing_samples_are_no_rounding(rate: int, lost: list[int]) -> None:
    time = np.delete(np.arange(300) / rate, lost)
    assert without_rounding(time, find_passes(time)) == (pytest.approx(time), "")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e9, "ns"), (1 / 86400, "hours or days")])
def test_the_unit_of_a_time_is_guessed_by_its_size(imported: Any, factor: float, unit: str) -> None:
    rows = [f"{factor * t:.12g};{row.partition(';')[2]}" for t, row in zip(TIME, lines(), strict=True)]
    error = imported("Time;Position (mm);Force (N)\n" + "\n".join(rows))
    assert isinstance(error, str)
    assert error.endswith(f"is it in {unit}? Say so with --units time=UNIT\n")
    check(imported("Time;Position (mm);Force (N)\n" + "\n".join(rows), f"--units time={unit.split()[-1]}"))


@pytest.mark.parametrize("name", ["run.parquet", "run.mf4", "run.xls"])
def test_a_format_that_is_not_read_is_answered_with_those_that_are(import_tool: Any, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"PAR1\0\0\1\2" * 20)
    code, _, error = import_tool(f"{name} --current 0 --output bags")
    assert code == 2
    assert "expected text, a bag, .xlsx, .mat, .h5 or .tdms" in error


def test_own_names_with_semicolons_and_decimal_commas_are_read_by_the_import(imported: Any) -> None:
    rows = [f"{t:.4f};{x:.9f};{0.5};{f:.3f}" for t, x, f in zip(TIME, position(TIME), force(TIME), strict=True)]
    check(imported("time_s;position_m;current_A;force_N\n" + "\n".join(rows).replace(".", ",")))


def test_own_names_with_semicolons_are_refused_with_a_hint(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s;position_m;current_A;force_N\n" + "0,1;0,2;0,3;0,4\n" * 60)
    with pytest.raises(InputError, match="reads tables of other programs"):
        read_run(path)
