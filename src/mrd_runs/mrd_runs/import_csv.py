"""CSV files as bags."""

import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np

from mrd_base import InputError
from mrd_runs.bag import BagWriter
from mrd_runs.csv_file import read_csv
from mrd_runs.definitions import SAMPLES_TYPE, typestore
from mrd_runs.description import run_info
from mrd_runs.read import IMPORTED
from mrd_runs.run import Run

# Samples in a block; 20 ms at 1 kHz, as the DAQ sends them.
_BLOCK = 20

# s; the seconds of a ROS stamp are a 32-bit integer.
_LAST_STAMP = 2.0**31


def import_run(run: Run, path: Path) -> None:
    """Write the CSV file that a run was read from as a bag.

    Samples go into blocks on the topic ``samples``, as the DAQ sends them, so that the bag can be replayed. Blocks are
    equally spaced in time and know no velocity and no temperature; the file's own values of these stand beside them, on
    ``imported/time_s`` and so on, and `read_run` takes those: every value comes back bit by bit.

    Parameters
    ----------
    run : Run
        Read from a CSV file.
    path : Path
        Folder of the bag; must not exist.

    Raises
    ------
    InputError
        When the folder exists, or the recording is longer than stamps reach (68 years). Nothing is left behind then.
    """
    columns, _, _ = read_csv(run.info["source"])
    stamps = _stamps(columns["time_s"], run.info["source"])
    made = [folder for folder in path.parents if not folder.exists()]
    writer = BagWriter(path)
    try:
        with writer:
            _write(run, columns, stamps, writer)
    except BaseException:
        shutil.rmtree(path, ignore_errors=True)
        with suppress(OSError):  # one that holds another bag stays
            for folder in made:
                folder.rmdir()
        raise


def _stamps(time: np.ndarray, source: str) -> np.ndarray:
    """Stamps of the samples in ns: their times, counted from the first one where ROS has no stamp for them."""
    if time[0] < 0 or time[-1] >= _LAST_STAMP:
        time = time - time[0]
    if time[-1] >= _LAST_STAMP:
        raise InputError(f"{source}: is {time[-1]:g} s long, expected less than {_LAST_STAMP:.0f} s; look at its time_s")
    return np.round(time * 1e9).astype(np.int64)


def _write(run: Run, columns: dict[str, np.ndarray], stamps: np.ndarray, writer: BagWriter) -> None:
    types = typestore().types
    block_type, array_type = types[SAMPLES_TYPE], types["std_msgs/msg/Float64MultiArray"]
    header, stamp_type = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    kept = [name for name in IMPORTED if name in columns]
    writer.add_topic("/run_info", "std_msgs/msg/String", latched=True)
    writer.add_topic("/samples", SAMPLES_TYPE, depth=200)
    for name in kept:
        writer.add_topic(f"/imported/{name}", "std_msgs/msg/Float64MultiArray", depth=200)
    info = run_info(started="", imported_from=Path(run.info["source"]).name, notes=list(run.info["notes"]))
    time = columns["time_s"]
    writer.write_message("/run_info", int(stamps[0]), types["std_msgs/msg/String"](info))
    none = np.full(len(time), np.nan)
    for first in range(0, len(time), _BLOCK):
        part = slice(first, min(first + _BLOCK, len(time)))
        stamp = int(stamps[first])
        ahead = min(part.stop, len(time) - 1)
        begin = min(first, ahead - 1)
        block = block_type(
            header(stamp_type(stamp // 10**9, stamp % 10**9), ""),
            float((time[ahead] - time[begin]) / (ahead - begin)),
            first,
            columns["position_m"][part],
            columns["force_N"][part],
            columns["current_A"][part],
            columns.get("acceleration_mps2", none)[part],
        )
        writer.write_message("/samples", stamp, block)
        for name in kept:
            writer.write_message(f"/imported/{name}", stamp, array_type(layout, columns[name][part]))


def targets(runs: list[Run], folder: Path) -> list[Path]:
    """Folders of the bags to write, one a run.

    Raises
    ------
    InputError
        When one of them exists.
    """
    paths = [folder / run.name.replace("/", "-") for run in runs]
    for path in paths:
        if path.exists():
            raise InputError(f"{path}: exists already and is not overwritten; give another --output or remove it")
    return paths
