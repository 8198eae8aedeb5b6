"""Topics on which several nodes publish, and units beside numbers of messages."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as FirstWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mrd_runs import Run, read_run

STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("std_msgs/Header header\nfloat64 value\nstring unit\n", "rig_msgs/msg/Reading"))
T = STORE.types
EPOCH = 1_760_000_000
TIME = np.arange(300) / 250
JOINTS, WRENCH, NUMBER, READING = (
    "sensor_msgs/msg/JointState",
    "geometry_msgs/msg/WrenchStamped",
    "std_msgs/msg/Float64",
    "rig_msgs/msg/Reading",
)


def position(time: Any) -> Any:
    return 0.012 * np.sin(2 * np.pi * (0.8 * time + 0.2 * time**2))


def force(time: Any) -> Any:
    return 200 * np.cos(2 * np.pi * (0.8 * time + 0.2 * time**2)) + 30


def header(time: float, frame: str = "") -> Any:
    stamp = round((EPOCH + time) * 1e9)
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), frame)


def joints(time: float, **positions: float) -> Any:
    empty = np.empty(0)
    return T[JOINTS](header(time), list(positions), np.array(list(positions.values())), empty, empty)


def wrench(time: float, value: float, frame: str = "") -> Any:
    vector = T["geometry_msgs/msg/Vector3"]
    return T[WRENCH](header(time, frame), T["geometry_msgs/msg/Wrench"](vector(0.0, 0.0, value), vector(0.0, 0.0, 0.0)))


def write(path: Path, messages: list[tuple[float, str, str, Any]]) -> None:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for time, topic, kind, message in sorted(messages, key=lambda entry: entry[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], round((EPOCH + time) * 1e9), STORE.serialize_cdr(message, kind))


@pytest.fixture
def imported(import_tool: Any, tmp_path: Path) -> Any:
    """Import a bag of these messages; its run, or the line of the refusal."""

    def run(messages: list[tuple[float, str, str, Any]], topics: str) -> Run | str:
        write(tmp_path / "rig", messages)
        code, _, error = import_tool(f"rig --topics {topics} --current 0.5 --output bags")
        return read_run(tmp_path / "bags/rig") if code == 0 else str(error)

    return run


def check(run: Run | str) -> Run:
    assert isinstance(run, Run), run
    start = (TIME[-1] - run.time[-1]) if len(run) < len(TIME) else 0.0
    np.testing.assert_allclose(run.position, position(run.time + start), atol=3e-4)
    np.testing.assert_allclose(run.force, force(run.time + start), atol=3)
    return run


ROD = [(t + 0.002, "/joint_states", JOINTS, joints(t, rod=float(position(t)))) for t in TIME]
LOAD = [(t + 0.003, "/ft", WRENCH, wrench(t, float(force(t)))) for t in TIME]
BOTH = "position='/joint_states.position[rod]' force=/ft.wrench.force.z"


@pytest.mark.parametrize("first", [-0.001, 0.001])
@pytest.mark.parametrize("every", [1, 3])
def test_messages_of_other_joints_are_left_out(imported: Any, first: float, every: int) -> None:
    others = [(t + 0.002 + first, "/joint_states", JOINTS, joints(t, arm=1.0)) for t in TIME[::every]]
    run = check(imported(ROD + LOAD + others, BOTH))
    assert len(run) == len(TIME)
    assert any(f"/joint_states: {len(others)} messages without rod left out" in note for note in run.info["notes"])


def test_a_joint_that_is_nowhere_is_named_with_those_that_are(imported: Any) -> None:
    error = imported(ROD + LOAD, BOTH.replace("rod", "road"))
    assert "unknown element" in error
    assert "rod" in error


@pytest.mark.parametrize("every", [1, 2, 7])
def test_sensors_of_two_frames_on_one_topic_are_refused(imported: Any, every: int) -> None:
    others = [(t + 0.004, "/ft", WRENCH, wrench(t + 0.001, 5.0, "wrist")) for t in TIME[::every]]
    error = imported(ROD + LOAD + others, BOTH)
    assert isinstance(error, str)
    assert "the messages of /ft have the frames '' and 'wrist'" in error


@pytest.mark.parametrize(("topic", "scale"), [("/joint_states", 0.8), ("/joint_states", -1.0), ("/ft", 0.1)])
def test_two_series_that_alternate_on_one_topic_are_refused(imported: Any, topic: str, scale: float) -> None:
    others = [
        (t + 0.0035, topic, JOINTS, joints(t, rod=scale * float(position(t))))
        if topic == "/joint_states"
        else (t + 0.0035, topic, WRENCH, wrench(t, scale * float(force(t))))
        for t in TIME
    ]
    assert "alternates between two series" in imported(ROD + LOAD + others, BOTH)


def test_noise_does_not_alternate(imported: Any) -> None:
    noise = np.random.default_rng(1).normal(0, 1, len(TIME))
    load = [(t + 0.003, "/ft", WRENCH, wrench(t, float(each))) for t, each in zip(TIME, noise, strict=True)]
    assert isinstance(imported(ROD + load, BOTH), Run)


@pytest.mark.parametrize(("suffix", "factor"), [("lbf", 4.4482216152605), ("kN", 1e3)])
def test_a_unit_at_the_end_of_a_topic_counts(imported: Any, suffix: str, factor: float) -> None:
    rod = [(t, "/pos_mm", NUMBER, T[NUMBER](1e3 * float(position(t)))) for t in TIME]
    load = [(t, f"/force_{suffix}", NUMBER, T[NUMBER](float(force(t)) / factor)) for t in TIME]
    check(imported(rod + load, f"position=/pos_mm.data force=/force_{suffix}.data"))


def test_a_unit_of_a_joint_counts(imported: Any) -> None:
    rod = [(t, "/joint_states", JOINTS, joints(t, rod_mm=1e3 * float(position(t)))) for t in TIME]
    check(imported(rod + LOAD, "position='/joint_states.position[rod_mm]' force=/ft.wrench.force.z"))


def test_a_unit_in_a_field_beside_the_number_counts(imported: Any) -> None:
    load = [(t, "/load", READING, T[READING](header(t), float(force(t)) / 1e3, "kN")) for t in TIME]
    check(imported(ROD + load, "position='/joint_states.position[rod]' force=/load.value"))


def test_a_unit_beside_the_number_that_is_not_known_is_refused(imported: Any) -> None:
    load = [(t, "/load", READING, T[READING](header(t), float(force(t)), "V")) for t in TIME]
    assert "the force is in V" in imported(ROD + load, "position='/joint_states.position[rod]' force=/load.value")


def test_a_bag_of_ros_1_is_answered_with_how_to_convert_it(import_tool: Any, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with FirstWriter(tmp_path / "old.bag") as writer:
        connection = writer.add_connection("/pos", NUMBER, typestore=store)
        writer.write(connection, EPOCH * 10**9, store.serialize_ros1(store.types[NUMBER](1.0), NUMBER))
    for options in ("", "--topics position=/pos.data"):
        code, _, error = import_tool(f"old.bag {options} --output bags")
        assert code == 2
        assert "is a bag of ROS 1" in error
        assert "rosbags-convert --src old.bag" in error
