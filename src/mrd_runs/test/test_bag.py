"""Bags: every message that was written is read back, however the writer ended."""

import json
import os
import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import get_types_from_msg

from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.bag import FLUSH_PERIOD, BagWriter, read_bag
from mrd_runs.blocks import LAYOUT, SERIES, TEMPERATURE, decode_as_table, decode_blocks, decode_with_rosbags
from mrd_runs.completeness import check_completeness
from mrd_runs.definitions import SAMPLES_TYPE, as_of_today, empty_typestore, interface_folder, typestore

TYPES = typestore()


def test_every_sample_is_read_back_bit_by_bit(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    for path in (tmp_path / "run", tmp_path / "run/run.mcap"):
        run = read_run(path)
        assert run.name == "run"
        np.testing.assert_array_equal(run.time, columns["time_s"])
        np.testing.assert_array_equal(run.position, columns["position_m"])
        np.testing.assert_array_equal(run.current, columns["current_A"])
        np.testing.assert_array_equal(run.force, columns["force_N"])
        np.testing.assert_array_equal(run.acceleration, columns["acceleration_mps2"])
        assert run.info["lost"] == 0
        assert not run.info["recovered"]


def test_bag_is_an_ordinary_one(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    with Reader(tmp_path / "run") as reader:
        assert reader.message_count == 50
        (connection,) = reader.connections
        assert connection.msgtype == SAMPLES_TYPE
        assert connection.ext.offered_qos_profiles[0].depth == 200
    assert (tmp_path / "run/metadata.yaml").exists()


def test_the_definitions_in_a_bag_name_the_units(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    (schema,) = _schemas(tmp_path / "run")
    assert "float64[] force               # N, > 0 resists extension" in schema
    assert "MSG: std_msgs/Header" in schema


def _schemas(bag: Path) -> list[str]:
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        schemas = make_reader(stream).get_summary().schemas.values()
        return [schema.data.decode() for schema in schemas]


def test_type_hashes_are_those_of_ros() -> None:
    """`ros2 bag play` refuses types with other hashes."""
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    files = [file for prefix in prefixes for file in Path(prefix).glob("share/mrd_interfaces/msg/*.json")]
    assert files
    for file in files:
        described = json.loads(file.read_text())
        entry = next(entry for entry in described["type_hashes"] if entry["type_name"].endswith(f"/{file.stem}"))
        assert TYPES.hash_rihs01(entry["type_name"]) == entry["hash_string"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_exception_closes_the_bag(tmp_path: Path, columns, fill_bag, error: type[BaseException]) -> None:
    def record() -> None:
        with fill_bag(tmp_path / "run", columns):
            raise error

    with pytest.raises(error):
        record()
    assert len(read_run(tmp_path / "run")) == 1000


def test_existing_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path / "run")


def test_a_folder_that_somebody_makes_in_the_same_instant_is_not_written_into(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(Path, "exists", lambda _path: False)
    with pytest.raises(InputError, match="cannot be made"):
        BagWriter(tmp_path / "run")


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        BagWriter(tmp_path / "file/run")


def test_flushed_messages_survive_without_a_close(tmp_path: Path, columns, fill_bag) -> None:
    writer = fill_bag(tmp_path / "run", columns)
    writer.flush()
    run = read_run(tmp_path / "run")
    assert len(run) == 1000
    assert run.info["recovered"]
    assert "the bag was not closed: 1000 samples recovered" in run.info["notes"]
    writer.close()
    assert not read_run(tmp_path / "run").info["recovered"]


def test_writing_flushes_by_the_stamps_and_by_the_wall(tmp_path: Path, columns, fill_bag) -> None:
    """Of 1 s of samples written at once, at most a flush period is held back."""
    writer = fill_bag(tmp_path / "fast", columns)
    assert len(read_run(tmp_path / "fast")) >= 1000 - FLUSH_PERIOD * 1000 - 20
    writer.close()


SPAWNED = """
    import sys, time
    sys.path.insert(0, {test!r})
    from conftest import block_message, series
    from mrd_runs.bag import BagWriter
    from mrd_runs.definitions import SAMPLES_TYPE
    columns = series(60_000)
    writer = BagWriter(sys.argv[1])
    writer.add_topic("/samples", SAMPLES_TYPE, depth=200)
    start = time.monotonic()
    for first in range(0, 60_000, 20):
        time.sleep(max(0, start + first / 1000 - time.monotonic()))
        writer.write_message("/samples", time.time_ns(), block_message(columns, first, first + 20))
        print(first + 20, flush=True)
"""


@pytest.mark.parametrize("delay", [0.4, 1.1])
def test_killed_writer_loses_less_than_a_second(tmp_path: Path, delay: float) -> None:
    code = textwrap.dedent(SPAWNED.format(test=str(Path(__file__).parent)))
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "run")], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    written = int(process.stdout.read().split()[-1])
    process.wait()
    bag = read_bag(tmp_path / "run")
    kept = sum(len(block.position) for block in bag.decode("/samples"))
    assert bag.recovered
    assert written - kept < 1000
    assert kept > 0


def test_file_cut_anywhere_gives_a_prefix_or_one_line(tmp_path: Path, columns, whole_bag, read_or_refuse) -> None:
    cut = tmp_path / "cut.mcap"
    lengths = [0]
    for end in range(1, len(whole_bag), len(whole_bag) // 40):
        cut.write_bytes(whole_bag[:end])
        result = read_or_refuse(cut)
        if isinstance(result, str):
            assert "\n" not in result
        else:
            np.testing.assert_array_equal(result.position, columns["position_m"][: len(result)])
            lengths.append(len(result))
    assert len(set(lengths)) > 3
    assert lengths == sorted(lengths)


def test_file_cut_after_closing_is_refused(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    file = tmp_path / "run/run.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    with pytest.raises(InputError, match="has lost its end since"):
        read_run(tmp_path / "run")


@settings(max_examples=40)
@given(at=st.integers(0, 10**6), junk=st.binary(min_size=1, max_size=40))
def test_damaged_file_never_gives_more_than_one_line(
    tmp_path_factory, whole_bag, read_or_refuse, at: int, junk: bytes
) -> None:
    damaged = bytearray(whole_bag)
    at %= len(damaged)
    damaged[at : at + len(junk)] = junk
    file = tmp_path_factory.getbasetemp() / "damaged.mcap"
    file.write_bytes(damaged)
    result = read_or_refuse(file)
    assert not isinstance(result, str) or "\n" not in result


def write_sqlite(path: Path, columns, block) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/bench/samples", SAMPLES_TYPE, typestore=TYPES)
        for first in range(0, 1000, 20):
            cdr = TYPES.serialize_cdr(block(columns, first, first + 20), SAMPLES_TYPE)
            writer.write(connection, first * 1_000_000, cdr)
    return path


def test_sqlite_bags_and_namespaces(tmp_path: Path, columns, make_block) -> None:
    folder = write_sqlite(tmp_path / "run", columns, make_block)
    for path in (folder, folder / "run.db3"):
        run = read_run(path)
        assert run.info["topic"] == "/bench/samples"
        np.testing.assert_array_equal(run.force, columns["force_N"])


def test_samples_under_another_name(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns, topic="/bench/old_samples").close()
    assert len(read_run(tmp_path / "run")) == 1000


def test_truncated_sqlite(tmp_path: Path, columns, make_block) -> None:
    file = write_sqlite(tmp_path / "run", columns, make_block) / "run.db3"
    (tmp_path / "cut.db3").write_bytes(file.read_bytes()[:5000])
    with pytest.raises(InputError, match="cannot be read as a bag"):
        read_run(tmp_path / "cut.db3")


def test_bag_without_samples_lists_its_topics(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "other") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
        writer.write_message("/chatter", 1, TYPES.types["std_msgs/msg/String"]("hello"))
    with pytest.raises(InputError, match=r"no topic of type .*BenchSamples; topics in it: /chatter \(std_msgs/msg/String\)"):
        read_run(tmp_path / "other")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("junk.mcap", b"\x00\xff" * 500, "cannot be read as a bag"),
        ("empty.mcap", b"", "is empty"),
        ("junk.db3", b"SQLite format 3\0" + b"junk" * 100, "cannot be read as a bag"),
        ("empty.db3", b"", "is empty"),
    ],
)
def test_foreign_files(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        read_run(tmp_path / name)


def test_folders_that_are_no_bags(tmp_path: Path, columns, fill_bag) -> None:
    with pytest.raises(InputError, match="no such file"):
        read_run(tmp_path / "absent")
    with pytest.raises(InputError, match=r"without an \.mcap or \.db3"):
        read_run(tmp_path)
    fill_bag(tmp_path / "run", columns).close()
    (tmp_path / "run/run.mcap").unlink()
    with pytest.raises(InputError, match="storage file is missing"):
        read_run(tmp_path / "run")


def test_folder_of_several_files_without_metadata_is_refused(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns).close()
    (tmp_path / "run/metadata.yaml").unlink()
    (tmp_path / "run/run_1.mcap").write_bytes((tmp_path / "run/run.mcap").read_bytes())
    with pytest.raises(InputError, match=r"run: holds 2 storage files .* give one of them \(run.mcap, run_1.mcap\)$"):
        read_run(tmp_path / "run")
    assert len(read_run(tmp_path / "run/run_1.mcap")) == 1000


def test_unreadable_run_info_is_named(tmp_path: Path, columns, fill_bag) -> None:
    with fill_bag(tmp_path / "run", columns) as writer:
        writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
        writer.write_message("/run_info", 0, TYPES.types["std_msgs/msg/String"]("{no json"))
    with pytest.raises(InputError, match=r"run: run_info or calibration cannot be read"):
        read_run(tmp_path / "run")


def test_missing_blocks_are_counted_and_leave_a_gap_in_time(tmp_path: Path, columns, fill_bag) -> None:
    writer = fill_bag(tmp_path / "run", columns, skip=(10, 11, 30))
    writer.close()
    run = read_run(tmp_path / "run")
    assert run.info["lost"] == 60
    assert len(run) == 940
    assert np.diff(run.time).max() == pytest.approx(0.041)
    np.testing.assert_array_equal(run.time, np.delete(columns["time_s"], [*range(200, 240), *range(600, 620)]))
    completeness = check_completeness(tmp_path / "run", "/samples", writer.counts)
    assert (completeness.samples, completeness.lost) == (940, 60)
    assert "60 of 1000 samples are missing" in completeness.problem


def test_check_counts_missing_messages(tmp_path: Path, columns, fill_bag) -> None:
    writer = fill_bag(tmp_path / "run", columns)
    writer.close()
    assert check_completeness(tmp_path / "run", "/samples", writer.counts).problem == ""
    assert "3 of /samples" in check_completeness(tmp_path / "run", "/samples", {"/samples": 53}).problem


def test_daq_restarted_during_the_recording(tmp_path: Path, columns, make_block) -> None:
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/samples", SAMPLES_TYPE)
        for start in (1.7e9, 1.7e9 + 3):
            for first in range(0, 1000, 20):
                block = make_block(columns, first, first + 20, start)
                writer.write_message("/samples", int((start + first / 1000) * 1e9), block)
    run = read_run(tmp_path / "run")
    assert len(run) == 2000
    assert run.time[1000] - run.time[999] == pytest.approx(3 - 0.999)
    assert (np.diff(run.time) > 0).all()


def test_stamps_that_jitter_do_not_make_time_jitter(tmp_path: Path, columns, make_block) -> None:
    rng = np.random.default_rng(0)
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/samples", SAMPLES_TYPE)
        for first in range(0, 1000, 20):
            block = make_block(columns, first, first + 20)
            block.header.stamp.nanosec = int(np.clip(block.header.stamp.nanosec + rng.normal(0, 1e6), 0, 10**9 - 1))
            writer.write_message("/samples", first, block)
    run = read_run(tmp_path / "run")
    np.testing.assert_array_equal(run.time, columns["time_s"])
    assert run.info["jitter_s"] == pytest.approx(1e-3, rel=0.4)


def test_bag_without_accelerometer(tmp_path: Path, columns, fill_bag) -> None:
    columns["acceleration_mps2"][:] = np.nan
    fill_bag(tmp_path / "run", columns).close()
    assert read_run(tmp_path / "run").acceleration is None


def test_nan_in_a_bag(tmp_path: Path, columns, fill_bag) -> None:
    columns["force_N"][123] = np.nan
    fill_bag(tmp_path / "run", columns).close()
    with pytest.raises(InputError, match="sample 123: force_N is nan"):
        read_run(tmp_path / "run")


def test_layout_is_that_of_the_definition() -> None:
    assert TYPES.fielddefs[SAMPLES_TYPE][1] == LAYOUT


@settings(max_examples=80)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=1, max_size=6),
    st.text("abc/", max_size=9),
    st.integers(0, 2**40),
)
def test_table_decoder_agrees_with_rosbags(blocks: list[tuple[int, bool]], frame: str, sequence: int) -> None:
    """With and without a thermometer."""
    types = TYPES.types
    rng = np.random.default_rng(0)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](-5, 999), frame)
    messages = [
        bytes(
            TYPES.serialize_cdr(
                types[SAMPLES_TYPE](
                    header, 1e-3, sequence, *(rng.normal(size=count) for _ in SERIES), rng.normal(size=count * is_measured)
                ),
                SAMPLES_TYPE,
            )
        )
        for count, is_measured in blocks
    ]
    expected = decode_with_rosbags(messages, TYPES)
    decoded = decode_blocks(messages, TYPES)
    assert decode_as_table(messages[:1]) is not None or blocks[0][0] == 0
    for name in ("stamp", "period", "sequence", "count"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(expected, name))
    for name in (*SERIES, TEMPERATURE):
        np.testing.assert_array_equal(decoded.series[name], expected.series[name])


@pytest.fixture
def old_definitions(tmp_path: Path) -> Path:
    """Definitions of the messages before they had the damper's temperature."""
    folder = tmp_path / "old"
    folder.mkdir()
    for file in interface_folder().glob("*.msg"):
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        is_new = file.stem in ("BenchSamples", "Measurement")
        kept = [line for line in lines if not (is_new and " temperature " in line)]
        assert len(kept) == len(lines) - is_new
        (folder / file.name).write_text("".join(kept), encoding="utf-8")
    return folder


def test_a_bag_from_before_the_temperature_is_read(tmp_path: Path, columns, monkeypatch, old_definitions) -> None:
    with monkeypatch.context() as before:
        before.setattr("mrd_runs.definitions.interface_folder", lambda: old_definitions)
        with BagWriter(tmp_path / "run") as writer:
            types = writer.types.types
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](5, 0), "")
            writer.add_topic("/samples", SAMPLES_TYPE)
            writer.add_topic("/measurement", "mrd_interfaces/msg/Measurement")
            writer.write_message("/measurement", 1, types["mrd_interfaces/msg/Measurement"](header, 1.0, 2.0, 3.0, 4.0, 5.0))
            for first in range(0, 1000, 20):
                series = (columns[name][first : first + 20] for name in ("position_m", "force_N", "current_A"))
                block = types[SAMPLES_TYPE](header, 1e-3, first, *series, np.full(20, np.nan))
                writer.write_message("/samples", 1 + first, block)
    bag = read_bag(tmp_path / "run")
    assert "temperature" not in dict(bag.types.fielddefs[SAMPLES_TYPE][1])
    run = read_run(tmp_path / "run")
    assert run.temperature is None
    np.testing.assert_array_equal(run.force, columns["force_N"])

    def of_today(topic: str) -> Any:
        entry = bag.topics[topic]
        messages = as_of_today(entry.messages, entry.message_type, bag.types)
        return TYPES.deserialize_cdr(messages[0], entry.message_type)

    assert np.isnan(of_today("/measurement").temperature)
    assert of_today("/measurement").acceleration == 5.0
    assert len(of_today("/samples").temperature) == 0
    np.testing.assert_array_equal(of_today("/samples").force, columns["force_N"][:20])


def test_the_temperature_of_a_bag(tmp_path: Path, columns, fill_bag) -> None:
    warm = columns | {"temperature_C": np.linspace(20.0, 60.0, 1000)}
    fill_bag(tmp_path / "run", warm).close()
    run = read_run(tmp_path / "run")
    assert run.temperature == pytest.approx(warm["temperature_C"] + 273.15)
    assert "temperature  20.0 to 60.0 °C" in re.sub(r" {3,}", "  ", run.summary())
    warm["temperature_C"][500:503] = np.nan
    fill_bag(tmp_path / "gap", warm).close()
    run = read_run(tmp_path / "gap")
    assert run.temperature is None
    assert "the temperature is left out: the thermometer could not be read at 3 samples" in run.info["notes"]


def test_blocks_of_unequal_series(tmp_path: Path, columns, make_block) -> None:
    block = make_block(columns, 0, 20)
    block.force = block.force[:19]
    with BagWriter(tmp_path / "run") as writer:
        writer.add_topic("/samples", SAMPLES_TYPE)
        writer.write_message("/samples", 1, block)
    with pytest.raises(InputError, match="unequal lengths"):
        read_run(tmp_path / "run")


def test_reading_needs_no_ros(tmp_path: Path, columns, fill_bag) -> None:
    """A plain interpreter reads a bag where no part of ROS can be imported."""
    fill_bag(tmp_path / "run", columns).close()
    code = """
        import sys
        for name in ("rclpy", "ament_index_python", "mrd_interfaces", "std_msgs", "builtin_interfaces"):
            sys.modules[name] = None
        from mrd_runs import read_run
        print(len(read_run(sys.argv[1])))
        from mrd_runs.bag import BagWriter
        from mrd_runs.definitions import SAMPLES_TYPE
        with BagWriter(sys.argv[1] + "2") as writer:
            writer.add_topic("/samples", SAMPLES_TYPE)
    """
    environment = {key: value for key, value in os.environ.items() if "AMENT" not in key and not key.startswith("ROS")}
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "run")],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.stdout.strip(), result.stderr, result.returncode) == ("1000", "", 0)


def test_messages_of_an_older_definition_are_brought_up_to_date():
    """The bags of earlier benches have setpoints without the number of a lease."""
    folder = interface_folder()
    text = (folder / "Setpoint.msg").read_text()
    older = "\n".join(line for line in text.splitlines() if " lease " not in line)
    assert older.count("\n") < text.count("\n")
    before, kind = empty_typestore(), "mrd_interfaces/msg/Setpoint"
    before.register(get_types_from_msg(older, kind))
    stamp = before.types["builtin_interfaces/msg/Time"](5, 6)
    header = before.types["std_msgs/msg/Header"](stamp, "")
    cdr = bytes(before.serialize_cdr(before.types[kind](header, 0.01, 0.02, 0.03, 0.04), kind))
    today = typestore()
    (message,) = as_of_today([cdr], kind, before)
    setpoint = today.deserialize_cdr(message, kind)
    assert (setpoint.header.stamp.nanosec, setpoint.position, setpoint.coil_current, setpoint.lease) == (6, 0.01, 0.04, 0)
    assert as_of_today([message], kind, today) == [message]
    other = empty_typestore()
    other.register(get_types_from_msg("float64 other\n", kind))
    with pytest.raises(InputError, match="defines mrd_interfaces/msg/Setpoint otherwise"):
        as_of_today([cdr], kind, other)
