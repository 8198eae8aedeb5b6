"""The commands of docs/own_data.md, from files of other programs to a fit and a verdict."""

import re
import shlex
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mrd_cli.cli import mrd
from mrd_sim.models import find_model
from mrd_sim.path import make_path

PAGE = Path(__file__).resolve().parents[1] / "docs" / "own_data.md"
COMMANDS = re.findall(r"^    (mrd .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
STORE = get_typestore(Stores.ROS2_JAZZY)
RATE = 500


def series(seed: int, current: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and force of a Bingham damper whose seal rubs, with noise."""
    random = np.random.default_rng(seed)
    time = np.arange(2000) / RATE
    position, velocity, acceleration = np.zeros((3, len(time)))
    for frequency, amplitude in ((0.5, 9e-3), (1.5, 4e-3), (3.5, 1.2e-3)):
        w, phase = 2 * np.pi * frequency, random.uniform(0, 2 * np.pi)
        position += amplitude * np.sin(w * time + phase)
        velocity += amplitude * w * np.cos(w * time + phase)
        acceleration -= amplitude * w**2 * np.sin(w * time + phase)
    model = find_model("bingham", effects=["force_sensor_lag"])
    theta = model.vector({"force_sensor_lag.lag": 0.02, "coil_lag": 0.0})
    force = model.force(theta, make_path(time, position, velocity, acceleration, np.full(len(time), current)))
    return time, position, force + random.standard_normal(len(time))


def write_files(folder: Path) -> None:
    def rows(*columns: np.ndarray) -> str:
        return "".join(";".join(f"{v:.6f}".replace(".", ",") for v in row) + "\n" for row in zip(*columns, strict=True))

    time, position, force = series(0, 0.5)
    head = "Prüfstand 3;;\nDatum;12.03.2024;\nAbtastrate;500 Hz;\n\nTime [ms];Weg [mm];Kraft [kN]\n"
    (folder / "rig.txt").write_text(head + rows(1e3 * time, 1e3 * position, 1e-3 * force), encoding="cp1252")
    time, position, force = series(1, 0.0)
    (folder / "channels.txt").write_text("Zeit;Kanal 1;Kanal 2\n" + rows(time, 1e3 * position, force / 200))
    time, position, force = series(3, 0.0)
    for number, values in ((1, 1e3 * position), (2, force)):
        lines = (f"{t:.6f},{value:.6f}\n" for t, value in zip(time, values, strict=True))
        (folder / f"scope_CH{number}.csv").write_text(f"Model,TBS1000\nTIME,CH{number}\n" + "".join(lines))
    time, position, force = series(2, 0.2)
    types = STORE.types
    kinds = ("sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped", "std_msgs/msg/Float64")
    with Writer(folder / "bench", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints, wrenches, currents = (
            writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in zip(("/joint_states", "/ft", "/coil"), kinds, strict=True)
        )
        for t, x, f in zip(time, position, force, strict=True):
            stamp = 1_700_000_000_000_000_000 + round(1e9 * t)
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "")
            joint = types[kinds[0]](header, ["rod"], np.array([x]), np.array([]), np.array([]))
            zero, vector = types["geometry_msgs/msg/Vector3"](0, 0, 0), types["geometry_msgs/msg/Vector3"](0, 0, f)
            wrench = types[kinds[1]](header, types["geometry_msgs/msg/Wrench"](vector, zero))
            for connection, kind, message in (
                (joints, kinds[0], joint),
                (wrenches, kinds[1], wrench),
                (currents, kinds[2], types[kinds[2]](0.2)),
            ):
                writer.write(connection, stamp, STORE.serialize_cdr(message, kind))


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    write_files(tmp_path)

    def call(line: str) -> str:
        monkeypatch.setattr(sys, "argv", shlex.split(line))
        mrd.main()
        output = capsys.readouterr()
        return output.out + output.err

    return call


def test_files_of_other_programs_are_imported_and_fitted_as_the_page_says(run, tmp_path):
    imports = [line for line in COMMANDS if line.startswith(("mrd import", "mrd info"))]
    assert len(imports) == 6
    printed = "".join(run(line) for line in imports)
    shown = re.search(r"\n    bags/rig: .*?\n\n", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0]
    for line in shown.split("\n"):
        assert line.strip() in printed
    # The sign was right: the page turns it to show how, and the tool warns.
    assert "warning: rig: the damper drives the rod" in printed
    (fit,) = [line for line in COMMANDS if line.startswith("mrd identify")]
    run(f"{fit} --population 12 --generations 5 --no-profile")
    assert (tmp_path / "fit/fit.json").exists()


def test_imported_bags_come_to_the_right_verdict(run, tmp_path):
    """A table with decimal commas, one of nameless channels in V, a bag of joints and wrenches: one damper, one fault."""
    for line in COMMANDS:
        if line.startswith("mrd import") and "--flip" not in line:
            run(line)
    (diagnose,) = [line for line in COMMANDS if line.startswith("mrd diagnose")]
    answer = run(f"{diagnose} --effects force_sensor_lag,gas_spring,seal_friction")
    assert answer.startswith("The force sensor lags by 20 ms (probability ")


def test_the_python_of_the_page_runs(run):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, object] = {}
    exec(code, names)
    assert len(names["run"]) == 2000


def test_the_page_names_tools_that_exist():
    for line in COMMANDS:
        assert callable(import_module(mrd.TOOLS[line.split()[1]].module).main)
