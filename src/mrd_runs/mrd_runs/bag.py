"""Bags: writing them so that a killed process loses little, and reading them also when they were not closed.

A bag is an ordinary rosbag2 folder (MCAP, version 9), which ``ros2 bag info`` and ``ros2 bag play`` understand. Every
message reaches the operating system within `FLUSH_PERIOD`, so that a killed process loses no more than that.
"""

import os
import time
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.interfaces import MessageDefinitionFormat as Format
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import get_types_from_idl, get_types_from_msg
from rosbags.typesys.store import Typestore

from mrd_base import InputError
from mrd_runs.definitions import empty_typestore, typestore

# Longest time in s that a message waits before it goes to the operating system, by the wall clock and by the stamps.
FLUSH_PERIOD = 0.25

_INFINITE = QosTime(9223372036, 854775807)  # as ROS writes an infinite duration


def qos(depth: int, latched: bool = False) -> Qos:
    """Return the reliable quality of service of the bench's topics (`mrd_base.nodes.bench_node`)."""
    durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
    return Qos(
        QosHistory.KEEP_LAST,
        depth,
        QosReliability.RELIABLE,
        durability,
        _INFINITE,
        _INFINITE,
        QosLiveliness.AUTOMATIC,
        _INFINITE,
        False,
    )


class BagWriter:
    """Writes one bag; as a context manager it closes the bag in every case.

    Parameters
    ----------
    path : path
        Folder of the bag; it must not exist.

    Attributes
    ----------
    types : Typestore
        Types of the messages.
    counts : dict of str to int
        Number of messages written to each topic.

    Raises
    ------
    InputError
        When the folder exists or cannot be made.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f"{path}: exists already and is not overwritten; give another folder or remove it")
        self.types = typestore()
        self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        # Compression halves the file and makes reading faster; writing takes a tenth longer (benchmarks/read_bag.py).
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._writer.open()
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror})") from None
        self._connections: dict[str, Connection] = {}
        self._flushed_at = time.monotonic()
        self._first_unflushed: int | None = None
        self.counts: dict[str, int] = {}
        self.flush()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def add_topic(self, topic: str, message_type: str, *, depth: int = 1, latched: bool = False) -> None:
        """Add a topic; after that, its messages can be written."""
        self._connections[topic] = self._writer.add_connection(
            topic, message_type, typestore=self.types, offered_qos_profiles=[qos(depth, latched)]
        )
        self.counts[topic] = 0

    def write(self, topic: str, stamp: int, cdr: bytes) -> None:
        """Write a serialised message; ``stamp`` in ns."""
        self._writer.write(self._connections[topic], stamp, cdr)
        self.counts[topic] += 1
        if self._first_unflushed is None:
            self._first_unflushed = stamp
        elapsed = time.monotonic() - self._flushed_at
        if max(elapsed, 1e-9 * (stamp - self._first_unflushed)) >= FLUSH_PERIOD:
            self.flush()

    def write_message(self, topic: str, stamp: int, message: Any) -> None:
        """Write a message object of `types`; ``stamp`` in ns."""
        cdr = self.types.serialize_cdr(message, self._connections[topic].msgtype)
        self.write(topic, stamp, bytes(cdr))

    def flush(self) -> None:
        """Pass all messages to the operating system; call this regularly, because messages may stop arriving.

        rosbags has no such method; it keeps up to a mebibyte in memory.
        """
        storage: Any = self._writer.storage
        if storage.chunk.msgs:
            storage.close_chunk()
        storage.bio.flush()
        self._flushed_at, self._first_unflushed = time.monotonic(), None

    def close(self) -> None:
        """Complete the bag. A second call does nothing."""
        if self._writer.storage is None:
            return
        storage: Any = self._writer.storage
        self._writer.close()
        descriptor = os.open(storage.path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a bag: its message type, and its serialised messages in the order of their log times in ns."""

    message_type: str
    stamps: list[int] = field(default_factory=list)
    messages: list[bytes] = field(default_factory=list)


@dataclass(frozen=True)
class Bag:
    """Content of a bag.

    Attributes
    ----------
    topics : mapping of str to RecordedTopic
        All topics of the bag, without messages where only other topics were read.
    types : Typestore
        Message types as the bag defines them.
    file : Path
        Storage file.
    recovered : bool
        Whether the bag had not been closed.
    """

    topics: Mapping[str, RecordedTopic]
    types: Typestore
    file: Path
    recovered: bool = False

    def decode(self, topic: str) -> list[Any]:
        """Return the messages of a topic as objects."""
        entry = self.topics[topic]
        return [self.types.deserialize_cdr(message, entry.message_type) for message in entry.messages]


def read_bag(path: str | Path, topics: Collection[str] | None = None) -> Bag:
    """Read a bag folder, an ``.mcap`` or a ``.db3`` file.

    An MCAP file whose writer was killed is read up to its end.

    Parameters
    ----------
    path : path
        Folder or file.
    topics : collection of str, optional
        Last parts of the names of the topics to read (``samples`` selects ``/bench/samples``); all topics by default.

    Raises
    ------
    InputError
        When there is nothing to read, or it is damaged or not a bag.
    """
    path = Path(path)
    file = _storage_file(path)
    # rosbags and mcap raise many kinds of errors for damaged bytes (struct, index, decompression, SQLite, YAML).
    try:
        return _read_closed(path, file, topics)
    except Exception as error:
        problem = error
    if file.suffix == ".mcap" and not _has_end(file):
        if (file.parent / "metadata.yaml").exists():
            raise InputError(
                f"{file}: was closed and has lost its end since (metadata.yaml describes a complete bag); "
                "take another copy, or move the file away from its metadata.yaml to read what is left"
            )
        with suppress(Exception):
            return _recover(file, topics)
    raise InputError(f"{path}: cannot be read as a bag ({_one_line(problem)}); expected a rosbag2 recording")


def _read_closed(path: Path, file: Path, topics: Collection[str] | None) -> Bag:
    with Reader(path if path.is_dir() and (path / "metadata.yaml").exists() else file) as reader:
        entries = {connection.topic: RecordedTopic(connection.msgtype) for connection in reader.connections}
        wanted = [connection for connection in reader.connections if _selected(connection.topic, topics)]
        if wanted:
            for connection, stamp, data in reader.messages(wanted):
                entries[connection.topic].stamps.append(stamp)
                entries[connection.topic].messages.append(bytes(data))
        definitions = [(c.msgtype, c.msgdef.format, c.msgdef.data) for c in reader.connections]
    return Bag(entries, _types(definitions), file)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _selected(topic: str, topics: Collection[str] | None) -> bool:
    return topics is None or topic.rsplit("/", 1)[-1] in topics


def _storage_file(path: Path) -> Path:
    if path.is_dir():
        files = sorted([*path.glob("*.mcap"), *path.glob("*.db3")])
        if not files:
            if (path / "metadata.yaml").exists():
                raise InputError(f"{path}: the bag's storage file is missing; expected it next to metadata.yaml")
            raise InputError(f"{path}: is a folder without an .mcap or .db3 file; expected a bag")
        if len(files) > 1 and not (path / "metadata.yaml").exists():
            names = ", ".join(file.name for file in files[:5]) + (", ..." if len(files) > 5 else "")
            raise InputError(f"{path}: holds {len(files)} storage files and no metadata.yaml; give one of them ({names})")
        path = files[0]
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: is empty; expected a bag")
    return path


_MAGIC = b"\x89MCAP0\r\n"


def _has_end(file: Path) -> bool:
    """Whether an MCAP file has its end; also True for a file of another kind."""
    with file.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            return True
        stream.seek(-len(_MAGIC), os.SEEK_END)
        return stream.read() == _MAGIC and stream.tell() > len(_MAGIC)


def _recover(file: Path, topics: Collection[str] | None) -> Bag:
    """Read an MCAP file that has no end."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    entries: dict[str, RecordedTopic] = {}
    # At the end of the file, the reader fails on half a record or half a compressed chunk.
    with suppress(Exception), file.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                entries.setdefault(record.topic, RecordedTopic(schemas[record.schema_id].name))
            elif isinstance(record, Message):
                topic = channels[record.channel_id].topic
                if _selected(topic, topics):
                    entries[topic].stamps.append(record.log_time)
                    entries[topic].messages.append(record.data)
    formats = {"ros2msg": Format.MSG, "ros2idl": Format.IDL}
    definitions = [
        (schema.name, formats.get(schema.encoding, Format.NONE), schema.data.decode()) for schema in schemas.values()
    ]
    return Bag(entries, _types(definitions), file, recovered=True)


def _types(definitions: Iterable[tuple[str, Format, str]]) -> Typestore:
    """Return the types as the bag defines them, or as the bench does where an old bag has no definition of one."""
    store = empty_typestore()
    for name, kind, text in definitions:
        if name in store.fielddefs:
            continue
        if kind == Format.NONE:
            return typestore()
        parsed = get_types_from_msg(text, name) if kind == Format.MSG else get_types_from_idl(text)
        store.register({key: value for key, value in parsed.items() if key not in store.fielddefs})
    return store
