"""Runs and bags to test with."""

import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mrd_base import InputError
from mrd_runs import Run, read_run
from mrd_runs.bag import BagWriter
from mrd_runs.cli import import_
from mrd_runs.definitions import SAMPLES_TYPE, typestore

RATE = 1000
TYPES = typestore().types


def series(n: int = 1000, seed: int = 0) -> dict[str, np.ndarray]:
    """A sine with sensor noise: columns as `make_run` takes them."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / RATE
    angle = 2 * np.pi * 1.5 * time
    return {
        "time_s": time,
        "position_m": 0.01 * np.sin(angle) + rng.normal(0, 5e-6, n),
        "current_A": 0.15 + rng.normal(0, 4e-3, n),
        "force_N": 200 * np.tanh(9 * np.cos(angle)) + rng.normal(0, 1.5, n),
        "acceleration_mps2": -0.01 * (2 * np.pi * 1.5) ** 2 * np.sin(angle) + rng.normal(0, 0.05, n),
    }


def block_message(columns: dict[str, np.ndarray], first: int, last: int, start: float = 1.7e9) -> object:
    """BenchSamples of the samples ``first`` to ``last``."""
    stamp = round((start + first / RATE) * 1e9)
    return TYPES[SAMPLES_TYPE](
        TYPES["std_msgs/msg/Header"](TYPES["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), ""),
        1 / RATE,
        first,
        columns["position_m"][first:last],
        columns["force_N"][first:last],
        columns["current_A"][first:last],
        columns["acceleration_mps2"][first:last],
        columns["temperature_C"][first:last] + 273.15 if "temperature_C" in columns else np.empty(0),
    )


def run_or_line(path: Path) -> Run | str:
    """The run in a file, or the line with which it is refused."""
    try:
        return read_run(path)
    except InputError as error:
        return str(error)


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    return series()


@pytest.fixture(scope="session")
def read_or_refuse() -> Callable[[Path], Run | str]:
    return run_or_line


@pytest.fixture(scope="session")
def whole_bag(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Bytes of a storage file of 1000 samples."""
    folder = tmp_path_factory.mktemp("whole") / "whole"
    columns = series()
    with BagWriter(folder) as writer:
        writer.add_topic("/samples", SAMPLES_TYPE)
        for first in range(0, 1000, 20):
            writer.write_message("/samples", first * 1_000_000, block_message(columns, first, first + 20))
    return (folder / "whole.mcap").read_bytes()


@pytest.fixture
def make_columns() -> Callable[..., dict[str, np.ndarray]]:
    return series


@pytest.fixture
def make_block() -> Callable[..., object]:
    return block_message


@pytest.fixture
def fill_bag() -> Callable[..., BagWriter]:
    """Write samples in blocks of 20, without those of ``skip``; the writer is left open."""

    def fill(path: Path, columns: dict[str, np.ndarray], skip: tuple[int, ...] = (), topic: str = "/samples") -> BagWriter:
        writer = BagWriter(path)
        writer.add_topic(topic, SAMPLES_TYPE, depth=200)
        for index, first in enumerate(range(0, len(columns["time_s"]), 20)):
            if index in skip:
                continue
            block = block_message(columns, first, min(first + 20, len(columns["time_s"])))
            writer.write_message(topic, int((1.7e9 + first / RATE) * 1e9), block)
        return writer

    return fill


@pytest.fixture
def write_csv() -> Callable[..., Path]:
    """Write columns as CSV with all digits."""

    def write(path: Path, columns: dict[str, np.ndarray]) -> Path:
        table = np.column_stack(list(columns.values()))
        lines = [",".join(columns), *(",".join(repr(float(value)) for value in row) for row in table)]
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


@pytest.fixture(scope="session")
def measured() -> list[Path]:
    """The measured data, where they are: in $MRD_DATA, or beside the workspace."""
    beside = Path(__file__).parents[4] / "shared/data"
    given = os.environ.get("MRD_DATA") or (str(beside) if beside.is_dir() else "")
    if not given:
        pytest.skip("no measured data: set MRD_DATA to their folder")
    files = sorted(Path(given).glob("*/*.csv"))
    assert files, f"no measured data in {given}"
    return files


@pytest.fixture
def import_tool(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Callable[..., tuple[int, str, str]]:
    """Run `mrd import` with arguments as typed, in the folder of the test."""

    def run(line: str) -> tuple[int, str, str]:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["import", *shlex.split(line)])
        code = 0
        try:
            import_.main()
        except SystemExit as end:
            code = int(end.code or 0)
        return code, *capsys.readouterr()

    return run
