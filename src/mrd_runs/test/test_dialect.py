"""Dialects of text files: what was written in any of them is read again."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_runs.importing.quantities import find_sources
from mrd_runs.importing.table import Column
from mrd_runs.importing.text import guess_dialect, read_text_table
from mrd_runs.importing.units import UNITS, find_unit, to_si

NAMES = {
    "time": ["Time", "t", "Zeit", "Temps", "tiempo", "Elapsed Time", "TIMESTAMP"],
    "position": ["Position", "x", "Weg", "Kolbenweg", "Déplacement", "Stroke", "disp", "pos_rod", "rodPosition"],
    "force": ["Force", "F", "Kraft", "Dämpferkraft", "Fuerza", "Load", "load cell", "force 1"],
    "current": ["Current", "I", "Strom", "Courant", "Coil current", "i_coil"],
}
QUANTITIES = tuple(NAMES)
PREAMBLE = st.lists(
    st.sampled_from(
        ["Messung 7", "# made by a logger", "Date: 2024-03-12", "Sample rate = 500 Hz", "", "Operator;M. Muster", "a, b"]
    ),
    max_size=5,
)


def write(rows, delimiter, decimal, digits, exponent, quoted=False):
    text = [[f"{value:.{digits}{'e' if exponent else 'f'}}".replace(".", decimal) for value in row] for row in rows]
    if quoted:
        text = [[f'"{cell}"' for cell in row] for row in text]
    return [(delimiter or "  ").join(row) for row in text]


@st.composite
def files(draw):
    """Lines of a file, its columns, and its values as they are written."""
    delimiter = draw(st.sampled_from([";", "\t", ",", "|", ""]))
    decimal = draw(st.sampled_from([".", ","]))
    quoted = delimiter == "," and decimal == ","
    width = draw(st.integers(3, 4))
    digits = draw(st.integers(1, 6))
    seed = draw(st.integers(0, 2**32 - 1))
    values = np.random.default_rng(seed).uniform(-1000, 1000, (draw(st.integers(5, 40)), width))
    exponent = draw(st.booleans())
    quantities = draw(st.permutations(QUANTITIES))[:width]
    style = draw(st.sampled_from(["brackets", "parentheses", "row", "none"]))
    columns = []
    for quantity in quantities:
        unit = "" if style == "none" else draw(st.sampled_from(sorted(UNITS[quantity])))
        columns.append((quantity, draw(st.sampled_from(NAMES[quantity])), unit))
    around = {"brackets": " [{}]", "parentheses": " ({})"}.get(style, "")
    header = [name + around.format(unit) for _, name, unit in columns]
    gap = delimiter or "   "
    lines = [*draw(PREAMBLE), gap.join(header)]
    if style == "row":
        lines.append(gap.join(unit for *_, unit in columns))
    body = write(values, delimiter, decimal, digits, exponent, quoted)
    if draw(st.booleans()):
        body.insert(len(body) // 2, "")
    written = [
        [float(cell.replace(",", ".")) for row in write([r], ";", ".", digits, exponent) for cell in row.split(";")]
        for r in values
    ]
    return lines + body, columns, np.array(written)


@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    made=files(),
    newline=st.sampled_from(["\n", "\r\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]),
)
def test_what_is_written_in_any_dialect_is_read_again(tmp_path: Path, made, newline, encoding) -> None:
    lines, columns, values = made
    path = tmp_path / "a.txt"
    try:
        content = newline.join(lines).encode(encoding)
    except UnicodeEncodeError:
        assume(False)
    path.write_bytes(content)
    table = read_text_table(path)
    names = [column.name for column in table.columns]
    assert len(names) == len(columns)
    read = table.read(names)
    np.testing.assert_array_equal(np.column_stack([read[name] for name in names]), values)
    given_current = all(quantity != "current" for quantity, *_ in columns)
    absent = {"time", "position", "force"} - {quantity for quantity, *_ in columns}
    assume(not absent)
    sources = find_sources(table.columns, {}, "a.txt", current_is_given=given_current, rate_is_given=False)
    for (quantity, name, unit), found in zip(columns, names, strict=True):
        assert sources[quantity].name == found
        assert found.startswith(name)
        assert sources[quantity].unit == unit or find_unit(quantity, sources[quantity].unit) == unit


@settings(max_examples=300)
@given(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\n\r"), max_size=60), max_size=30))
def test_no_text_makes_the_guess_fail(lines) -> None:
    dialect = guess_dialect(lines)
    if dialect is not None:
        cells = dialect.cells(lines[dialect.located.first])
        assert sum(isinstance(cell, float) for cell in cells) >= 2
        assert len(cells) == len(dialect.located.columns)


@pytest.mark.parametrize(
    ("line", "delimiter", "decimal", "count"),
    [
        ("0,001;1,5;-2,25", ";", ",", 3),
        ("0.001;1.5;-2.25", ";", ".", 3),
        ("1;2;3", ";", ".", 3),
        ("0.1,0.2,0.3", ",", ".", 3),
        ("1,2,3", ",", ".", 3),
        ('"0,1","0,2","0,3"', ",", ",", 3),
        ("0,1\t0,2\t0,3", "\t", ",", 3),
        ("  1.0E-03   2.5E+01  -3.0E+00", "", ".", 3),
        ("0,1  0,2  0,3", "", ",", 3),
        ("0.1, 0.2, 0.3", ",", ".", 3),
        ("0,1;0,2;0,3;", ";", ",", 3),
        ("12:00:00,123;0,2;0,3", ";", ",", 3),
        ("2024-03-12 12:00:00.123,0.2,0.3", ",", ".", 3),
        ("12.03.2024 12:00:00,123;0,2;0,3", ";", ",", 3),
        ("12.03.2024;0,2;0,3", ";", ",", 2),
    ],
)
def test_dialects_of_a_line(line: str, delimiter: str, decimal: str, count: int) -> None:
    dialect = guess_dialect(["Remarks, more; and more", *[line] * 10])
    assert dialect is not None
    assert (dialect.delimiter, dialect.decimal) == (delimiter, decimal)
    assert sum(bool(column.name) and not column.text for column in dialect.located.columns) == count


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("time_s,position_m,current_A,force_N", ["time_s", "position_m", "force_N", "current_A"]),
        ("t [s],x [mm],F [kN],I [A]", ["t [s]", "x [mm]", "F [kN]", "I [A]"]),
        ("Time in ms,Weg in mm,Kraft in kN,Strom in mA", ["Time in ms", "Weg in mm", "Kraft in kN", "Strom in mA"]),
        ("time,position setpoint,position,force,current", ["time", "position", "force", "current"]),
        ("time,force raw,force,disp,amps [A]", ["time", "disp", "force", "amps [A]"]),
        (
            "Kanal 1 [s],Kanal 2 [mm],Kanal 3 [kN],Kanal 4 [A]",
            ["Kanal 1 [s]", "Kanal 2 [mm]", "Kanal 3 [kN]", "Kanal 4 [A]"],
        ),
    ],
)
def test_quantities_are_found_by_names_and_units(header: str, names: list[str]) -> None:
    columns = [Column(name) for name in header.split(",")]
    sources = find_sources(columns, {}, "a", current_is_given=False, rate_is_given=False)
    assert [sources[quantity].name for quantity in ("time", "position", "force", "current")] == names


@pytest.mark.parametrize(
    ("quantity", "unit", "value", "expected"),
    [
        ("time", "ms", 250.0, 0.25),
        ("position", "MM", 3.0, 3e-3),
        ("velocity", "mm s^-1", 50.0, 0.05),
        ("acceleration", "m/s²", 2.0, 2.0),
        ("acceleration", "g", 1.0, 9.80665),
        ("force", "kN", 1.5, 1500.0),
        ("force", "200 N", 2.5, 500.0),
        ("force", "-0.5 kN", 2.0, -1000.0),
        ("current", "mA", 300.0, 0.3),
        ("temperature", "K", 293.15, 20.0),
        ("temperature", "0.1 K", 2931.5, 20.0),
        ("temperature", "100 °F", 0.68, 20.0),
        ("temperature", "°F", 212.0, 100.0),
    ],
)
def test_units(quantity: str, unit: str, value: float, expected: float) -> None:
    assert to_si(quantity, np.array([value]), unit, "a")[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        (["Test\t17", "rate 500", "", "0 0 0"], ["column 1", "column 2", "column 3"]),
        (["% t x F", "0 0 0"], ["t", "x", "F"]),
        (["Time\tAxial Displacement\tAxial Force", "Sec\tmm\tkN", "0\t0\t0"], ["Time", "Axial Displacement", "Axial Force"]),
        (["Zeit [ s ] ; Weg [ mm ] ; Kraft [ N ]", "0 ; 0 ; 0"], ["Zeit [ s ]", "Weg [ mm ]", "Kraft [ N ]"]),
        (["t;x;F;remark", "0;0;0"], ["t", "x", "F"]),
        (["t,x,x", "0,0,0"], ["t", "x", "x (2)"]),
    ],
)
def test_names_of_columns(lines: list[str], names: list[str]) -> None:
    dialect = guess_dialect([*lines, *[lines[-1]] * 5])
    assert dialect is not None
    assert [column.name for column in dialect.located.columns] == names


def test_a_column_that_holds_no_numbers_is_named() -> None:
    columns = [Column("t"), Column("x"), Column("F", "", "1.087,76")]
    expected = r"no column is left for the force, expected .* \(columns: t, x; no numbers: F holds '1.087,76'\)$"
    with pytest.raises(InputError, match=expected):
        find_sources(columns, {}, "a", current_is_given=True, rate_is_given=False)
    with pytest.raises(InputError, match=r"^a: --map force: F holds '1.087,76', expected numbers$"):
        find_sources(columns, {"force": "F"}, "a", current_is_given=True, rate_is_given=False)
