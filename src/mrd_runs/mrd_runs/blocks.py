"""Blocks of samples as they stand serialised in a bag, decoded many at a time.

Ten minutes at 1 kHz are 30 000 blocks. Decoding them one by one takes as long as everything else in reading a run; blocks of
one length have one layout, so numpy takes them as a table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from mrd_runs.definitions import SAMPLES_TYPE

Array = NDArray[np.float64]
SERIES = ("position", "force", "coil_current", "acceleration")
_LITTLE_ENDIAN = b"\x00\x01"

# The fields that `_decode_table` knows, as rosbags writes them; a bag with others is decoded by rosbags.
_SERIES_TYPE = (Nodetype.SEQUENCE, ((Nodetype.BASE, ("float64", 0)), 0))
LAYOUT = [
    ("header", (Nodetype.NAME, "std_msgs/msg/Header")),
    ("sample_period", (Nodetype.BASE, ("float64", 0))),
    ("sequence", (Nodetype.BASE, ("uint64", 0))),
    *((name, _SERIES_TYPE) for name in SERIES),
]


@dataclass(frozen=True)
class Blocks:
    """Blocks (m,) and their samples (n,), in the order given.

    Attributes
    ----------
    stamp : ndarray (m,) of int64
        ns, of the first sample.
    period : ndarray (m,)
        s.
    sequence : ndarray (m,) of int64
        Number of the first sample.
    count : ndarray (m,) of int64
        Samples in the block.
    series : dict of str to ndarray (n,)
        Samples of all blocks, by field of the message.
    """

    stamp: NDArray[np.int64]
    period: Array
    sequence: NDArray[np.int64]
    count: NDArray[np.int64]
    series: dict[str, Array]


def decode_blocks(messages: Sequence[bytes], types: Typestore) -> Blocks:
    """Decode serialised BenchSamples.

    Parameters
    ----------
    messages : sequence of bytes
        CDR, as in the bag.
    types : Typestore
        The types as the bag defines them.

    Raises
    ------
    ValueError, struct.error or another error of rosbags
        For damaged bytes, or series of unequal lengths in a block.
    """
    usual = types.fielddefs[SAMPLES_TYPE][1] == LAYOUT
    parts = []
    for _, group in groupby(messages, key=len):
        same_length = list(group)
        part = _decode_table(same_length) if usual else None
        parts.append(part or _decode_singly(same_length, types))
    return _join(parts)


def _decode_table(messages: list[bytes]) -> Blocks | None:
    """Decode messages of one length as a table; None when they have not one layout."""
    first = messages[0]
    if len(first) < 44 or first[:2] != _LITTLE_ENDIAN:
        return None
    # After four bytes of encapsulation numbers are aligned to their size; the frame's name is padded.
    frame = int.from_bytes(first[12:16], "little")
    after_frame = 4 + -(-(12 + frame) // 8) * 8
    if after_frame + 20 > len(first):
        return None
    count = int.from_bytes(first[after_frame + 16 : after_frame + 20], "little")
    fields: Any = {
        "names": ["sec", "nanosec", "frame", "period", "sequence"],
        "formats": ["<i4", "<u4", "<u4", "<f8", "<u8"],
        "offsets": [4, 8, 12, after_frame, after_frame + 8],
        "itemsize": len(first),
    }
    offset = after_frame + 16
    for name in SERIES:
        fields["names"] += [f"n_{name}", name]
        fields["formats"] += ["<u4", ("<f8", (count,))]
        start = 4 + -(-(offset) // 8) * 8 if count else offset + 4
        fields["offsets"] += [offset, start]
        offset = start + 8 * count
    if offset != len(first):
        return None
    table: Any = np.frombuffer(b"".join(messages), np.dtype(fields))
    if (table["frame"] != frame).any() or any((table[f"n_{name}"] != count).any() for name in SERIES):
        return None
    return Blocks(
        table["sec"].astype(np.int64) * 10**9 + table["nanosec"],
        table["period"].copy(),
        table["sequence"].astype(np.int64),
        np.full(len(messages), count, np.int64),
        {name: table[name].reshape(-1) for name in SERIES},
    )


def _decode_singly(messages: list[bytes], types: Typestore) -> Blocks:
    decoded: list[Any] = [types.deserialize_cdr(message, SAMPLES_TYPE) for message in messages]
    for block in decoded:
        lengths = {name: len(getattr(block, name)) for name in SERIES}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"a block has series of unequal lengths {lengths}")
    return Blocks(
        np.array([block.header.stamp.sec * 10**9 + block.header.stamp.nanosec for block in decoded], np.int64),
        np.array([block.sample_period for block in decoded], np.float64),
        np.array([block.sequence for block in decoded], np.uint64).astype(np.int64),
        np.array([len(block.position) for block in decoded], np.int64),
        {name: np.concatenate([getattr(block, name) for block in decoded]) for name in SERIES},
    )


def _join(parts: list[Blocks]) -> Blocks:
    empty = np.empty(0, np.int64)
    return Blocks(
        np.concatenate([empty, *(part.stamp for part in parts)]),
        np.concatenate([np.empty(0), *(part.period for part in parts)]),
        np.concatenate([empty, *(part.sequence for part in parts)]),
        np.concatenate([empty, *(part.count for part in parts)]),
        {name: np.concatenate([np.empty(0), *(part.series[name] for part in parts)]) for name in SERIES},
    )
