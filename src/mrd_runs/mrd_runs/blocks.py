"""Blocks of samples (BenchSamples messages): decoding them, and putting their samples on one clock.

Ten minutes at 1 kHz are 30 000 blocks, and decoding them one by one takes as long as the rest of reading a run. Messages of
the same length have the same layout, so that numpy decodes all of them as one table.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from mrd_base import InputError
from mrd_base.quantities import ZERO_CELSIUS
from mrd_runs.definitions import SAMPLES_TYPE

Array = NDArray[np.float64]
SERIES = ("position", "force", "coil_current", "acceleration")
TEMPERATURE = "temperature"
"""Field that the blocks of older bags lack, and that is empty on a bench without a thermometer."""
_LITTLE_ENDIAN = b"\x00\x01"
_PERIODS = (1e-9, 1e6)  # s

# The fields that `decode_as_table` knows, as rosbags describes them. For other fields, rosbags decodes the messages.
_SERIES_TYPE = (Nodetype.SEQUENCE, ((Nodetype.BASE, ("float64", 0)), 0))
LAYOUT = [
    ("header", (Nodetype.NAME, "std_msgs/msg/Header")),
    ("sample_period", (Nodetype.BASE, ("float64", 0))),
    ("sequence", (Nodetype.BASE, ("uint64", 0))),
    *((name, _SERIES_TYPE) for name in (*SERIES, TEMPERATURE)),
]
LAYOUT_WITHOUT_TEMPERATURE = LAYOUT[:-1]


@dataclass(frozen=True)
class Blocks:
    """Decoded blocks (m,) and their samples (n,), in the order of recording.

    Attributes
    ----------
    stamp : ndarray (m,) of int64
        Time of the first sample of each block, in ns.
    period : ndarray (m,)
        Sampling period in s.
    sequence : ndarray (m,) of int64
        Number of the first sample of each block.
    count : ndarray (m,) of int64
        Number of samples in each block.
    series : dict of str to ndarray (n,)
        Samples of all blocks, by field of the message; the temperature is nan where a block has none.
    """

    stamp: NDArray[np.int64]
    period: Array
    sequence: NDArray[np.int64]
    count: NDArray[np.int64]
    series: dict[str, Array]

    @property
    def sequence_jumps(self) -> NDArray[np.int64]:
        """Jumps (m - 1,) of the sample numbers: > 0 where samples are missing, < 0 where the DAQ started to count again."""
        jumps: NDArray[np.int64] = self.sequence[1:] - (self.sequence + self.count)[:-1]
        return jumps

    @property
    def lost(self) -> int:
        """Number of samples that are missing by their sequence numbers."""
        return int(self.sequence_jumps.clip(min=0).sum())

    def starting_at(self, first: int) -> "Blocks":
        """Return the blocks from an index on."""
        skipped = int(self.count[:first].sum())
        return Blocks(
            self.stamp[first:],
            self.period[first:],
            self.sequence[first:],
            self.count[first:],
            {name: values[skipped:] for name, values in self.series.items()},
        )


def decode_blocks(messages: Sequence[bytes], types: Typestore) -> Blocks:
    """Decode serialised BenchSamples messages.

    Parameters
    ----------
    messages : sequence of bytes
        CDR encoding, as in the bag.
    types : Typestore
        Message types as the bag defines them.

    Raises
    ------
    ValueError, struct.error or another error of rosbags
        For damaged bytes, or for series of unequal length in a block.
    """
    layout = types.fielddefs[SAMPLES_TYPE][1]
    known_layout = layout in (LAYOUT, LAYOUT_WITHOUT_TEMPERATURE)
    parts = []
    for _, group in groupby(messages, key=len):
        same_length = list(group)
        part = decode_as_table(same_length, has_temperature=layout == LAYOUT) if known_layout else None
        parts.append(part or decode_with_rosbags(same_length, types))
    return _join(parts)


def decode_as_table(messages: list[bytes], *, has_temperature: bool = True) -> Blocks | None:
    """Decode messages of the same length as a table; return None when their layouts differ.

    ``has_temperature`` tells whether the messages have that field, which may be empty.
    """
    first = messages[0]
    if len(first) < 44 or first[:2] != _LITTLE_ENDIAN:
        return None
    # CDR: after four bytes of encapsulation, every number is aligned to its size, so the name of the frame is padded.
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
    counts = dict.fromkeys(SERIES, count)
    offset = after_frame + 16
    for name in (*SERIES, TEMPERATURE) if has_temperature else SERIES:
        if name == TEMPERATURE:
            counts[name] = int.from_bytes(first[offset : offset + 4], "little")
            if counts[name] not in (0, count):
                return None
        start = 4 + -(-(offset) // 8) * 8 if counts[name] else offset + 4
        fields["names"] += [f"n_{name}", name]
        fields["formats"] += ["<u4", ("<f8", (counts[name],))]
        fields["offsets"] += [offset, start]
        offset = start + 8 * counts[name]
    if offset != len(first):
        return None
    table: Any = np.frombuffer(b"".join(messages), np.dtype(fields))
    if (table["frame"] != frame).any() or any((table[f"n_{name}"] != size).any() for name, size in counts.items()):
        return None
    series = {name: table[name].reshape(-1) for name in SERIES}
    no_temperature = np.full(len(messages) * count, np.nan)
    series[TEMPERATURE] = table[TEMPERATURE].reshape(-1) if counts.get(TEMPERATURE) else no_temperature
    return Blocks(
        table["sec"].astype(np.int64) * 10**9 + table["nanosec"],
        table["period"].copy(),
        table["sequence"].astype(np.int64),
        np.full(len(messages), count, np.int64),
        series,
    )


def decode_with_rosbags(messages: list[bytes], types: Typestore) -> Blocks:
    """Decode messages one by one; slower than `decode_as_table`, for any layout."""
    decoded: list[Any] = [types.deserialize_cdr(message, SAMPLES_TYPE) for message in messages]
    temperatures = []
    for block in decoded:
        lengths = {name: len(getattr(block, name)) for name in SERIES}
        temperature = getattr(block, TEMPERATURE, ())
        temperatures.append(temperature if len(temperature) else np.full(len(block.position), np.nan))
        lengths[TEMPERATURE] = len(temperatures[-1])
        if len(set(lengths.values())) > 1:
            raise ValueError(f"a block has series of unequal lengths: {lengths}")
    return Blocks(
        np.array([block.header.stamp.sec * 10**9 + block.header.stamp.nanosec for block in decoded], np.int64),
        np.array([block.sample_period for block in decoded], np.float64),
        np.array([block.sequence for block in decoded], np.uint64).astype(np.int64),
        np.array([len(block.position) for block in decoded], np.int64),
        {name: np.concatenate([getattr(block, name) for block in decoded]) for name in SERIES}
        | {TEMPERATURE: np.concatenate([np.empty(0), *temperatures])},
    )


def _join(parts: list[Blocks]) -> Blocks:
    empty = np.empty(0, np.int64)
    return Blocks(
        np.concatenate([empty, *(part.stamp for part in parts)]),
        np.concatenate([np.empty(0), *(part.period for part in parts)]),
        np.concatenate([empty, *(part.sequence for part in parts)]),
        np.concatenate([empty, *(part.count for part in parts)]),
        {name: np.concatenate([np.empty(0), *(part.series[name] for part in parts)]) for name in (*SERIES, TEMPERATURE)},
    )


def sample_columns(blocks: Blocks, where: str) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return the samples as columns for `make_run`, with times on the clock of the DAQ.

    Parameters
    ----------
    blocks : Blocks
        In the order of recording.
    where : str
        Prefix of error messages.

    Returns
    -------
    columns : dict of str to ndarray (n,)
    timing : dict
        ``lost`` (number of missing samples), ``jitter_s`` (standard deviation of the stamps about the sample clock),
        ``first_stamp_s``; ``unread_temperatures``, the number of samples without a temperature where others have one: then
        there is no such column.
    """
    columns = {
        "position_m": blocks.series["position"],
        "current_A": blocks.series["coil_current"],
        "force_N": blocks.series["force"],
        "acceleration_mps2": blocks.series["acceleration"],
    }
    # A bench without accelerometer sends NaN.
    if np.isnan(columns["acceleration_mps2"]).all():
        del columns["acceleration_mps2"]
    unread = np.isnan(blocks.series[TEMPERATURE])
    if not unread.any():
        columns["temperature_C"] = blocks.series[TEMPERATURE] - ZERO_CELSIUS
    if len(blocks.stamp) == 0:
        return {"time_s": np.empty(0), **columns}, {"lost": 0, "jitter_s": 0.0}
    usable = (blocks.period > _PERIODS[0]) & (blocks.period < _PERIODS[1])
    if not usable.all():
        index = int(np.argmin(usable))
        raise InputError(f"{where}: block {index} has the sample period {blocks.period[index]} s, expected one of a bench")
    time, jitter = _sample_times(blocks)
    timing = {"lost": blocks.lost, "jitter_s": jitter, "first_stamp_s": float(blocks.stamp[0] * 1e-9)}
    if unread.any() and not unread.all():
        timing["unread_temperatures"] = int(unread.sum())
    return {"time_s": time, **columns}, timing


def _sample_times(blocks: Blocks) -> tuple[Array, float]:
    """Return the times (n,) of the samples since the first one, in s, and the jitter of the stamps in s."""
    elapsed = 1e-9 * (blocks.stamp - blocks.stamp[0])
    # A segment ends where the DAQ was restarted or its rate was changed. Within a segment the sample numbers tell the time;
    # the stamps tell when the segment starts.
    rate_changes = np.abs(np.diff(blocks.period)) > 1e-9 * blocks.period[0]
    cuts = np.flatnonzero((blocks.sequence_jumps < 0) | rate_changes) + 1
    times, jitter = [], 0.0
    for first, last in zip([0, *cuts], [*cuts, len(elapsed)], strict=True):
        # Dividing by a whole rate gives 0.007, multiplying by the period gives 0.007000000000000001.
        rate = 1 / blocks.period[first]
        rate = round(rate) if abs(rate - round(rate)) < 1e-6 * rate else rate
        count = blocks.count[first:last]
        numbers = blocks.sequence[first:last] - blocks.sequence[first]
        jitter = max(jitter, float(np.std(elapsed[first:last] - numbers / rate)))
        number_in_block = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        times.append(elapsed[first] + (np.repeat(numbers, count) + number_in_block) / rate)
    return np.concatenate(times), jitter
