"""Clocks of the topics of a bag, and a fuzzer of the clocks of all formats: no channel is late by a sample in silence."""

import os
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mrd_base import InputError
from mrd_runs import Run, make_run, read_run
from mrd_runs.bag_import import write_bag
from mrd_runs.importing import Mapped, read_passes

STORE = get_typestore(Stores.ROS2_JAZZY)
T = STORE.types
RATE, COUNT = 200, 600
STEP = 1 / RATE
TIME = np.arange(COUNT) / RATE
EPOCH = 1_760_000_000.0


def position(time: np.ndarray) -> np.ndarray:
    """In m; no shift of it looks like it."""
    return np.asarray(0.012 * np.sin(2 * np.pi * (0.8 * time + 0.2 * time**2)))


def force(time: np.ndarray) -> np.ndarray:
    """In N."""
    velocity = 0.012 * 2 * np.pi * (0.8 + 0.4 * time) * np.cos(2 * np.pi * (0.8 * time + 0.2 * time**2))
    return np.asarray(200 * np.tanh(30 * velocity) + 600 * velocity)


def stamp(time: float) -> Any:
    nanoseconds = round(time * 1e9)
    return T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9), "")


def point(header: float, value: float) -> Any:
    return T["geometry_msgs/msg/PointStamped"](stamp(header), T["geometry_msgs/msg/Point"](value, 0.0, 0.0))


def wrench(header: float, value: float) -> Any:
    zero = T["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    return T["geometry_msgs/msg/WrenchStamped"](
        stamp(header), T["geometry_msgs/msg/Wrench"](T["geometry_msgs/msg/Vector3"](0.0, 0.0, value), zero)
    )


Messages = tuple[Any, Any, Any]  # header stamps or None, times of receipt, values


def write(path: Path, topics: Mapping[str, Messages]) -> Path:
    """Write a bag; a topic /x holds points, /f wrenches, and one without headers numbers."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        rows = []
        for topic, (headers, receipts, values) in topics.items():
            kind = (
                "std_msgs/msg/Float64"
                if headers is None
                else f"geometry_msgs/msg/{'PointStamped' if topic == '/x' else 'WrenchStamped'}"
            )
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number, receipt in enumerate(receipts):
                value = float(values[number])
                if headers is None:
                    message = T[kind](value)
                else:
                    message = (point if topic == "/x" else wrench)(float(headers[number]), value)
                rows.append((number, connection, receipt, STORE.serialize_cdr(message, kind)))
        for _, connection, receipt, cdr in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, round(receipt * 1e9), cdr)
    return path


def read(path: Path, topics: Mapping[str, Messages]) -> list[Run]:
    of = {"position": "/x.point.x" if topics["/x"][0] is not None else "/x.data"}
    of["force"] = "/f.wrench.force.z" if topics["/f"][0] is not None else "/f.data"
    of |= {"current": "/i.data"} if "/i" in topics else {}
    recordings = read_passes(path, Mapped(topics=of, current=None if "/i" in topics else 0.0))
    return [make_run("any", recording.columns, recording.info) for recording in recordings]


def shift(run: Run, part: slice, values: np.ndarray, signal: Any) -> float:
    """Return how much later than the time of a run a part of a channel is, in s."""
    trials = np.arange(-0.3, 3.0, 1e-3)
    errors = np.sqrt(np.mean((signal(run.time[part][None, :] + trials[:, None]) - values[part]) ** 2, axis=1))
    assert errors.min() < 0.1 * np.std(values), "is no recording of the motion"
    return float(trials[int(np.argmin(errors))])


def misalignment(run: Run) -> float:
    """Return the largest delay between force and position in parts of a run, in s."""
    parts = np.array_split(np.arange(len(run)), 3)
    shifts = [
        shift(run, slice(part[0], part[-1] + 1), run.position, position)
        - shift(run, slice(part[0], part[-1] + 1), run.force, force)
        for part in parts
    ]
    return float(np.abs(shifts).max())


def aligned(tmp_path: Path, topics: Mapping[str, Messages]) -> Run:
    (run,) = read(write(tmp_path / "bag", topics), topics)
    assert misalignment(run) <= STEP
    return run


def times_of(run: Run) -> str:
    (note,) = [note for note in run.info["notes"] if note.startswith("times: ")]
    return note


NOW = EPOCH + TIME
X, F = position(TIME), force(TIME)


@pytest.mark.parametrize("places", [[0], [300], [599], [0, 1], [5, 100, 400]])
@pytest.mark.parametrize("wrong", ["zero", "far"])
def test_wrong_stamps_are_dropped_with_a_word(tmp_path: Path, places: list[int], wrong: str) -> None:
    headers = NOW.copy()
    headers[places] = 0.0 if wrong == "zero" else 2.1e9
    run = aligned(tmp_path, {"/x": (NOW, NOW + 1e-3, X), "/f": (headers, NOW + 0.025, F)})
    assert run.duration <= 3.0
    assert f"/f: {len(places)} of 600 ha" in times_of(run)
    assert run.clocks_agree("position", "force"), "the stamps are the same but for those that were dropped"


def test_a_topic_without_stamps_puts_all_onto_the_times_of_receipt(tmp_path: Path) -> None:
    run = aligned(tmp_path, {"/x": (NOW - 0.02, NOW, X), "/f": (None, NOW + 1e-4, F)})
    assert "the times are those of the recording (/f: its messages have no stamps)" in times_of(run)
    assert not run.clocks_agree("position", "force")


@pytest.mark.parametrize("offset", [1.7e9, 3600.0, 5.0, -0.02])
def test_stamps_of_two_clocks_are_not_compared(tmp_path: Path, offset: float) -> None:
    """A device that counts from its start, one an hour off, and one that stamps before it has received anything."""
    run = aligned(tmp_path, {"/x": (NOW, NOW + 1e-3, X), "/f": (NOW - offset + 0.0007, NOW + 2e-3, F)})
    assert "the times are those of the recording" in times_of(run)
    assert not run.clocks_agree("position", "force")


def test_a_delay_that_may_be_of_the_clocks_is_said(tmp_path: Path) -> None:
    topics = {"/x": (NOW, NOW + 1e-3, X), "/f": (NOW - 0.0201, NOW + 1e-3, F)}
    (run,) = read(write(tmp_path / "bag", topics), topics)
    assert (
        "from stamp to receipt /f takes 20.1 ms more than /x: a slow transport, or a clock that differs by that"
        in times_of(run)
    )
    assert not run.clocks_agree("position", "force")


@pytest.mark.parametrize("kind", ["drift", "step"])
def test_clocks_that_run_apart_are_not_used(tmp_path: Path, kind: str) -> None:
    other = NOW + (0.01 * TIME if kind == "drift" else np.where(TIME > 1.5, 0.02, 0.0))
    run = aligned(tmp_path, {"/x": (NOW, NOW + 1e-3, X), "/f": (other - 0.001, NOW + 1e-3, F)})
    assert "run apart by" in times_of(run)


def test_the_clock_of_a_device_that_restarts_is_not_used(tmp_path: Path) -> None:
    other = np.r_[TIME[:300], TIME[:300]] + 10.0
    run = aligned(tmp_path, {"/x": (NOW, NOW + 1e-3, X), "/f": (other, NOW + 1e-3, F)})
    assert len(run) >= 598
    assert "set back by 1.495 s, those of the other are not" in times_of(run)


@pytest.mark.parametrize("start", [1.0, 100.0])
@pytest.mark.parametrize("recorded_by", ["its own clock", "the simulation's"])
def test_a_simulation_that_is_reset_makes_passes(tmp_path: Path, start: float, recorded_by: str) -> None:
    half = TIME[:300]
    clock = np.r_[half + start, half + 1.0]
    receipts = NOW if recorded_by == "its own clock" else clock
    x, f = np.r_[X[:300], 1.1 * X[:300]], np.r_[F[:300], 1.1 * F[:300]]
    if recorded_by == "the simulation's" and start == 100.0:
        pytest.skip("two parts that share no time may have been written in any order")
    topics = {"/x": (clock, receipts, x), "/f": (clock, receipts + 1e-4, f)}
    runs = read(write(tmp_path / "bag", topics), topics)
    assert [len(run) for run in runs] == pytest.approx([300, 300], abs=1)
    for run in runs:
        assert "is set back by" in times_of(run)
        np.testing.assert_allclose(np.diff(run.time), STEP, rtol=1e-3)


def test_a_clock_of_the_recording_that_only_some_topics_follow_is_refused(tmp_path: Path) -> None:
    clock = np.r_[TIME[:300], TIME[:300]]
    topics = {"/x": (None, EPOCH + clock, X), "/f": (None, NOW, F)}
    with pytest.raises(InputError, match=r"recording's clock is set back by 1.49.? s between two messages of /x"):
        read(write(tmp_path / "bag", topics), topics)


def test_coarse_stamps_are_not_used(tmp_path: Path) -> None:
    coarse = np.floor(NOW * 50) / 50
    run = aligned(tmp_path, {"/x": (NOW, NOW + 1e-3, X), "/f": (coarse, NOW + 1e-3, F)})
    assert "/f: 75 % of its stamps repeat another one" in times_of(run)
    bursts = np.ceil(NOW * 10) / 10
    topics = {"/x": (NOW, NOW + 1e-3, X), "/f": (coarse, bursts, F)}
    with pytest.raises(InputError, match=r"of the messages of /f were received at the time of another one"):
        read(write(tmp_path / "other", topics), topics)


def test_bursts_do_no_harm_to_stamps(tmp_path: Path) -> None:
    bursts = np.ceil(NOW * 10 + 0.01) / 10
    run = aligned(tmp_path, {"/x": (NOW, bursts, X), "/f": (NOW + 3e-4, bursts + 1e-3, F)})
    assert "of the recording" not in times_of(run)


def test_a_current_without_stamps_follows_the_motion(tmp_path: Path) -> None:
    when = np.array([-0.5, 1.0, 2.0])
    topics = {"/x": (NOW - 7.0, NOW, X), "/f": (NOW - 7.0, NOW + 1e-3, F), "/i": (None, EPOCH + when, [0.1, 0.3, 0.2])}
    run = aligned(tmp_path, topics)
    assert run.clocks_agree("position", "force")
    assert not run.clocks_agree()
    assert "/i is put onto the stamps of /x by its times of receipt" in times_of(run)
    assert run.current[np.searchsorted(run.time, 0.99)] == 0.1
    assert run.current[np.searchsorted(run.time, 1.02)] == 0.3


def test_numbers_of_one_message_are_of_one_clock(tmp_path: Path) -> None:
    names = ["rod"] * 1
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/joints", "sensor_msgs/msg/JointState", typestore=STORE)
        for time, x, f in zip(NOW, X, F, strict=True):
            message = T["sensor_msgs/msg/JointState"](stamp(time), names, np.array([x]), np.array([]), np.array([f]))
            writer.write(connection, round(1e9 * time), STORE.serialize_cdr(message, "sensor_msgs/msg/JointState"))
    mapped = Mapped(topics={"position": "/joints.position[rod]", "force": "/joints.effort[rod]"}, current=0.0)
    (recording,) = read_passes(tmp_path / "bag", mapped)
    assert make_run("any", recording.columns, recording.info).clocks_agree()
    assert not any(note.startswith("times: ") for note in recording.info["notes"])


# Types and arrays

DEFINITION = "float64 position_mm\nfloat64 force_kN\nfloat64[] data\n"


def custom(path: Path, plugin: StoragePlugin) -> Path:
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(DEFINITION, "rig_msgs/msg/Sample"))
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/sample", "rig_msgs/msg/Sample", typestore=store)
        for time, x, f in zip(NOW, 1e3 * X, 1e-3 * F, strict=True):
            message = store.types["rig_msgs/msg/Sample"](x, f, np.array([time, x, f]))
            writer.write(connection, round(1e9 * time), store.serialize_cdr(message, "rig_msgs/msg/Sample"))
    return path


def test_a_type_without_its_definition_is_named(import_tool: Any, tmp_path: Path) -> None:
    custom(tmp_path / "bag", StoragePlugin.SQLITE3)
    with sqlite3.connect(tmp_path / "bag/bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    for arguments in ("bag", "bag --topics position=/sample.position_mm force=/sample.force_kN"):
        code, _, error = import_tool(f"{arguments} --current 0 --output bags")
        assert code == 2
        assert "no definition of this type in the bag: rig_msgs/msg/Sample (/sample)" in error
    with sqlite3.connect(tmp_path / "bag/bag.db3") as database:
        database.execute("DROP TABLE message_definitions")
    assert "rig_msgs/msg/Sample (/sample)" in import_tool("bag --current 0 --output bags")[2]


def test_units_in_the_names_of_fields_count(import_tool: Any, tmp_path: Path) -> None:
    custom(tmp_path / "bag", StoragePlugin.MCAP)
    code, text, error = import_tool("bag --output bags")
    assert code == 2
    proposed = error.partition("right of: ")[2].partition(" (numbers")[0]
    assert proposed == "--topics position=/sample.position_mm force=/sample.force_kN --current 0"
    code, text, error = import_tool(f"bag {proposed} --output bags")
    assert (code, error) == (0, "")
    assert "position is /sample.position_mm in mm; force is /sample.force_kN in kN" in text
    np.testing.assert_allclose(read_run(tmp_path / "bags/bag").force, F, atol=1e-9)


@pytest.mark.parametrize("length", [4, 20, 40])
def test_elements_of_an_array_are_listed_and_proposed(import_tool: Any, tmp_path: Path, length: int) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/rig", "std_msgs/msg/Float64MultiArray", typestore=STORE)
        for number, time in enumerate(TIME):
            data = np.zeros(length)
            data[:4] = time, X[number], F[number], 0.5
            layout = T["std_msgs/msg/MultiArrayLayout"]([], 0)
            message = T["std_msgs/msg/Float64MultiArray"](layout, data)
            receipt = round(1e9 * (EPOCH + np.ceil(10 * time) / 10)) + number  # in bursts
            writer.write(connection, receipt, STORE.serialize_cdr(message, "std_msgs/msg/Float64MultiArray"))
    error = import_tool("bag --current 0.5 --output bags")[2]
    assert error.startswith(
        "error: bag: is a bag of another bench; say which numbers to take with what is right of: --topics"
    )
    assert "/rig.data[1]" in error.partition("right of: ")[2].partition(" (")[0]
    assert "/rig.data[3]" in error.partition("numbers in it: ")[2]
    options = "--topics time='/rig.data[0]' position='/rig.data[1]' force='/rig.data[2]' current='/rig.data[3]'"
    assert import_tool(f"bag {options} --output bags")[0] == 0
    run = read_run(tmp_path / "bags/bag")
    np.testing.assert_allclose(run.time, TIME, atol=1e-9)
    np.testing.assert_allclose(run.position, X)
    assert run.clocks_agree()


def write_numbers(path: Path, *columns: Any) -> None:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/rig", "std_msgs/msg/Float64MultiArray", typestore=STORE)
        for number, row in enumerate(zip(*columns, strict=True)):
            message = T["std_msgs/msg/Float64MultiArray"](T["std_msgs/msg/MultiArrayLayout"]([], 0), np.array(row))
            receipt = round(1e9 * (EPOCH + TIME[number]))
            writer.write(connection, receipt, STORE.serialize_cdr(message, "std_msgs/msg/Float64MultiArray"))


NUMBERS = "--topics time='/rig.data[0]' position='/rig.data[1]' force='/rig.data[2]' --current 0.5"


@pytest.mark.parametrize("rate", ["", "--rate 100"])
def test_a_counter_in_ms_is_the_time_of_a_bag(import_tool: Any, tmp_path: Path, rate: str) -> None:
    write_numbers(tmp_path / "bag", (np.round(1e3 * TIME) + 64_000) % 2**16, X, F)
    code, text, error = import_tool(f"bag {NUMBERS} --units time=ms {rate} --output bags")
    assert (code, error) == (0, "")
    assert "the times begin again after 65536 and were continued" in text
    run = read_run(tmp_path / "bags/bag")
    assert len(run) == COUNT // (2 if rate else 1)
    np.testing.assert_allclose(run.position[1:-1], position(run.time[1:-1]), atol=2e-5)


def test_a_time_of_a_bag_that_repeats_is_refused(import_tool: Any, tmp_path: Path) -> None:
    write_numbers(tmp_path / "bag", np.floor(20 * TIME) / 20, X, F)
    code, _, error = import_tool(f"bag {NUMBERS} --output bags")
    assert code == 2
    assert "90 % of the times /rig.data[0] repeat another one, expected one of each message; leave it out" in error


# What is written


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(gaps=st.lists(st.floats(1e-3, 1e7), min_size=0, max_size=3), start=st.floats(-1e9, 4e9), seed=st.integers(0, 99))
def test_a_bag_that_was_written_can_be_read(tmp_path_factory: Any, gaps: list[float], start: float, seed: int) -> None:
    steps = np.full(199, STEP)
    steps[np.random.default_rng(seed).integers(0, 199, len(gaps))] = gaps
    time = start + np.r_[0.0, np.cumsum(steps)]
    values = {"position_m": X[:200], "force_N": F[:200], "current_A": np.zeros(200)}
    folder = tmp_path_factory.mktemp("written") / "bag"
    try:
        make_run("any", {"time_s": time, **values})
        write_bag({"time_s": time, **values}, [], Path("any.csv"), folder, {"clocks": {"position": "a", "force": "b"}})
    except InputError:
        assert not folder.exists()
        return
    run = read_run(folder)
    np.testing.assert_array_equal(run.time, time - time[0])
    assert run.clocks == {"position": "a", "force": "b"}


# The fuzzer

EXAMPLES = int(os.environ.get("MRD_FUZZ_EXAMPLES", "60"))


@dataclass(frozen=True)
class Clock:
    """A clock of a channel: the samples from ``begin`` to ``end``, and what is wrong with it, where and by how much."""

    begin: int
    end: int
    phase: float
    wrongs: tuple[tuple[str, int, float], ...]

    @property
    def instants(self) -> np.ndarray:
        """When the samples were measured, in s."""
        return np.arange(self.begin, COUNT - self.end) * STEP + self.phase

    def times(self, origin: float = 0.0) -> np.ndarray:
        """When they were measured by the clock, which reads ``origin`` at the instant 0."""
        time = origin + self.instants
        for wrong, place, size in self.wrongs:
            if wrong == "start":
                time += size
            elif wrong == "drift":
                time = origin + (time - origin) * (1 + size)
            elif wrong == "reset":
                time[place:] -= time[place] - size - origin
            elif wrong == "step":
                time[place:] += size
            elif wrong == "equal":
                time[place : place + int(size)] = time[place]
            else:
                time[place] = size
        return time


@st.composite
def clocks(draw: Any) -> Clock:
    places, ends = st.integers(60, 460), st.sampled_from([0, 1, 250, -1])
    wrong = st.one_of(
        st.tuples(st.just("start"), places, st.sampled_from([-0.5, 0.012, 0.02, 0.3, 40.0, 1e5])),
        st.tuples(st.just("drift"), places, st.sampled_from([-2e-2, -1e-3, 1e-4, 5e-3, 2e-2])),
        st.tuples(st.just("reset"), places, st.sampled_from([0.0, 0.4])),
        st.tuples(st.just("step"), places, st.sampled_from([-0.1, -0.012, 0.012, 0.05, 0.7])),
        st.tuples(st.just("equal"), places, st.integers(2, 30).map(float)),
        st.tuples(st.just("wrong"), ends, st.sampled_from([0.0, 3e8])),
    )
    phase = draw(st.sampled_from([0.0, 0.0, 0.3e-3, 2e-3]))
    return Clock(draw(st.integers(0, 40)), draw(st.integers(0, 40)), phase, tuple(draw(st.lists(wrong, max_size=2))))


DOUBTS = ("of the recording", "differs by that", "start", "times of their own", "jump", "set back")


def rod(instant: np.ndarray) -> np.ndarray:
    """A position that tells the instant of each sample, in m."""
    return 0.01 * instant


def cell(instant: np.ndarray) -> np.ndarray:
    """A force that does, in N."""
    return 100.0 * instant


def judge(read_it: Any) -> str:
    """Check that channels are aligned within a sample where their clocks are known to agree, and else that it is said.

    Two clocks that make the same step one after the other are apart in between; that is not seen in so few samples.
    """
    try:
        runs = read_it()
    except InputError:
        return "refused"
    said = "aligned"
    for run in runs:
        instants = run.position / 0.01, run.force / 100.0
        late = float(np.quantile(np.abs(instants[0] - instants[1]), 0.95))
        if late > 1.02 * STEP:
            assert not run.clocks_agree("position", "force"), (late, run.info["notes"])
            assert any(doubt in times_of(run) for doubt in DOUBTS), (late, run.info["notes"])
            said = "said"
        for instant in instants:
            assert np.count_nonzero(np.diff(instant) < -0.5 * STEP) <= 5, ("interleaved", run.info["notes"])
    return said


@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), deadline=None)
@given(
    x=clocks(),
    f=clocks(),
    shared=st.booleans(),
    delays=st.tuples(*[st.sampled_from([5e-4, 2e-3, 0.03])] * 2),
    stamped=st.integers(0, 4),
)
def test_no_topic_is_late_in_silence(tmp_path_factory: Any, x: Any, f: Any, shared: bool, delays: Any, stamped: int) -> None:
    other = x if shared else f
    receipts = [EPOCH + channel.instants + delay for channel, delay in zip((x, other), delays, strict=True)]
    topics = {
        "/x": (
            None if stamped == 1 else np.maximum(x.times(EPOCH if stamped > 2 else 1.0), 0.0),
            receipts[0],
            rod(x.instants),
        ),
        "/f": (None if stamped == 2 else other.times(EPOCH if stamped > 2 else 1.0), receipts[1], cell(other.instants)),
    }
    path = write(tmp_path_factory.mktemp("fuzz") / "bag", topics)
    event(judge(lambda: read(path, topics)))


@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), deadline=None)
@given(x=clocks(), f=clocks(), shared=st.booleans())
def test_no_column_is_late_in_silence(tmp_path_factory: Any, x: Any, f: Any, shared: bool) -> None:
    other = x if shared else f
    path = tmp_path_factory.mktemp("fuzz") / "a.csv"
    cells = zip(x.times(), rod(x.instants), other.times(), cell(other.instants), strict=False)
    if shared:
        lines = ["time [s],position [m],force [N]", *(f"{a:.7f},{b:.9f},{d:.6f}" for a, b, _, d in cells)]
    else:
        lines = ["time [s],position [m],time [s],force [N]", *(f"{a:.7f},{b:.9f},{c:.7f},{d:.6f}" for a, b, c, d in cells)]
    path.write_text("\n".join(lines))
    event(judge(lambda: of_table(path)))


def of_table(path: Path) -> list[Run]:
    return [make_run("any", one.columns, one.info, place=one.place) for one in read_passes(path, Mapped(current=0.0))]


@settings(max_examples=EXAMPLES, suppress_health_check=list(HealthCheck), deadline=None)
@given(
    starts=st.tuples(*[st.integers(0, 40)] * 2),
    increments=st.tuples(*[st.sampled_from([0.005, 0.005, 0.001, 0.0025])] * 2),
    offset=st.booleans(),
    explicit=st.booleans(),
)
def test_no_channel_is_late_in_silence(
    tmp_path_factory: Any, starts: Any, increments: Any, offset: bool, explicit: bool
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "a.tdms"
    channels = []
    for name, signal, start, increment in zip(("position", "force"), (rod, cell), starts, increments, strict=True):
        begin = start * STEP
        time = np.arange(begin, 2.9, increment)
        facts: dict[str, Any] = {"wf_increment": increment}
        if offset:
            facts["wf_start_offset"] = begin
        else:
            facts["wf_start_time"] = np.datetime64("2026-01-05T10:00:00") + np.timedelta64(round(1e6 * begin), "us")
        if explicit:
            channels += [ChannelObject(name, "time", time)]
            facts = {}
        channels.append(ChannelObject(name if explicit else "rig", name, signal(time), facts))
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)
    event(judge(lambda: of_table(path)))
