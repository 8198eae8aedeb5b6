"""Tables in TDMS files of LabVIEW."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.extras import load_extra
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.text import one_line

Array = NDArray[np.float64]


def read_tdms_table(path: Path) -> Table:
    """List the channels of a TDMS file; each is read when it is asked for.

    Channels are called by their name, with that of their group where there are several groups. A group of waveforms without
    a channel of time has one called ``time``, of their increment.

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
    clocks: dict[str, tuple[int, float, float]] = {}
    try:
        with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
            cut = file.file_status.incomplete_final_segment
            groups = [group for group in file.groups() if group.channels()]
            for group in groups:
                prefix = f"{group.name}/" if len(groups) > 1 else ""
                for channel in group.channels():
                    if channel.dtype.kind not in "fiuM":
                        continue
                    name = f"{prefix}{channel.name}"
                    unit = channel.properties.get("unit_string", "") or ("s" if channel.dtype.kind == "M" else "")
                    columns.append(Column(name, str(unit)))
                    channels[name] = (group.name, channel.name)
                    if "wf_increment" in channel.properties:
                        start = float(channel.properties.get("wf_start_offset", 0.0))
                        clocks[f"{prefix}time"] = (len(channel), start, float(channel.properties["wf_increment"]))
    except Exception as error:  # npTDMS raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as a TDMS file ({one_line(error)})") from None
    if not columns:
        raise InputError(f"{path}: holds no channels of numbers; expected time, position and force")
    clocks = {name: clock for name, clock in clocks.items() if name not in channels}
    columns += [Column(name, "s") for name in clocks]
    layout = "the file is cut off: its last segment is incomplete" if cut else ""
    return Table(tuple(columns), lambda names: _read(nptdms, path, channels, clocks, names), layout)


def _read(
    nptdms: Any,
    path: Path,
    channels: Mapping[str, tuple[str, str]],
    clocks: Mapping[str, tuple[int, float, float]],
    names: Sequence[str],
) -> dict[str, Array]:
    series: dict[str, Array] = {}
    try:
        with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
            for name in names:
                count = clocks[name][0] if name in clocks else len(file[channels[name][0]][channels[name][1]])
                if count > MOST_VALUES // len(names):
                    raise InputError(f"{path}: {one_line(name)} has {count} values; split the file")
                if name in clocks:
                    series[name] = np.asarray(clocks[name][1] + clocks[name][2] * np.arange(count), np.float64)
                    continue
                values: Any = file[channels[name][0]][channels[name][1]][:]
                if values.dtype.kind == "M":
                    values = (values - values[0]) / np.timedelta64(1, "ns") * 1e-9
                series[name] = np.ascontiguousarray(values, np.float64)
    except InputError:
        raise
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as a TDMS file ({one_line(error)})") from None
    return series
