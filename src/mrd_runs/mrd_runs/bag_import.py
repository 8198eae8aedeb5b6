"""Importing: a recording in a file of another format becomes a bag."""

import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.quantities import ZERO_CELSIUS
from mrd_runs.bag import BagWriter
from mrd_runs.definitions import SAMPLES_TYPE
from mrd_runs.formats.bag_file import IMPORTED_COLUMNS
from mrd_runs.run_info import format_run_info

Array = NDArray[np.float64]

# Samples in a block: 20 ms at 1 kHz, as the DAQ sends them.
_BLOCK = 20

# Longest sampling period in s that a block states; the topic of the exact times tells what a longer gap is.
_LONGEST_PERIOD = 3600.0

# First time in s that a ROS stamp cannot represent; its seconds are a 32-bit integer.
_END_OF_STAMPS = 2.0**31


def write_bag(
    columns: Mapping[str, Array], notes: Sequence[str], source: Path, path: Path, facts: Mapping[str, Any] | None = None
) -> None:
    """Write columns as `make_run` takes them as a bag.

    The samples go into blocks on the topic ``samples``, as the DAQ sends them, so that the bag can be replayed. Blocks have
    equally spaced samples, without velocity, and the temperature in K. Topics ``imported/time_s`` and so on therefore hold
    these columns exactly, and `read_run` returns every value bit by bit.

    Parameters
    ----------
    columns : mapping of str to ndarray (n,)
    notes : sequence of str
        Facts about the recording.
    source : Path
        File that the columns are from.
    path : Path
        Folder of the bag; it must not exist.
    facts : mapping, optional
        What ``run_info`` tells beside, such as the date ``started``.

    Raises
    ------
    InputError
        When the folder exists, or the recording is longer than ROS stamps reach (68 years). No file is left behind then.
    """
    stamps = _stamps(columns["time_s"], source)
    new_folders = [folder for folder in path.parents if not folder.exists()]
    writer = BagWriter(path)
    try:
        with writer:
            info = format_run_info(**{"started": "", **(facts or {})}, imported_from=source.name, notes=list(notes))
            _write(writer, columns, stamps, info)
    except BaseException:
        shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):  # a folder that holds another bag stays
            for folder in new_folders:
                folder.rmdir()
        raise


def bag_folder(name: str, folder: Path) -> Path:
    """Return the folder of the bag of a run.

    Raises
    ------
    InputError
        When it exists.
    """
    path = folder / name.replace("/", "-")
    if path.exists():
        raise InputError(f"{path}: exists already and is not overwritten; give another --output or remove it")
    return path


def _stamps(time: Array, source: Path) -> NDArray[np.int64]:
    """Return the stamps of the samples in ns, counted from the first sample where ROS cannot represent the times."""
    if time[0] < 0 or time[-1] >= _END_OF_STAMPS:
        time = time - time[0]
    if time[-1] >= _END_OF_STAMPS:
        raise InputError(f"{source}: is {time[-1]:g} s long, expected less than {_END_OF_STAMPS:.0f} s; check its time_s")
    return np.round(time * 1e9).astype(np.int64)


def _write(writer: BagWriter, columns: Mapping[str, Array], stamps: NDArray[np.int64], run_info: str) -> None:
    types = writer.types.types
    block_type, array_type = types[SAMPLES_TYPE], types["std_msgs/msg/Float64MultiArray"]
    header, stamp_type = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    exact = [name for name in IMPORTED_COLUMNS if name in columns]
    writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
    writer.add_topic("/samples", SAMPLES_TYPE, depth=200)
    for name in exact:
        writer.add_topic(f"/imported/{name}", "std_msgs/msg/Float64MultiArray", depth=200)
    time = columns["time_s"]
    writer.write_message("/run_info", int(stamps[0]), types["std_msgs/msg/String"](run_info))
    temperature = columns["temperature_C"] + ZERO_CELSIUS if "temperature_C" in columns else np.empty(0)
    no_accelerometer = np.full(len(time), np.nan)
    for first in range(0, len(time), _BLOCK):
        block = slice(first, min(first + _BLOCK, len(time)))
        stamp = int(stamps[first])
        # The mean period also covers the interval to the next block, so that a block of one sample has a period.
        end = min(block.stop, len(time) - 1)
        begin = min(first, end - 1)
        message = block_type(
            header(stamp_type(stamp // 10**9, stamp % 10**9), ""),
            min(float((time[end] - time[begin]) / (end - begin)), _LONGEST_PERIOD),
            first,
            columns["position_m"][block],
            columns["force_N"][block],
            columns["current_A"][block],
            columns.get("acceleration_mps2", no_accelerometer)[block],
            temperature[block],
        )
        writer.write_message("/samples", stamp, message)
        for name in exact:
            writer.write_message(f"/imported/{name}", stamp, array_type(layout, columns[name][block]))
