"""CSV files, unusable input of every kind, several runs."""

import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mrd_base import InputError
from mrd_runs import make_run, read_run, read_runs
from mrd_runs.bag_import import write_bag
from mrd_runs.read import describe_runs
from mrd_runs.scales import LARGEST


def test_csv_is_read_bit_by_bit_in_any_order(tmp_path: Path, columns, write_csv) -> None:
    shuffled = {"remark": np.zeros(1000)} | dict(reversed(list(columns.items())))
    shuffled["temperature_C"] = np.linspace(20, 30, 1000)
    run = read_run(write_csv(tmp_path / "run.csv", shuffled))
    np.testing.assert_array_equal(run.position, columns["position_m"])
    np.testing.assert_array_equal(run.force, columns["force_N"])
    np.testing.assert_array_equal(run.acceleration, columns["acceleration_mps2"])
    np.testing.assert_array_equal(run.time, columns["time_s"])
    assert run.temperature is not None
    assert run.temperature[0] == pytest.approx(293.15)
    assert run.info["notes"] == ("columns ignored: remark",)
    assert run.rate == pytest.approx(1000)


def test_recorded_velocity_is_used(tmp_path: Path, columns, write_csv) -> None:
    columns["velocity_mps"] = 0.0942 * np.cos(2 * np.pi * 1.5 * columns["time_s"])
    run = read_run(write_csv(tmp_path / "run.csv", columns))
    np.testing.assert_array_equal(run.velocity, columns["velocity_mps"])


def test_windows_line_ends_quotes_blank_lines_and_byte_order_mark(tmp_path: Path, columns, write_csv) -> None:
    text = write_csv(tmp_path / "run.csv", columns).read_text()
    first, second, rest = text.split("\n", 2)
    second = ",".join(f'"{cell}"' for cell in second.split(","))
    odd = f"\ufeff\n{first} \n\n{second}\n{rest}\n\n"
    (tmp_path / "odd.csv").write_bytes(odd.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(read_run(tmp_path / "odd.csv").position, columns["position_m"])


def spoilt(columns: dict[str, np.ndarray], key: str, change: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    return columns | {key: change(columns[key])}


def at(index: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[index] = value
        return values

    return change


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        ("force_N", at(41, np.nan), "line 43: force_N is nan, expected a finite number"),
        ("current_A", at(7, np.inf), "line 9: current_A is inf"),
        ("time_s", at(500, 0.1), "line 502: time_s is 0.1 after 0.499, expected increasing"),
        ("time_s", at(500, 0.499), "line 502: time_s is 0.499 after 0.499"),
        ("time_s", at(999, 3.4e8), "line 1001: time_s is 340000000 after 0.998; .* if the time stamp is wrong"),
        ("time_s", at(0, -1.7e9), "line 3: time_s is 0.001 after -1.7e[+]09; .* if the time stamp is wrong"),
        ("time_s", lambda t: t * 1e3, "advances by 1 a sample.*is it in ms"),
        ("time_s", lambda t: t / 3600, "is it in minutes or hours"),
        ("position_m", lambda x: x * 1e3, "position_m spans 20.*is it in mm"),
        ("current_A", lambda i: i * 1e3, "current_A reaches 1.*is it in mA"),
        ("force_N", lambda f: f * 1e6, "force_N reaches 2.*is it in mN"),
        ("acceleration_mps2", lambda a: a * 1e5, "is it in mm/s²"),
    ],
)
def test_unusable_values(tmp_path: Path, columns, write_csv, key: str, change, message: str) -> None:
    file = write_csv(tmp_path / "run.csv", spoilt(columns, key, change))
    with pytest.raises(InputError, match=message) as caught:
        read_run(file)
    assert str(caught.value).startswith(str(file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("factor", [0.0254, 0.3, 0.7, 1.0, 1.3, 3.6, 39.37])
@pytest.mark.parametrize("speed", [1.5, 0.05])
def test_a_velocity_is_used_where_it_is_that_of_the_position(factor: float, speed: float) -> None:
    time = np.arange(40_000) / 10_000.0
    w = 2 * np.pi * speed
    noise = np.random.default_rng(0).normal(0, 8e-6, len(time))
    position, velocity = 0.01 * np.sin(w * time) + noise, 0.01 * w * np.cos(w * time)
    columns = {"time_s": time, "position_m": position, "current_A": 0 * time, "force_N": 900 * velocity}
    run = make_run("run", columns | {"velocity_mps": factor * velocity})
    used = 0.5 < factor < 1.5
    assert np.array_equal(run.velocity, factor * velocity) == used
    assert any("it is not used; the velocity is that of the smoothed motion" in note for note in run.info["notes"]) != used
    if not used:
        assert np.std(run.velocity - velocity) < 0.1 * np.std(velocity)


@pytest.mark.parametrize("name", ["current_A", "force_N"])
def test_the_limits_are_those_of_the_scales(columns, name: str) -> None:
    largest = LARGEST.current if name == "current_A" else LARGEST.force
    values = columns[name] / np.abs(columns[name]).max()
    make_run("run", columns | {name: 0.99 * largest * values})
    with pytest.raises(InputError, match=f"{name} reaches"):
        make_run("run", columns | {name: 1.01 * largest * values})


def test_other_columns_in_other_units(columns) -> None:
    velocity = 94.2 * np.cos(2 * np.pi * 1.5 * columns["time_s"])
    with pytest.raises(InputError, match=r"velocity_mps reaches 94.*is it in mm/s"):
        make_run("run", columns | {"velocity_mps": velocity})
    with pytest.raises(InputError, match=r"times the derivative of position_m.*is it in mm/s"):
        make_run("run", columns | {"velocity_mps": velocity / 2})
    with pytest.raises(InputError, match="is it in K or °F"):
        make_run("run", columns | {"temperature_C": np.full(1000, 293.0)})
    run = make_run("run", columns | {"force_N": columns["force_N"] / 1e3})
    assert any("is it in kN or V?" in note for note in run.info["notes"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"time_s,position_m,current_A,force_N\n", "holds 0 samples, expected at least 50"),
        (b"time_s,position_m,current_A,force_N\n0,0,0,0\n1,0,0,0\n2,0,0,0\n", "holds 3 samples"),
        (b"time_s,position_m,force_N\n0,0,0\n", r"column current_A is missing \(found: time_s, position_m, force_N\)"),
        (b"time_s;position_m;current_A;force_N\n0;0;0;0\n", "columns are separated by commas"),
        (b"0,0,0,0\n", "column time_s, position_m, current_A, force_N is missing"),
        (b"\x00\x01\x02\xff" * 100, "is not text"),
        (b"\x89PNG\r\n\x1a\n\xff\xfe", "is not text"),
        (b"time_s,position_m,current_A,force_N\n0,0,0,0\n1,0,zero,0\n", "line 3: current_A is 'zero', expected a number"),
        (b"time_s,position_m,current_A,force_N\n0,0,0,0\n\n1,0,,0\n", "line 4: current_A is nothing"),
        (b"time_s,position_m,current_A,force_N\n0,0,0,0\n1,0\n", "line 3: has 2 cells, expected 4"),
        (b"time_s,position_m,current_A,force_N,force_N\n0,0,0,0,0\n", "column force_N appears 2 times"),
    ],
)
def test_unusable_files(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "run.csv").write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_run(tmp_path / "run.csv")
    assert "\n" not in str(caught.value)


def test_unknown_kind_of_file(tmp_path: Path) -> None:
    (tmp_path / "run.pdf").write_text("text")
    with pytest.raises(InputError, match="unknown kind of file"):
        read_run(tmp_path / "run.pdf")


CELLS = 'time_s,position_m,current_A,force_N0123456789.e-\n"'


@settings(max_examples=200)
@example(content=b"\x1c")  # white space as text, not as bytes
@given(content=st.one_of(st.binary(max_size=300), st.text(CELLS, max_size=300).map(str.encode)))
def test_any_bytes_give_a_run_or_one_line(tmp_path_factory, read_or_refuse, content: bytes) -> None:
    file = tmp_path_factory.getbasetemp() / "any.csv"
    for text in (content, b"time_s,position_m,current_A,force_N\n" + content):
        file.write_bytes(text)
        result = read_or_refuse(file)
        assert not isinstance(result, str) or "\n" not in result


@settings(max_examples=50)
@given(st.lists(st.floats(-0.2, 0.2), min_size=50, max_size=80))
def test_every_number_survives_the_csv(tmp_path_factory, positions: list[float]) -> None:
    file = tmp_path_factory.getbasetemp() / "numbers.csv"
    rows = [f"{index / 100!r},{value!r},0,1" for index, value in enumerate(positions)]
    file.write_text("time_s,position_m,current_A,force_N\n" + "\n".join(rows))
    run = read_run(file)
    assert run.position.tolist() == positions
    assert np.isfinite(run.velocity).all()


def test_names_are_unique_and_the_same_recording_is_refused(tmp_path: Path, make_columns, write_csv) -> None:
    for index, folder in enumerate(("a", "b")):
        (tmp_path / folder).mkdir()
        write_csv(tmp_path / folder / "run.csv", make_columns(seed=index))
    runs = read_runs([tmp_path / "a/run.csv", tmp_path / "b/run.csv"])
    assert [run.name for run in runs] == ["a/run", "b/run"]
    single = write_csv(tmp_path / "a" / "single.csv", make_columns(seed=2))
    three = read_runs([tmp_path / "a/run.csv", single, tmp_path / "b/run.csv"])
    assert [run.name for run in three] == ["a/run", "single", "b/run"]
    # A pattern over folders may name two sets, which one has to see.
    assert f"3 runs of 2 folders: {tmp_path / 'a'} (2), {tmp_path / 'b'}; " in describe_runs(three)
    assert describe_runs(runs).startswith(f"2 runs of 2 folders: {tmp_path / 'a'}, {tmp_path / 'b'}; ")
    many = [replace(runs[0], info={"source": f"runs/{k}/bag"}) for k in range(30)]
    assert "runs/19 and 10 more; " in describe_runs(many)
    assert describe_runs(three[:1]).startswith(f"1 run in {tmp_path / 'a'}; ")
    shutil.copy(tmp_path / "a/run.csv", tmp_path / "copy.csv")
    with pytest.raises(InputError, match=r"copy.csv: is the same recording as .*a/run.csv"):
        read_runs([tmp_path / "a/run.csv", tmp_path / "copy.csv"])


def test_csv_and_the_bag_made_of_it_are_the_same_recording(tmp_path: Path, make_columns, write_csv) -> None:
    columns = make_columns() | {"time_s": 12.5 + np.cumsum(np.random.default_rng(0).uniform(0.5e-3, 1.5e-3, 1000))}
    file = write_csv(tmp_path / "run.csv", columns)
    write_bag(columns, [], file, tmp_path / "bag")
    with pytest.raises(InputError, match=r"bag: is the same recording as .*run.csv"):
        read_runs([file, tmp_path / "bag"])
    other = columns | {"force_N": np.nextafter(columns["force_N"], np.inf)}
    assert len(read_runs([file, write_csv(tmp_path / "other.csv", other)])) == 2


def test_runs_can_be_pickled(columns) -> None:
    run = make_run("run", columns)
    copy = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(copy.velocity, run.velocity)
    assert copy.info == run.info


def test_all_measured_data_are_readable(measured: list[Path]) -> None:
    runs = read_runs(measured)
    for run in runs:
        assert np.isfinite(run.velocity).all()
        assert 0.005 < np.abs(run.velocity).max() < 1
    assert len({run.name for run in runs}) == len(measured)


def test_files_of_other_programs_are_sent_to_the_import(tmp_path: Path, columns, write_csv) -> None:
    (tmp_path / "a.csv").write_text("Zeit;Weg;Kraft\n0;1;2\n")
    with pytest.raises(InputError, match=r"`ros2 run mrd_runs import` reads tables of other programs\)$"):
        read_run(tmp_path / "a.csv")
    (tmp_path / "a.xlsx").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"unknown kind of file; .* \(`ros2 run mrd_runs import` makes bags of other"):
        read_run(tmp_path / "a.xlsx")
    text = write_csv(tmp_path / "b.csv", columns).read_text()
    (tmp_path / "b.csv").write_text(text.replace("0.001,", "0.001s,", 1))
    with pytest.raises(InputError, match=r"line 3: time_s is '0.001s', expected a number$"):
        read_run(tmp_path / "b.csv")
