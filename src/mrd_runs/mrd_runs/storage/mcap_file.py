"""MCAP files, read record by record within bounds: also files not closed, cut, or damaged in places.

The libraries trust the sizes that a file states, so that a kilobyte can fill the memory; and they read a file by the index
at its end, or only up to the first error.
"""

import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

from mrd_base import InputError
from mrd_runs.storage.entries import LARGEST_RECORD, Channel, End, Entries, Entry, Gap, Message, Schema
from mrd_runs.text import one_line

_MAGIC = b"\x89MCAP0\r\n"
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER = 0x03, 0x04, 0x05, 0x06, 0x02

_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, decompressed size, checksum, length of the compression's name
_LARGEST_OPCODE, _FIRST_PRIVATE_OPCODE = 0x0F, 0x80
_WANTED = {_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _FOOTER}
# Where records may begin again after damage: a chunk shorter than 2**40 bytes, or the end of the data section.
_RESUMPTION = re.compile(rb"\x06(?s:.{5})\0\0\0|\x0f\x04\0{7}(?s:.{4})[\x03\x02]")
_WINDOW = 2**20  # bytes read at once in the search for it
_PIECE = 2**20  # bytes decompressed at once
# Largest size in bytes of all chunks when decompressed: a constant, and a multiple of the size of the file.
_LARGEST_CONTENT = 2**28, 50
_MOST_GAPS = 1000


class _Record(NamedTuple):
    opcode: int
    content: bytes


class _DamagedError(Exception):
    """Why a record can be read only in part, or not at all."""


def read_mcap(path: Path) -> Entries:
    """Yield the content of a file: schemas, channels, messages and gaps in their order; `End` if the file was closed.

    A chunk that is cut off yields the records before the cut. A whole chunk that cannot be decompressed or fails its check
    yields nothing: none of its content can be trusted. After a gap, records begin again at the next chunk.

    Raises
    ------
    InputError
        When the file does not begin as an MCAP file, or holds more than any recording does.
    """
    with path.open("rb") as stream:
        size = os.fstat(stream.fileno()).st_size
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise InputError(
                f"{path}: cannot be read as a bag (it does not begin as an MCAP file); expected a rosbag2 recording"
            )
        position, gaps, content = len(_MAGIC), 0, 0
        most_content = _LARGEST_CONTENT[0] + _LARGEST_CONTENT[1] * size
        while position < size:
            stream.seek(position)
            head = stream.read(_HEAD.size)
            end = position + _HEAD.size + (_HEAD.unpack(head)[1] if len(head) == _HEAD.size else 0)
            try:
                content += _decompressed_size(stream, head)
                if content > most_content:
                    raise InputError(f"{path}: holds more than {most_content} bytes when decompressed; expected a recording")
                for record in _read_record(stream, head, size - position):
                    yield _PARSERS[record.opcode](record.content)
                if head[0] == _FOOTER:
                    yield End()
                    end += len(_MAGIC)
                    if end < size:
                        yield Gap(end, size - end, "goes on after its end")
                    return
            except _DamagedError as error:
                gaps += 1
                if gaps == _MOST_GAPS:
                    end = size
                elif not _chunk_begins(stream, position, size):  # then its length may be wrong too
                    end = _find_resumption(stream, position + 1, size)
                yield Gap(position, end - position, str(error))
            position = end


def _read_record(stream: BinaryIO, head: bytes, remaining: int) -> Iterator[_Record]:
    """Yield the record whose head has just been read, or the records in a chunk; ``remaining`` bytes begin at its head."""
    if len(head) < _HEAD.size:
        raise _DamagedError("is cut off in the head of a record")
    opcode, length = _HEAD.unpack(head)
    if opcode == 0 or _LARGEST_OPCODE < opcode < _FIRST_PRIVATE_OPCODE:
        raise _DamagedError(f"holds no record (opcode {opcode})")
    is_cut = length > remaining - _HEAD.size
    if is_cut and opcode != _CHUNK:
        raise _DamagedError("is cut off in a record" if opcode in _WANTED else "holds a record that is longer than the file")
    if opcode not in _WANTED:
        return
    if length > LARGEST_RECORD and not is_cut:
        raise _DamagedError(f"holds a record of {length} bytes, expected at most {LARGEST_RECORD}")
    content = stream.read(min(length, remaining, LARGEST_RECORD))
    if opcode == _CHUNK:
        yield from _read_chunk(content, is_cut)
        return
    _check_length(opcode, length)
    if opcode != _FOOTER:
        yield _Record(opcode, content)
    elif stream.read(len(_MAGIC)) != _MAGIC:
        raise _DamagedError("is cut off in its last bytes")


def _decompressed_size(stream: BinaryIO, head: bytes) -> int:
    """Return the size that the chunk at the stream's position states, at most `LARGEST_RECORD`; 0 for another record."""
    if head[0] != _CHUNK:
        return 0
    position = stream.tell()
    start = stream.read(_CHUNK_HEAD.size)
    stream.seek(position)
    return min(_CHUNK_HEAD.unpack(start)[2], LARGEST_RECORD) if len(start) == _CHUNK_HEAD.size else 0


def _check_length(opcode: int, length: int) -> None:
    if opcode == _MESSAGE and length < _MESSAGE_HEAD.size:
        raise _DamagedError(f"holds a message of {length} bytes")


def _read_chunk(content: bytes, is_cut: bool) -> Iterator[_Record]:
    """Yield the records in a chunk; of one that is cut off, those before the cut."""
    cut = "is cut off in a chunk"
    if len(content) < _CHUNK_HEAD.size:
        raise _DamagedError(cut)
    _, _, size, checksum, name_length = _CHUNK_HEAD.unpack_from(content)
    start = _CHUNK_HEAD.size + name_length + 8
    if name_length > 16:
        raise _DamagedError(f"holds a chunk whose compression has a name of {name_length} bytes")
    if size > LARGEST_RECORD:
        raise _DamagedError(f"holds a chunk of {size} bytes when decompressed, expected at most {LARGEST_RECORD}")
    if len(content) < start:
        raise _DamagedError(cut)
    if not is_cut and int.from_bytes(content[start - 8 : start], "little") != len(content) - start:
        raise _DamagedError("holds a chunk that states two sizes")
    compression = content[_CHUNK_HEAD.size : start - 8]
    data = b"".join(_decompress(compression, content[start:], size, is_cut))
    if not is_cut and len(data) != size:
        raise _DamagedError(f"holds a chunk of {len(data)} bytes that states {size}")
    if not is_cut and checksum and zlib.crc32(data) != checksum:
        raise _DamagedError("holds a chunk that fails its checksum")
    position = 0
    while position + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        end = position + _HEAD.size + length
        if end > len(data):
            break
        if opcode in (_SCHEMA, _CHANNEL, _MESSAGE):
            _check_length(opcode, length)
            yield _Record(opcode, data[position + _HEAD.size : end])
        position = end
    if is_cut:
        raise _DamagedError(cut)
    if position != len(data):
        raise _DamagedError("holds a chunk with a record that is longer than the chunk")


def decompress_message(data: bytes) -> bytes:
    """Decompress a message of a bag whose messages are compressed one by one (zstd); raise ValueError where it cannot be."""
    try:
        content = b"".join(_decompress(b"zstd", data, LARGEST_RECORD, False))
    except _DamagedError as error:
        raise ValueError(f"a message {error}") from None
    if len(content) > LARGEST_RECORD:
        raise ValueError(f"a message of more than {LARGEST_RECORD} bytes")
    return content


def _decompress(compression: bytes, data: bytes, size: int, is_cut: bool) -> Iterator[bytes]:
    """Yield the content of a chunk in pieces, of at most one piece more than ``size`` bytes."""
    if compression == b"":
        yield data
        return
    try:
        if compression == b"zstd":
            reader = zstandard.ZstdDecompressor().stream_reader(data)
            count = 0
            while count <= size and (piece := reader.read(_PIECE)):
                count += len(piece)
                yield piece
        elif compression == b"lz4":
            decompressor = LZ4FrameDecompressor()
            yield decompressor.decompress(data, max_length=size + 1)
            if not is_cut and not decompressor.eof:
                raise _DamagedError("holds a chunk that cannot be decompressed (its compressed content ends early)")
        else:
            name = one_line(compression.decode(errors="replace"))
            raise _DamagedError(f"holds a chunk in the unknown compression {name}, expected zstd, lz4 or none")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        if not is_cut:
            raise _DamagedError(f"holds a chunk that cannot be decompressed ({one_line(error)})") from None


def _chunk_begins(stream: BinaryIO, position: int, size: int) -> bool:
    """Whether the head of a chunk that fits the file stands at a position: two of its sizes state the same."""
    stream.seek(position)
    head = stream.read(_HEAD.size + _CHUNK_HEAD.size + 16 + 8)
    if len(head) < _HEAD.size + _CHUNK_HEAD.size + 8:
        return False
    opcode, length = _HEAD.unpack_from(head)
    *_, name_length = _CHUNK_HEAD.unpack_from(head, _HEAD.size)
    at = _HEAD.size + _CHUNK_HEAD.size + name_length
    if opcode != _CHUNK or name_length > 16 or at + 8 > len(head) or position + _HEAD.size + length > size:
        return False
    return bool(int.from_bytes(head[at : at + 8], "little") == length - _CHUNK_HEAD.size - name_length - 8)


def _find_resumption(stream: BinaryIO, begin: int, size: int) -> int:
    """Return the first position at or after ``begin`` where records begin again; the size of the file without one."""
    while begin < size:
        stream.seek(begin)
        window = stream.read(_WINDOW)
        for match in _RESUMPTION.finditer(window):
            position = begin + match.start()
            if window[match.start()] != _CHUNK or _chunk_begins(stream, position, size):
                return position
        begin += max(len(window) - 64, 1) if len(window) == _WINDOW else len(window) or size
    return size


def _parse_schema(content: bytes) -> Schema:
    (number,), rest = _unpack("<H", content)
    name, rest = _split_text(rest)
    encoding, rest = _split_text(rest)
    text, _ = _split_text(rest)
    return Schema(number, name, encoding, text)


def _parse_channel(content: bytes) -> Channel:
    (number, schema), rest = _unpack("<HH", content)
    topic, rest = _split_text(rest)
    encoding, rest = _split_text(rest)
    (length,), rest = _unpack("<I", rest)
    entries, metadata = rest[:length], {}
    while entries:
        key, entries = _split_text(entries)
        metadata[key], entries = _split_text(entries)
    return Channel(number, schema, topic, encoding, metadata)


def _parse_message(content: bytes) -> Message:
    channel, _, stamp, _ = _MESSAGE_HEAD.unpack_from(content)
    return Message(channel, stamp, content[_MESSAGE_HEAD.size :])


_PARSERS: Mapping[int, Callable[[bytes], Entry]] = {
    _SCHEMA: _parse_schema,
    _CHANNEL: _parse_channel,
    _MESSAGE: _parse_message,
}


def _unpack(layout: str, content: bytes) -> tuple[tuple[int, ...], bytes]:
    size = struct.calcsize(layout)
    if len(content) < size:
        raise _DamagedError("holds a record that is too short")
    return struct.unpack(layout, content[:size]), content[size:]


def _split_text(content: bytes) -> tuple[str, bytes]:
    """Return the text at the beginning of a content, and the rest."""
    (length,), rest = _unpack("<I", content)
    if length > len(rest):
        raise _DamagedError("holds a text that is longer than its record")
    try:
        return rest[:length].decode(), rest[length:]
    except UnicodeDecodeError:
        raise _DamagedError("holds a text that is not UTF-8") from None
