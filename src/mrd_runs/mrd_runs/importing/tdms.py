"""Tables in TDMS files of LabVIEW."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.extras import load_extra
from mrd_runs.importing.attributes import scaling_problem, unit_attribute
from mrd_runs.importing.quantities import is_time
from mrd_runs.importing.rates import stated_rate
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_TEXT = "text"
_KNOWN = ("wf_start_offset",)


class _Wave(NamedTuple):
    """The times of a waveform: group, start in µs since 1970, offset and increment in s."""

    prefix: str
    start_us: int
    offset: float
    increment: float


def read_tdms_table(path: Path) -> Table:
    """List the channels of a TDMS file; each is read when it is asked for.

    Channels are called by their name, with that of their group where there are several groups. Waveforms have their times
    from ``wf_start_time``, ``wf_start_offset`` and ``wf_increment``: those that share all three have one column ``time``.

    Raises
    ------
    InputError
        When npTDMS is not installed, or the file cannot be read.
    """
    nptdms = load_extra("nptdms", "npTDMS", "tdms", path)
    # Of a damaged file it would print line after line, with its bytes.
    nptdms.log.log_manager.set_level(logging.CRITICAL)
    columns: list[Column] = []
    channels: dict[str, tuple[str, str]] = {}
    waves: dict[_Wave, str] = {}
    starts: list[bool] = []
    try:
        with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
            cut = file.file_status.incomplete_final_segment
            groups = [group for group in file.groups() if group.channels()]
            facts = [fact for each in (file, *groups) for fact in each.properties.items()]
            rate = stated_rate((str(key), value if isinstance(value, int | float) else str(value)) for key, value in facts)
            counts = {(group.name, channel.name): len(channel) for group in groups for channel in group.channels()}
            for group in groups:
                prefix = f"{group.name}/" if len(groups) > 1 else ""
                has_time = any(is_time(Column(channel.name)) for channel in group.channels())
                for channel in group.channels():
                    name, properties = f"{prefix}{channel.name}", dict(channel.properties)
                    if channel.dtype.kind not in "fiuM":
                        columns.append(Column(name, text=_TEXT))
                        continue
                    time = ""
                    if "wf_increment" in properties and not has_time:
                        wave = _wave(prefix, properties)
                        is_first = not any(known.prefix == prefix for known in waves)
                        time = waves.setdefault(wave, f"{prefix}time" if is_first else f"{prefix}time of {channel.name}")
                        starts.append("wf_start_time" in properties)
                    unit = unit_attribute(properties) or ("s" if channel.dtype.kind == "M" else "")
                    columns.append(Column(name, unit, time=time, problem=scaling_problem(properties, _KNOWN)))
                    channels[name] = (group.name, channel.name)
    except Exception as error:  # npTDMS raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as a TDMS file ({one_line(error)})") from None
    if not channels:
        raise InputError(f"{path}: holds no channels of numbers; expected time, position and force")
    longest = {
        time: max(counts[channels[column.name]] for column in columns if column.time == time) for time in waves.values()
    }
    columns += [Column(time, "s") for time in waves.values()]
    layout = "the file is cut off: its last segment is incomplete" if cut else ""
    if len(set(starts)) > 1:
        raise InputError(
            f"{path}: some channels have a wf_start_time and others have none; expected one for all or for none"
        )
    clocks = {time: (wave, longest[time]) for wave, time in waves.items()}
    return Table(tuple(columns), lambda names: _read(nptdms, path, channels, clocks, names), layout, rate=rate, ragged=cut)


def _wave(prefix: str, properties: Mapping[str, Any]) -> _Wave:
    start = properties.get("wf_start_time")
    microseconds = 0 if start is None else int(np.datetime64(start, "us").astype(np.int64))
    return _Wave(prefix, microseconds, float(properties.get("wf_start_offset", 0.0)), float(properties["wf_increment"]))


def _read(
    nptdms: Any,
    path: Path,
    channels: Mapping[str, tuple[str, str]],
    clocks: Mapping[str, tuple[_Wave, int]],
    names: Sequence[str],
) -> dict[str, Array]:
    series: dict[str, Array] = {}
    first = min((wave.start_us for wave, _ in clocks.values()), default=0)
    try:
        with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
            for name in names:
                count = clocks[name][1] if name in clocks else len(file[channels[name][0]][channels[name][1]])
                if count > MOST_VALUES // len(names):
                    raise InputError(f"{path}: {one_line(name)} has {count} values; split the file")
                if name in clocks:
                    wave = clocks[name][0]
                    start = 1e-6 * (wave.start_us - first) + wave.offset
                    series[name] = np.asarray(start + wave.increment * np.arange(count), np.float64)
                    continue
                values: Any = file[channels[name][0]][channels[name][1]][:]
                if values.dtype.kind == "M":
                    # From midnight on, so that two channels count from one instant and many digits are left.
                    values = (values - values[0].astype("datetime64[D]")) / np.timedelta64(1, "ns") * 1e-9
                series[name] = np.ascontiguousarray(values, np.float64)
    except InputError:
        raise
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as a TDMS file ({one_line(error)})") from None
    return series
