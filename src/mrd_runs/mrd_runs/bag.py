"""Bags: writing them so that a killed process or a power cut loses little, and reading them in any state.

A bag is an ordinary rosbag2 folder (MCAP, version 9), which ``ros2 bag info`` and ``ros2 bag play`` understand. Every
message reaches the operating system within `FLUSH_PERIOD`, so that a killed process loses no more than that; and the disk
within another `SYNC_PERIOD`, so that a power cut loses less than a second.
"""

import itertools
import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import zstandard
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.interfaces.typing import Typesdict
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import get_types_from_idl, get_types_from_msg
from rosbags.typesys.store import Typestore

from mrd_base import InputError
from mrd_base.tool import command
from mrd_runs.definitions import definition, empty_typestore, typestore
from mrd_runs.storage import (
    RECOVERED_FROM,
    SUFFIXES,
    Channel,
    End,
    Gap,
    Message,
    Metadata,
    Schema,
    decompress_message,
    read_metadata,
    read_storage,
)
from mrd_runs.text import one_line

# Longest time in s that a message waits before it goes to the operating system, by the wall clock and by the stamps.
FLUSH_PERIOD = 0.25
# Time in s between two requests to the operating system to put what it has onto the disk, by the wall clock.
SYNC_PERIOD = 0.5
# Largest size in bytes of the messages that are read of a bag: more than ten hours of samples at 1 kHz.
LARGEST_BAG = 2**31

_OVERHEAD = 100  # bytes that a message takes in memory beside its content
_LONGEST_DEFINITION = 2**16  # characters
_PARSERS: Mapping[str, Callable[[str, str], Typesdict]] = {
    "ros2msg": get_types_from_msg,
    "ros2idl": lambda text, _name: get_types_from_idl(text),
}

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

    When the disk is full or fails, the bag ends after the last messages that were passed to the operating system.

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
        When the folder exists or cannot be made. All methods raise it when the bag cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            exists = self.path.exists()
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror})") from None
        if exists:
            raise InputError(f"{path}: exists already and is not overwritten; give another folder or remove it")
        self.types = typestore()
        try:
            self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            # Compression halves the file and makes reading faster; writing takes a tenth longer (benchmarks/read_bag.py).
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except OSError as error:
            raise InputError(f"{path}: cannot be made ({error.strerror}; {free_space(self.path)})") from None
        except WriterError as error:  # somebody has made it in this instant
            raise InputError(f"{path}: cannot be made ({error})") from None
        storage: Any = self._writer.storage
        self._storage = storage
        # rosbags writes no checksums; this one is a part of the compressed content.
        self._storage.compressor = zstandard.ZstdCompressor(write_checksum=True).compress
        self._connections: dict[str, Connection] = {}
        self._flushed_at = time.monotonic()
        self._flushed_size = 0
        self._first_unflushed: int | None = None
        self.counts: dict[str, int] = {}
        self._synchroniser = _Synchroniser(self._storage.bio.fileno())
        self.flush()
        with self._writing():
            _synchronise(self.path)
            _synchronise(self.path.parent)

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn an error of the disk into an InputError, after which nothing is written any more."""
        try:
            yield
        except OSError as error:
            self._abandon()
            problem = error.strerror or str(error)
            raise InputError(
                f"{self.path}: cannot be written ({problem}; {free_space(self.path)}); the messages before are kept"
            ) from None

    def _abandon(self) -> None:
        """Leave the file as it was after the last flush that succeeded."""
        self._synchroniser.end()
        self._storage.bio.raw.close()  # the buffer would try again to write what it holds
        self._writer.storage = None
        with suppress(OSError):
            if self._flushed_size:
                os.truncate(self._storage.path, self._flushed_size)

    def add_topic(self, topic: str, message_type: str, *, depth: int = 1, latched: bool = False) -> None:
        """Add a topic; after that, its messages can be written."""
        text = definition(self.types, message_type)
        self.add_defined_topic(topic, message_type, text, self.types.hash_rihs01(message_type), [qos(depth, latched)])

    def add_defined_topic(
        self, topic: str, message_type: str, definition: str, digest: str, profiles: Sequence[Qos]
    ) -> None:
        """Add a topic with its definition, the hash of its type and its qualities of service."""
        self._connections[topic] = self._writer.add_connection(
            topic, message_type, msgdef=definition, rihs01=digest, offered_qos_profiles=profiles
        )
        self.counts[topic] = 0

    def write(self, topic: str, stamp: int, cdr: bytes) -> None:
        """Write a serialised message; ``stamp`` in ns."""
        with self._writing():
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

    def mark_as_recovered(self, name: str) -> None:
        """Say in the metadata that the bag was recovered from another one, of which something was lost."""
        self._writer.set_custom_data(RECOVERED_FROM, name)

    def flush(self) -> None:
        """Pass all messages to the operating system; call this regularly, because messages may stop arriving.

        rosbags has no such method; it keeps up to a mebibyte in memory.
        """
        with self._writing():
            if self._storage.chunk.msgs:
                self._storage.close_chunk()
            self._storage.bio.flush()
            self._flushed_size = self._storage.bio.tell()
            self._synchroniser.request()
        self._flushed_at, self._first_unflushed = time.monotonic(), None

    def close(self) -> None:
        """Complete the bag and put it onto the disk. A second call does nothing."""
        if self._writer.storage is None:
            return
        self.flush()  # what is in the file then stays in it, even if the disk has no room for its end
        with self._writing():
            self._synchroniser.end()
            self._writer.close()
            for path in (self._storage.path, self._writer.metapath, self.path):
                _synchronise(path)


class _Synchroniser:
    """Puts an open file onto the disk every `SYNC_PERIOD`, in a thread of its own: a slow disk must not delay messages."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = os.dup(descriptor)
        self._problem: OSError | None = None
        self._requested, self._ending = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="synchroniser", daemon=True)
        self._thread.start()

    def request(self) -> None:
        """Ask for what the operating system has now; raise OSError if it could not be put onto the disk before."""
        if self._problem is not None:
            raise self._problem
        self._requested.set()

    def end(self) -> None:
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._ending.wait(SYNC_PERIOD):
                if self._requested.is_set():
                    self._requested.clear()
                    os.fsync(self._descriptor)
        except OSError as error:
            self._problem = error
        finally:
            os.close(self._descriptor)


def _synchronise(path: Path) -> None:
    """Put a file or the entries of a folder onto the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def free_space(path: Path) -> str:
    """Return the free space of the disk of a path that may not exist."""
    existing = next(folder for folder in (path, *path.absolute().parents) if folder.is_dir())
    return f"{shutil.disk_usage(existing).free / 1e6:.0f} MB free in {existing}"


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a bag: its message type, and its serialised messages with their log times in ns."""

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
        Message types of the topics that were read, as the bag defines them.
    file : Path
        Storage file; the first one of several.
    recovered : bool
        Whether the bag had not been closed, or was recovered from one that had lost something.
    """

    topics: Mapping[str, RecordedTopic]
    types: Typestore
    file: Path
    recovered: bool = False

    def decode(self, topic: str) -> list[Any]:
        """Return the messages of a topic as objects."""
        entry = self.topics[topic]
        return [self.types.deserialize_cdr(message, entry.message_type) for message in entry.messages]


def read_bag(
    path: str | Path, topics: Collection[str] | None = None, most: int | None = None, *, as_written: bool = False
) -> Bag:
    """Read a bag folder, an ``.mcap`` or a ``.db3`` file.

    An MCAP file whose writer was killed is read up to its end.

    Parameters
    ----------
    path : path
        Folder or file.
    topics : collection of str, optional
        Last parts of the names of the topics to read (``samples`` selects ``/bench/samples``); all topics by default.
    most : int, optional
        Number of messages to keep of each topic, the first ones; all by default.
    as_written : bool
        Whether the messages stay in the order of the file, and are not put into that of their log times.

    Raises
    ------
    InputError
        When there is nothing to read, it is damaged or not a bag, or it holds more than fits into memory.
    """
    path = Path(path)
    files, metadata = find_storage(path)
    content = _Content(topics, metadata is not None and metadata.compresses_messages, most)
    closed = metadata is None or not metadata.recovered
    for file in files:
        closed &= _read_file(file, content, metadata)
    for entry in content.topics.values():
        if not as_written:
            _sort(entry)
    return Bag(content.topics, read_types(content.definitions, path), files[0], not closed)


def find_storage(path: Path) -> tuple[list[Path], Metadata | None]:
    """Return the storage files of a bag in their order, and its metadata.

    Raises
    ------
    InputError
        When there is none, or it is empty.
    """
    metadata = None
    files = [path]
    if not path.is_dir():
        with suppress(InputError):
            metadata = read_metadata(path.parent)
        metadata = metadata if metadata and path.name in metadata.files else None
    else:
        metadata = read_metadata(path)
        present = sorted(file for suffix in SUFFIXES for file in path.glob(f"*{suffix}"))
        files = [path / name for name in metadata.files] if metadata else present
        if metadata and not (files and all(file.exists() for file in files)):
            raise InputError(f"{path}: the bag's storage file is missing; expected it next to metadata.yaml")
        if not files:
            raise InputError(f"{path}: is a folder without an .mcap or .db3 file; expected a bag")
        if len(files) > 1 and not metadata:
            names = ", ".join(file.name for file in files[:5]) + (", ..." if len(files) > 5 else "")
            raise InputError(f"{path}: holds {len(files)} storage files and no metadata.yaml; give one of them ({names})")
    for file in files:
        if not file.exists():
            raise InputError(f"{file}: no such file or folder")
        if not file.is_file() or file.suffix not in SUFFIXES:
            raise InputError(f"{file}: is not an .mcap or .db3 file; expected a bag")
        if file.stat().st_size == 0:
            raise InputError(f"{file}: is empty; expected a bag")
    return files, metadata


class _Content:
    """What has been read of a bag."""

    def __init__(self, wanted: Collection[str] | None, decompresses: bool, most: int | None) -> None:
        self._wanted, self._decompresses, self._most = wanted, decompresses, most
        self.size = 0
        self.topics: dict[str, RecordedTopic] = {}
        self.definitions: dict[str, Schema] = {}

    def add_topic(self, channel: Channel, schema: Schema) -> RecordedTopic | None:
        """Add a topic; return it if its messages are to be read."""
        topic = self.topics.setdefault(channel.topic, RecordedTopic(schema.name))
        if self._wanted is not None and channel.topic.rsplit("/", 1)[-1] not in self._wanted:
            return None
        self.definitions.setdefault(schema.name, schema)
        return topic

    def add_message(self, topic: RecordedTopic, message: Message) -> None:
        """Add a message; raise ValueError where it cannot be decompressed."""
        if len(topic.messages) == self._most:
            return
        data = decompress_message(message.data) if self._decompresses else message.data
        self.size += len(data) + _OVERHEAD
        topic.stamps.append(message.stamp)
        topic.messages.append(data)


def _read_file(file: Path, content: _Content, metadata: Metadata | None) -> bool:
    """Read a storage file and return whether it was closed."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, RecordedTopic | None] = {}
    closed = False
    size = file.stat().st_size
    for entry in read_storage(file):
        try:
            if isinstance(entry, Message):
                topic = topics[entry.channel]
                if topic is not None:
                    content.add_message(topic, entry)
                    if content.size > LARGEST_BAG:
                        raise InputError(f"{file}: holds more than {LARGEST_BAG >> 20} MiB of messages to read; split it")
            elif isinstance(entry, Schema):
                schemas[entry.number] = entry
            elif isinstance(entry, Channel):
                topics[entry.number] = content.add_topic(entry, schemas[entry.schema])
            elif isinstance(entry, Gap) and entry.offset + entry.length < size:
                raise _unreadable(file, f"it {entry.reason}" + (f" at byte {entry.offset}" if entry.length else ""))
            elif isinstance(entry, End):
                closed = True
        except KeyError:
            raise _unreadable(file, "it does not define the topic of a message, or its type") from None
        except ValueError as error:
            raise error if isinstance(error, InputError) else _unreadable(file, str(error)) from None
    if not closed and metadata is not None:
        raise InputError(
            f"{file}: was closed and has lost its end since (metadata.yaml describes a complete bag); "
            f"take another copy, or save what is left with `{command('mrd_runs', 'recover')}`"
        )
    return closed


def _unreadable(file: Path, problem: str) -> InputError:
    recover = command("mrd_runs", "recover")
    return InputError(f"{file}: cannot be read as a bag ({problem}); `{recover}` saves what is left of a damaged one")


def _sort(topic: RecordedTopic) -> None:
    """Put the messages of a topic into the order of their log times."""
    if any(later < earlier for earlier, later in itertools.pairwise(topic.stamps)):
        order = sorted(range(len(topic.stamps)), key=topic.stamps.__getitem__)
        topic.stamps[:] = [topic.stamps[i] for i in order]
        topic.messages[:] = [topic.messages[i] for i in order]


def read_types(definitions: Mapping[str, Schema], path: Path) -> Typestore:
    """Return the types as a bag defines them, or as the bench does where an old bag has no definition of one.

    Raises
    ------
    InputError
        When a definition is none.
    """
    store = empty_typestore()
    if any(schema.encoding not in _PARSERS for schema in definitions.values()):
        store = typestore()
    for name, schema in definitions.items():
        if name in store.fielddefs or schema.encoding not in _PARSERS:
            continue
        try:
            parsed = parse_definition(schema)
            store.register({key: value for key, value in parsed.items() if key not in store.fielddefs})
        except Exception as error:  # rosbags raises many kinds
            raise InputError(f"{path}: the definition of {one_line(name)} cannot be read ({one_line(error)})") from None
    return store


def parse_definition(schema: Schema) -> Typesdict:
    """Parse the definition of a message type; raise one of many kinds of errors for a text that is none."""
    if len(schema.text) > _LONGEST_DEFINITION:
        raise ValueError(f"it has {len(schema.text)} characters, expected at most {_LONGEST_DEFINITION}")
    return _PARSERS[schema.encoding](schema.text, schema.name)
