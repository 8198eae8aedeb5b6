"""Recovery: whatever can be read of a damaged bag is in a new one that the usual libraries read."""

import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from mrd_base import InputError
from mrd_runs import read_run
from mrd_runs.bag import BagWriter, read_bag
from mrd_runs.cli import recover
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.recovery import recover_bag, recovered_path

TYPES = typestore()
Messages = list[tuple[str, int, bytes]]


def read_with_rosbags(bag: Path) -> Messages:
    with AnyReader([bag]) as reader:
        messages = list(reader.messages())
        for connection, _, data in messages:
            reader.deserialize(data, connection.msgtype)
        return [(connection.topic, stamp, bytes(data)) for connection, stamp, data in messages]


def read_with_mcap(bag: Path) -> Messages:
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in messages]


def recovered(bag: Path) -> tuple[Messages, tuple[str, ...]]:
    """Recover a bag and read the new one with every reader; return its messages and what was lost."""
    before = {file: file.read_bytes() for file in ([bag] if bag.is_file() else bag.iterdir())}
    new = recovered_path(bag)
    shutil.rmtree(new, ignore_errors=True)
    recovery = recover_bag(bag, new)
    assert before == {file: file.read_bytes() for file in ([bag] if bag.is_file() else bag.iterdir())}
    messages = read_with_mcap(new)
    assert sorted(messages) == sorted(read_with_rosbags(new))
    ours = read_bag(new)
    assert ours.recovered == bool(recovery.losses)
    assert {name: len(topic.messages) for name, topic in ours.topics.items() if topic.messages} == recovery.counts
    return messages, recovery.losses


class Whole:
    """A complete bag: its file, its content, its messages."""

    def __init__(self, file: Path) -> None:
        self.file, self.content, self.messages = file, file.read_bytes(), read_with_mcap(file.parent)

    def changed(self, content: bytes) -> Path:
        """Write other content into a file beside it."""
        path = self.file.with_name("changed.mcap")
        path.write_bytes(content)
        return path


def make_whole(folder: Path, columns, make_block, compression: CompressionMode) -> Whole:
    writer = Writer(folder / "whole", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/samples", SAMPLES_TYPE, typestore=TYPES)
        for first in range(0, 1000, 20):
            cdr = TYPES.serialize_cdr(make_block(columns, first, first + 20), SAMPLES_TYPE)
            writer.write(connection, first * 1_000_000, cdr)
            if first % 280 == 260:
                writer.storage.close_chunk()
    return Whole(folder / "whole/whole.mcap")


def recovered_or_refused(bag: Path) -> tuple[Messages, tuple[str, ...]]:
    try:
        return recovered(bag)
    except InputError as error:
        refusal = str(error)
    assert "holds no message that can be recovered" in refusal
    assert "\n" not in refusal
    assert not recovered_path(bag).exists()
    return [], (refusal,)


@pytest.fixture(scope="session")
def whole(tmp_path_factory, whole_bag) -> Whole:
    """As the recorder writes: chunks of up to 14 blocks."""
    file = tmp_path_factory.mktemp("whole") / "whole.mcap"
    file.write_bytes(whole_bag)
    return Whole(file)


def chunk_ends(file: Path) -> list[tuple[int, int]]:
    """Positions behind the chunks of a file, each with the number of messages before it."""
    ends, count = [], 0
    with file.open("rb") as stream:
        for entry in StreamReader(stream, emit_chunks=True).records:
            if isinstance(entry, Chunk):
                count += sum(isinstance(inner, Message) for inner in breakup_chunk(entry))
                ends.append((stream.tell(), count))
    return ends


@pytest.fixture
def killed(tmp_path: Path, columns, fill_bag) -> Path:
    """A bag as a killed recorder leaves it."""
    writer = fill_bag(tmp_path / "open", columns)
    writer.flush()
    shutil.copytree(tmp_path / "open", tmp_path / "run")
    (tmp_path / "run/open.mcap").rename(tmp_path / "run/run.mcap")
    writer.close()
    return tmp_path / "run"


def test_killed_bag_is_refused_by_the_usual_readers_and_recovered(killed: Path, columns) -> None:
    with pytest.raises(Exception, match="metadata"):
        read_with_rosbags(killed)
    with pytest.raises(Exception):  # noqa: B017, PT011
        read_with_mcap(killed)
    messages, losses = recovered(killed)
    assert len(messages) == 50
    assert losses == ("run.mcap was not closed; what had not reached it is lost",)
    run = read_run(recovered_path(killed))
    np.testing.assert_array_equal(run.force, columns["force_N"])
    assert run.info["recovered"]


def test_complete_bag_is_copied_without_a_loss(tmp_path: Path, columns, fill_bag) -> None:
    with fill_bag(tmp_path / "run", columns) as writer:
        writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
        writer.write_message("/run_info", 0, TYPES.types["std_msgs/msg/String"]("{}"))
    messages, losses = recovered(tmp_path / "run")
    assert (len(messages), losses) == (51, ())
    old, new = (AnyReader([path]) for path in (tmp_path / "run", tmp_path / "run_recovered"))
    with old, new:
        assert [c._replace(owner=None) for c in old.connections] == [c._replace(owner=None) for c in new.connections]


@settings(max_examples=60)
@given(end=st.integers(8, 10**6), zeros=st.sampled_from([0, 1, 8, 37, 4096]))
def test_bag_cut_anywhere_and_padded(whole: Whole, end: int, zeros: int) -> None:
    """A cut keeps every message of the chunks before it; zeros behind it add and take nothing."""
    end = 8 + end % (len(whole.content) - 7)
    file = whole.changed(whole.content[:end] + bytes(zeros))
    kept = max((count for chunk_end, count in chunk_ends(whole.file) if chunk_end <= end), default=0)
    messages, losses = recovered_or_refused(file)
    assert messages == whole.messages[: len(messages)]
    assert kept <= len(messages) <= kept + 14
    assert (losses == ()) == (end == len(whole.content) and zeros == 0)


def test_more_of_a_file_is_never_less_of_its_messages(tmp_path: Path, columns, make_block) -> None:
    """Without compression, a chunk that is cut gives the messages before the cut."""
    whole = make_whole(tmp_path, columns, make_block, CompressionMode.NONE)
    counts = []
    for end in range(3000, len(whole.content), len(whole.content) // 60):
        messages, _ = recovered(whole.changed(whole.content[:end]))
        assert messages == whole.messages[: len(messages)]
        counts.append(len(messages))
    assert counts == sorted(counts)
    assert counts[-1] == 50
    assert len(set(counts)) > 40


@settings(max_examples=40)
@given(at=st.integers(0, 10**6), junk=st.binary(min_size=1, max_size=40))
def test_damage_costs_at_most_its_chunk(whole: Whole, at: int, junk: bytes) -> None:
    """Only damage to the first chunk, which defines the topic, is one that the end of the file must make good."""
    damaged = bytearray(whole.content)
    at = 8 + at % (len(damaged) - 8)
    damaged[at : at + len(junk)] = junk
    messages, _ = recovered(whole.changed(bytes(damaged[: len(whole.content)])))
    lost = set(whole.messages) - set(messages)
    assert len(lost) <= 28  # two chunks, where the damage begins in one and ends in the next
    assert messages == [message for message in whole.messages if message not in lost]


def test_lost_samples_and_messages_are_counted(tmp_path: Path, columns, fill_bag) -> None:
    fill_bag(tmp_path / "run", columns, skip=(3,)).close()
    file = tmp_path / "run/run.mcap"
    # The last 7 kB are a part of the last chunk, and the summary, which holds the definitions once more.
    file.write_bytes(file.read_bytes()[:-7000])
    messages, losses = recovered(tmp_path / "run")
    count = len(messages)
    assert 30 < count < 49
    assert f"{49 - count} of 49 messages, by metadata.yaml" in losses
    assert "20 samples of /samples, by their sequence numbers" in losses


@pytest.mark.parametrize("text", [None, b"", bytes(300), b"- [", b"a: b"])
def test_metadata_missing_or_damaged(tmp_path: Path, columns, fill_bag, text: bytes | None) -> None:
    fill_bag(tmp_path / "run", columns).close()
    (tmp_path / "run/metadata.yaml").unlink()
    if text is not None:
        (tmp_path / "run/metadata.yaml").write_bytes(text)
        with pytest.raises(InputError, match=r"metadata\.yaml: is not the metadata of a bag"):
            read_run(tmp_path / "run")
    messages, losses = recovered(tmp_path / "run")
    assert len(messages) == 50
    assert losses == (() if text is None else ("metadata.yaml cannot be read",))


def test_files_of_a_split_bag_are_joined_in_the_order_of_their_numbers(tmp_path: Path, columns, make_block) -> None:
    (tmp_path / "run").mkdir()
    for number in (0, 2, 10):
        with BagWriter(tmp_path / f"part_{number}") as writer:
            writer.add_topic("/samples", SAMPLES_TYPE)
            writer.write_message("/samples", number, make_block(columns, 20 * number, 20 * number + 20))
        (tmp_path / f"part_{number}/part_{number}.mcap").rename(tmp_path / f"run/run_{number}.mcap")
    (tmp_path / "run/run_11.mcap").touch()
    messages, losses = recovered(tmp_path / "run")
    assert [stamp for _, stamp, _ in messages] == [0, 2, 10]
    assert losses == ("run_11.mcap is empty", "160 samples of /samples, by their sequence numbers")


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_bags_of_other_writers(tmp_path: Path, columns, make_block, mode: CompressionMode) -> None:
    """Without compression, or with each message compressed by itself, which only metadata.yaml tells."""
    writer = Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/samples", SAMPLES_TYPE, typestore=TYPES)
        for first in range(0, 1000, 20):
            writer.write(connection, first, TYPES.serialize_cdr(make_block(columns, first, first + 20), SAMPLES_TYPE))
    for path in (tmp_path / "run", tmp_path / "run/run.mcap"):
        np.testing.assert_array_equal(read_run(path).force, columns["force_N"])
    (tmp_path / "run/metadata.yaml").unlink()
    messages, _ = recovered(tmp_path / "run")
    assert len(messages) == 50
    np.testing.assert_array_equal(read_run(recovered_path(tmp_path / "run")).force, columns["force_N"])


def write_sqlite(path: Path, columns, make_block: Callable[..., object]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/bench/samples", SAMPLES_TYPE, typestore=TYPES)
        for first in range(0, 1000, 20):
            cdr = TYPES.serialize_cdr(make_block(columns, first, first + 20), SAMPLES_TYPE)
            writer.write(connection, first * 1_000_000, cdr)
    return path / f"{path.name}.db3"


def test_sqlite_without_metadata(tmp_path: Path, columns, make_block) -> None:
    file = write_sqlite(tmp_path / "run", columns, make_block)
    messages, losses = recovered(file)
    assert (len(messages), losses) == (50, ())


@pytest.mark.parametrize("pages", [8, 11, 14])
def test_sqlite_of_which_pages_are_missing(tmp_path: Path, columns, make_block, pages: int) -> None:
    file = write_sqlite(tmp_path / "run", columns, make_block)
    content = file.read_bytes()
    (tmp_path / "cut.db3").write_bytes(content[: 4096 * pages] + bytes(1000))
    messages, losses = recovered(tmp_path / "cut.db3")
    assert 0 < len(messages) < 50
    assert losses[0].startswith("cut.db3 has pages that cannot be read (")


KILLED_SQLITE = """
import os, sqlite3, sys
database = sqlite3.connect(sys.argv[1])
database.execute("PRAGMA journal_mode = " + sys.argv[2])
database.execute("PRAGMA cache_size = 1")
database.execute("DELETE FROM messages WHERE id > 10" if sys.argv[2] == "DELETE" else "DELETE FROM messages WHERE id > 49")
if sys.argv[2] == "WAL":
    database.commit()
os.kill(os.getpid(), 9)
"""


@pytest.mark.parametrize(("mode", "journal", "count"), [("DELETE", "-journal", 50), ("WAL", "-wal", 49)])
def test_sqlite_with_a_journal(tmp_path: Path, columns, make_block, mode: str, journal: str, count: int) -> None:
    """What was not committed is undone, and what was only written to the journal is read, in a copy."""
    file = write_sqlite(tmp_path / "run", columns, make_block)
    subprocess.run([sys.executable, "-c", KILLED_SQLITE, str(file), mode], check=False)
    assert Path(f"{file}{journal}").stat().st_size > 0
    messages, losses = recovered(tmp_path / "run")
    assert len(messages) == count
    assert losses == (() if count == 50 else ("1 of 50 messages, by metadata.yaml",))


def test_sqlite_with_rows_without_end(tmp_path: Path) -> None:
    """A view makes as many rows as it likes from nothing."""
    with sqlite3.connect(tmp_path / "bomb.db3") as database:
        database.execute("CREATE TABLE topics(id, name, type, serialization_format, offered_qos_profiles)")
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (VALUES(1) UNION ALL SELECT id + 1 FROM n) "
            "SELECT id, 1 AS topic_id, 1 AS timestamp, zeroblob(1000000) AS data FROM n"
        )
    database.close()
    for work in (read_run, lambda path: recover_bag(path, tmp_path / "new")):
        with pytest.raises(InputError, match="it has no tables of topics and messages"):
            work(tmp_path / "bomb.db3")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("junk.mcap", b"\x00\xff" * 500, "does not begin as an MCAP file"),
        ("empty.mcap", b"", "empty.mcap is empty"),
        ("head.mcap", b"\x89MCAP0\r\n", "was not closed"),
        ("junk.db3", b"SQLite format 3\0" + b"junk" * 100, "cannot be read as a bag"),
        ("other.txt", b"text", "is not an .mcap or .db3 file"),
    ],
)
def test_nothing_to_recover(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        recover_bag(tmp_path / name, tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_tool(killed: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", ["recover", str(killed)])
    recover.main()
    assert capsys.readouterr().out == (
        f"{tmp_path}/run_recovered: recovered 50 messages (50 of /samples)\n"
        "  lost: run.mcap was not closed; what had not reached it is lost\n"
    )
    with pytest.raises(SystemExit) as end:
        recover.main()
    assert end.value.code == 2
    assert "run_recovered: exists already" in capsys.readouterr().err
    monkeypatch.setattr(sys, "argv", ["recover", str(killed), "--output", str(tmp_path / "new")])
    recover.main()
    assert len(read_run(tmp_path / "new/run_recovered")) == 1000
