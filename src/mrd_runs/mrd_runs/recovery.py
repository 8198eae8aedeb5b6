"""Recovery: a bag that was not closed, was cut or is damaged becomes a new one that every reader of bags takes.

The new bag stands beside the damaged one, which is neither changed nor renamed: another process may still have it open, its
disk may be failing, and a second attempt with better means must remain possible.
"""

import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from mrd_base import InputError
from mrd_runs.bag import BagWriter, parse_definition, qos, read_bag
from mrd_runs.blocks import decode_blocks
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.storage import (
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

# How a message begins that was compressed by itself. No message in CDR begins so.
_COMPRESSED = b"\x28\xb5\x2f\xfd"
_GAPS_LISTED = 5
# Stamps that fit the readers, which count in signed 64-bit integers.
_END_OF_STAMPS = 2**63


@dataclass(frozen=True)
class Recovery:
    """What was recovered of a bag.

    Attributes
    ----------
    path : Path
        The new bag.
    counts : mapping of str to int
        Number of messages of each topic.
    losses : tuple of str
        What was lost, in one line each; empty when everything was read.
    """

    path: Path
    counts: Mapping[str, int]
    losses: tuple[str, ...]


def recovered_path(path: Path, folder: Path | None = None) -> Path:
    """Return the path of the new bag: beside the damaged one, or in a folder."""
    stem = path.stem if path.suffix in SUFFIXES else path.resolve().name
    return (folder or path.resolve().parent) / f"{stem}_recovered"


def recover_bag(path: Path, output: Path) -> Recovery:
    """Write everything that can be read of a bag into a new one.

    Parameters
    ----------
    path : Path
        Bag folder, ``.mcap`` or ``.db3`` file, in any state.
    output : Path
        Folder of the new bag; it must not exist.

    Raises
    ------
    InputError
        When there is nothing to read, no message can be recovered, or the new bag cannot be written. It is not left then.
    """
    losses: list[str] = []
    files, metadata = _find_files(path, losses)
    writer = BagWriter(output)
    try:
        with writer:
            for file in files:
                _FileRecovery(file, writer, losses).run()
            counts = {topic: count for topic, count in writer.counts.items() if count}
            recovered = sum(counts.values())
            if not recovered:
                reasons = one_line("; ".join(losses) or "it has none")
                raise InputError(f"{path}: holds no message that can be recovered ({reasons})")
            if metadata is not None and metadata.message_count > recovered:
                losses.append(f"{metadata.message_count - recovered} of {metadata.message_count} messages, by metadata.yaml")
            losses += _missing_samples(path, output, writer)
            if losses:
                writer.mark_as_recovered(path.name)
    except BaseException:
        shutil.rmtree(output, ignore_errors=True)
        raise
    return Recovery(output, counts, tuple(losses))


def _find_files(path: Path, losses: list[str]) -> tuple[list[Path], Metadata | None]:
    """Return the storage files that are there, in the order of their numbers, and the metadata if they can be read."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not path.is_dir():
        if path.suffix not in SUFFIXES or not path.is_file():
            raise InputError(f"{path}: is not an .mcap or .db3 file; expected a bag")
        return [path], None
    metadata = None
    try:
        metadata = read_metadata(path)
    except InputError:
        losses.append("metadata.yaml cannot be read")
    files = sorted((file for suffix in SUFFIXES for file in path.glob(f"*{suffix}")), key=_numbers_as_numbers)
    if not files:
        raise InputError(f"{path}: is a folder without an .mcap or .db3 file; expected a bag")
    missing = set(metadata.files) - {file.name for file in files} if metadata else set()
    losses += [f"the file {one_line(name)} is missing" for name in sorted(missing)]
    return files, metadata


def _numbers_as_numbers(file: Path) -> list[str]:
    return [part.zfill(20) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]


class _FileRecovery:
    """Copies the messages of one storage file. It is read twice: what defines a topic may stand behind its messages."""

    def __init__(self, file: Path, writer: BagWriter, losses: list[str]) -> None:
        self._file, self._writer, self._losses = file, writer, losses
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._topics: dict[int, str] = {}

    def run(self) -> None:
        if self._file.stat().st_size == 0:
            self._lose("is empty")
            return
        try:
            closed = self._find_topics()
        except InputError as error:
            self._losses.append(one_line(error))
            return
        self._add_topics()
        self._copy_messages()
        if not closed:
            self._lose("was not closed; what had not reached it is lost")

    def _lose(self, what: str) -> None:
        self._losses.append(f"{self._file.name} {what}")

    def _find_topics(self) -> bool:
        """Collect the definitions, and report the gaps; return whether the file was closed."""
        closed = False
        gaps: list[Gap] = []
        for entry in read_storage(self._file):
            if isinstance(entry, Schema):
                self._schemas.setdefault(entry.number, entry)
            elif isinstance(entry, Channel):
                self._channels.setdefault(entry.number, entry)
            elif isinstance(entry, Gap):
                gaps.append(entry)
            elif isinstance(entry, End):
                closed = True
        for gap in gaps[:_GAPS_LISTED]:
            self._lose(f"{gap.reason}: {gap.length} bytes at byte {gap.offset}" if gap.length else gap.reason)
        if len(gaps) > _GAPS_LISTED:
            rest = sum(gap.length for gap in gaps[_GAPS_LISTED:])
            self._lose(f"is damaged in {len(gaps) - _GAPS_LISTED} more places: {rest} bytes")
        return closed

    def _add_topics(self) -> None:
        """Add the topics to the new bag, with their definitions."""
        for number, channel in self._channels.items():
            if channel.topic in self._writer.counts:  # of an earlier file, or announced twice
                self._topics[number] = channel.topic
                continue
            schema = self._schemas.get(channel.schema)
            described = _describe_type(schema) if schema is not None and channel.encoding == "cdr" else None
            if schema is None or described is None:
                self._lose(f"does not say how to read the topic {one_line(channel.topic)}")
                continue
            profiles = _profiles(channel.metadata.get("offered_qos_profiles", ""))
            self._writer.add_defined_topic(channel.topic, schema.name, *described, profiles)
            self._topics[number] = channel.topic

    def _copy_messages(self) -> None:
        lost = 0
        for entry in read_storage(self._file):
            if not isinstance(entry, Message):
                continue
            topic = self._topics.get(entry.channel)
            try:
                data = decompress_message(entry.data) if entry.data.startswith(_COMPRESSED) else entry.data
                if topic is None or not 0 <= entry.stamp < _END_OF_STAMPS:
                    raise ValueError
            except ValueError:
                lost += 1
                continue
            self._writer.write(topic, entry.stamp, data)
        if lost:
            self._lose(f"has {lost} messages without a topic, or with an impossible stamp or compression")


def _describe_type(schema: Schema) -> tuple[str, str] | None:
    """Return the definition of a message type and its hash, as the bag or else as the bench knows them; None without."""
    try:
        types = get_typestore(Stores.EMPTY)
        types.register(parse_definition(schema))
        definition, _ = types.generate_msgdef(schema.name, ros_version=2)
        return (schema.text if schema.encoding == "ros2msg" else definition), types.hash_rihs01(schema.name)
    except Exception:  # rosbags raises many kinds
        types = typestore()
        if schema.name not in types.fielddefs:
            return None
        definition, _ = types.generate_msgdef(schema.name, ros_version=2)
        return definition, types.hash_rihs01(schema.name)


def _profiles(text: str) -> list[Qos]:
    # The profiles are YAML in MCAP and SQLite files of all versions; those of a stranger may be anything.
    try:
        return list(parse_qos(text))
    except Exception:
        return [qos(10)]


def _missing_samples(path: Path, output: Path, writer: BagWriter) -> list[str]:
    """Return whether samples are missing by their sequence numbers."""
    writer.flush()
    bag = read_bag(output, {"samples"})
    losses = []
    for name, topic in bag.topics.items():
        if topic.message_type == SAMPLES_TYPE and topic.messages:
            try:
                blocks = decode_blocks(topic.messages, bag.types)
            except Exception as error:  # rosbags raises many kinds
                losses.append(f"messages of {name} cannot be decoded ({one_line(error)})")
                continue
            if blocks.lost:
                losses.append(f"{blocks.lost} samples of {name}, by their sequence numbers")
    return losses
