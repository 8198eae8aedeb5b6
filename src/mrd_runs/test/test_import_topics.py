"""Bags of other benches, SQLite and MCAP: numbers of their topics become a run on one time."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mrd_base import InputError
from mrd_runs import bag_import, read_run
from mrd_runs.importing import Mapped, read_foreign
from mrd_runs.importing.synchronise import synchronise

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
START = 1_700_000_000
SECONDS = 4.0
W = 2 * np.pi * 1.5


def position(time: np.ndarray) -> np.ndarray:
    return np.asarray(0.01 * np.sin(W * time))


def force(time: np.ndarray) -> np.ndarray:
    velocity = 0.01 * W * np.cos(W * time)
    return np.asarray(200 * np.tanh(20 * velocity) + 800 * velocity)


def header(time: float) -> object:
    nanoseconds = round((START + time) * 1e9)
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9), "")


def joint_state(time: float) -> object:
    x = float(position(np.array(time)))
    v = float(0.01 * W * np.cos(W * time))
    # The rod changes its place in the message, as drivers of several joints may do.
    names, xs = (["arm", "rod"], [1.0, x]) if time < 2 else (["rod", "arm"], [x, 1.0])
    return T["sensor_msgs/msg/JointState"](header(time), names, np.array(xs), np.array([v, v]), np.array([0.0, 0.0]))


def wrench(time: float) -> object:
    zero = T["geometry_msgs/msg/Vector3"](0.1, 0.2, 0.3)
    measured = T["geometry_msgs/msg/Vector3"](0.0, 1.0, float(force(np.array(time))))
    return T["geometry_msgs/msg/WrenchStamped"](header(time), T["geometry_msgs/msg/Wrench"](measured, zero))


def number(value: float) -> object:
    return T["std_msgs/msg/Float64"](value)


def write_bag(path: Path, plugin: StoragePlugin, messages: Mapping[str, tuple[str, list[tuple[float, object]]]]) -> Path:
    with Writer(path, version=8 if plugin is StoragePlugin.SQLITE3 else 9, storage_plugin=plugin) as writer:
        for topic, (kind, series) in messages.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for time, message in series:
                writer.write(connection, round((START + time) * 1e9), STORE.serialize_cdr(message, kind))
    return path


def bench(force_rate: float = 500.0, offset: float = 0.0003) -> dict[str, tuple[str, list[tuple[float, object]]]]:
    """Rod at 250 Hz, force at another rate and other times, a current that is sent when it changes."""
    times, others = np.arange(0, SECONDS, 1 / 250), np.arange(offset, SECONDS, 1 / force_rate)
    steps = [(0.0, 0.1), (1.5, 0.3), (3.0, 0.2)]
    return {
        "/joint_states": ("sensor_msgs/msg/JointState", [(t, joint_state(t)) for t in times]),
        "/ft": ("geometry_msgs/msg/WrenchStamped", [(t, wrench(t)) for t in others]),
        "/coil": ("std_msgs/msg/Float64", [(t, number(value)) for t, value in steps]),
    }


MAPPING = "position='/joint_states.position[rod]' force=/ft.wrench.force.z current=/coil.data"


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_joint_states_wrenches_and_floats_become_a_run(import_tool, tmp_path: Path, plugin: StoragePlugin) -> None:
    write_bag(tmp_path / "a", plugin, bench())
    code, text, error = import_tool(f"a --topics {MAPPING} --output bags")
    assert (code, error) == (0, "")
    assert "the samples are those of the position, 250 Hz, the slowest of motion and force" in text
    assert "force is averaged between them; current keeps its last value" in text
    assert "/coil is put onto the stamps of /joint_states by its times of receipt" in text
    run = read_run(tmp_path / "bags/a")
    first = run.time[0]
    time = run.time - first + 1 / 250  # the force begins after the first position
    np.testing.assert_allclose(run.position, position(time), atol=1e-7)
    np.testing.assert_allclose(run.force, force(time), atol=2.0)
    assert set(np.round(run.current, 6)) == {0.1, 0.2, 0.3}
    assert run.current[np.searchsorted(time, 1.49)] == 0.1
    assert run.current[np.searchsorted(time, 1.51)] == 0.3


def test_a_bag_without_topics_named_is_answered_with_a_mapping_that_does(import_tool, tmp_path: Path) -> None:
    write_bag(tmp_path / "a", StoragePlugin.MCAP, bench())
    code, _, error = import_tool("a --output bags")
    assert code == 2
    assert error.endswith(", /coil.data)\n")
    assert error.count("\n") == 1
    mapping = error.partition("right of: ")[2].partition(" (numbers in it: ")[0]
    assert mapping == f"--topics {MAPPING}"
    assert import_tool(f"a {mapping} --output bags")[0] == 0


def test_large_messages_of_other_topics_are_not_kept(tmp_path: Path, monkeypatch) -> None:
    image = T["std_msgs/msg/ByteMultiArray"](T["std_msgs/msg/MultiArrayLayout"]([], 0), np.zeros(10_000, np.uint8))
    messages = bench() | {"/camera": ("std_msgs/msg/ByteMultiArray", [(t, image) for t in np.arange(0, SECONDS, 0.01)])}
    write_bag(tmp_path / "a", StoragePlugin.MCAP, messages)
    monkeypatch.setattr("mrd_runs.bag.LARGEST_BAG", 2_000_000)
    with pytest.raises(InputError, match="is a bag of another bench"):
        read_foreign(tmp_path / "a")
    topics = {"position": "/joint_states.position[rod]", "force": "/ft.wrench.force.z"}
    assert len(read_foreign(tmp_path / "a", Mapped(topics=topics, current=0.0)).columns["time_s"]) > 900


@pytest.mark.parametrize(
    ("topics", "line"),
    [
        (
            "position=/joint_state.position[rod] force=/ft.wrench.force.z",
            "unknown topic /joint_state; did you mean /joint_states",
        ),
        (
            "position=/joint_states.position[rodd] force=/ft.wrench.force.z",
            "unknown element rodd; did you mean rod? (known: arm, rod)",
        ),
        ("position=/joint_states.position[7] force=/ft.wrench.force.z", "unknown element 7"),
        ("position=/joint_states.position force=/ft.wrench.force.z", "has 2 elements; name one in brackets: arm, rod"),
        ("position=/joint_states.position[rod] force=/ft.wrench.forces.z", "did you mean /ft.wrench.force.z?"),
        (
            "position=/joint_states.position[rod]",
            "--topics names no force; expected position (or velocity), force and current",
        ),
        ("time=/coil.data force=/ft.wrench.force.z position=/joint_states.position[rod]", "--topics names a time"),
        ("position=nonsense force=/ft.wrench.force.z", "nonsense is not a number of a topic; expected /TOPIC.FIELD"),
    ],
)
def test_what_is_not_there_is_named(import_tool, tmp_path: Path, topics: str, line: str) -> None:
    write_bag(tmp_path / "a", StoragePlugin.MCAP, bench())
    code, text, error = import_tool(f"a --topics {topics} --current 0 --output bags")
    assert (code, text, error.count("\n")) == (2, "", 1)
    assert line in error


def test_velocity_of_a_joint_is_integrated(import_tool, tmp_path: Path) -> None:
    write_bag(tmp_path / "a", StoragePlugin.SQLITE3, bench(force_rate=250.0, offset=0.0))
    topics = "velocity=/joint_states.velocity[rod] force=/ft.wrench.force.z"
    code, text, _ = import_tool(f"a --topics {topics} --current 0 --output bags")
    assert code == 0
    assert "it is the integral of the velocity" in text
    assert "the samples are" not in text  # both topics have the same times: nothing was resampled
    run = read_run(tmp_path / "bags/a")
    np.testing.assert_allclose(run.position, position(run.time), atol=2e-4)


def test_a_rate_can_be_asked_for(tmp_path: Path) -> None:
    write_bag(tmp_path / "a", StoragePlugin.MCAP, bench())
    topics = {"position": "/joint_states.position[rod]", "force": "/ft.wrench.force.z"}
    recording = read_foreign(tmp_path / "a", Mapped(topics=topics, current=0.0, rate=100.0))
    np.testing.assert_allclose(np.diff(recording.columns["time_s"]), 0.01, rtol=1e-6)
    assert any("at 100 Hz, evenly spaced; position and force is averaged" in note for note in recording.info["notes"])


def test_topics_without_time_in_common(tmp_path: Path) -> None:
    messages = bench()
    messages["/ft"] = ("geometry_msgs/msg/WrenchStamped", [(t, wrench(t)) for t in np.arange(10, 12, 0.01)])
    write_bag(tmp_path / "a", StoragePlugin.MCAP, messages)
    topics = {"position": "/joint_states.position[rod]", "force": "/ft.wrench.force.z"}
    with pytest.raises(InputError, match=r"no time in common \(position .* to .* s, force 0 to"):
        read_foreign(tmp_path / "a", Mapped(topics=topics, current=0.0))


def test_messages_out_of_order_are_sorted(tmp_path: Path) -> None:
    messages = bench()
    kind, series = messages["/ft"]
    messages["/ft"] = (kind, [*series[100:], *series[:100], series[0]])
    write_bag(tmp_path / "a", StoragePlugin.MCAP, messages)
    topics = {"position": "/joint_states.position[rod]", "force": "/ft.wrench.force.z"}
    recording = read_foreign(tmp_path / "a", Mapped(topics=topics, current=0.0))
    assert "/ft: 1 with the time of another one was dropped" in recording.info["notes"][0]
    time = recording.columns["time_s"] + 1 / 250
    np.testing.assert_allclose(recording.columns["force_N"], force(time), atol=2.0)


def test_bags_of_this_bench_need_no_import(import_tool, tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    error = import_tool("run --output bags")[2]
    assert error.startswith("error: run: is a bag of this bench already; every tool reads it as it is.")
    assert "leave --rate out" in import_tool("run --flip force --rate 100 --output bags")[2]


def test_signs_and_units_of_a_bag_of_this_bench_can_be_changed(import_tool, tmp_path: Path, columns) -> None:
    bag_import.write_bag(columns, ["a note"], Path("run.csv"), tmp_path / "run", {"started": "2024-05-31T10:00:00+00:00"})
    code, text, _ = import_tool("run --flip position --units force=kN --current 0.3 --output bags")
    assert code == 0
    before, after = read_run(tmp_path / "run"), read_run(tmp_path / "bags/run")
    np.testing.assert_array_equal(after.position, -before.position)
    np.testing.assert_array_equal(after.force, 1e3 * before.force)
    np.testing.assert_array_equal(after.current, 0.3)
    np.testing.assert_array_equal(after.time, before.time)
    assert after.info["started"] == "2024-05-31T10:00:00+00:00"
    assert after.info["notes"][0] == "a note"
    assert "the sign of the position was turned" in text
    assert "force is in kN" in text


def test_averages_keep_the_integral_and_remove_what_would_alias() -> None:
    fast = np.arange(0, 2, 1e-3)
    slow = np.arange(0.0, 1.99, 0.01)
    hum = np.sin(2 * np.pi * 101.0 * fast)  # a hair above the slow rate: interpolation shows it as 1 Hz
    series = {"position": (slow, np.sin(slow)), "force": (fast, 3.0 * fast + hum)}
    columns, notes = synchronise(series, None, "a")
    np.testing.assert_array_equal(columns["position"], np.sin(slow))
    middle = slice(1, -1)
    np.testing.assert_allclose(columns["force"][middle], 3.0 * slow[middle], atol=0.05)
    assert notes == [
        "the samples are those of the position, 100 Hz, the slowest of motion and force; force is averaged between them"
    ]


def test_gaps_are_said() -> None:
    time = np.concatenate([np.arange(0, 1, 0.01), np.arange(1.5, 2, 0.01)])
    _, notes = synchronise({"position": (time, time), "force": (time, time)}, None, "a")
    assert any("the longest gap between two samples is 0.51 s, 51 times the usual one" in note for note in notes)
