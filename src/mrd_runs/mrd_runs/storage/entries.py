"""What a storage file of a bag holds, whatever its format."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple, TypeAlias

# Largest size in bytes of a message, and of a chunk of messages when decompressed; rosbags and rosbag2 write chunks of
# 1 MiB, and images have a few MiB.
LARGEST_RECORD = 2**26


class Schema(NamedTuple):
    """Definition of a message type: its encoding (``ros2msg``, ``ros2idl`` or none) and its text."""

    number: int
    name: str
    encoding: str
    text: str


class Channel(NamedTuple):
    """A topic: number of its schema, encoding of its messages (``cdr``), and metadata (``offered_qos_profiles``)."""

    number: int
    schema: int
    topic: str
    encoding: str
    metadata: Mapping[str, str]


class Message(NamedTuple):
    """A message: number of its channel, log time in ns, serialised content."""

    channel: int
    stamp: int
    data: bytes


class Gap(NamedTuple):
    """Bytes of a file that cannot be read: where, how many (0 where that is not known), and why (``is cut off``)."""

    offset: int
    length: int
    reason: str


class End(NamedTuple):
    """The end of a file that was closed."""


Entry: TypeAlias = Schema | Channel | Message | Gap | End
Entries: TypeAlias = Iterator[Entry]
