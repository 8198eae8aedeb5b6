"""Recordings of other benches and programs: reading them as columns in SI units."""

import glob
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from mrd_base import InputError
from mrd_runs.formats import BAG, Recording, is_own
from mrd_runs.importing.bags import bag_recordings
from mrd_runs.importing.finish import Mapped
from mrd_runs.importing.hdf5 import read_hdf5_table
from mrd_runs.importing.matlab import read_matlab_table
from mrd_runs.importing.quantities import is_no_time
from mrd_runs.importing.sheet import read_sheet_table
from mrd_runs.importing.table import Table, join_tables
from mrd_runs.importing.tables import table_recordings
from mrd_runs.importing.tdms import read_tdms_table
from mrd_runs.importing.text import read_text_table

READERS: Mapping[str, Callable[[Path], Table]] = {
    ".mat": read_matlab_table,
    ".h5": read_hdf5_table,
    ".hdf5": read_hdf5_table,
    ".hdf": read_hdf5_table,
    ".nc": read_hdf5_table,
    ".xlsx": read_sheet_table,
    ".xlsm": read_sheet_table,
    ".tdms": read_tdms_table,
}
"""Readers by the ending of the name; any other file is read as text."""

_ENDINGS = (".csv", ".txt", ".dat", ".asc", ".tsv", ".lvm", *READERS)
"""Endings of the files that are read of a folder."""

_ROS_1 = b"#ROSBAG V"
_NOTHING = Mapped()


def read_foreign(path: Path, mapped: Mapped = _NOTHING) -> Recording:
    """Read a recording of another bench or program.

    Parameters
    ----------
    path : Path
        A text file in any dialect, a file with an ending of `READERS`, or a bag.
    mapped : Mapped
        What the file does not tell.

    Returns
    -------
    Recording
        Its ``notes`` say how each quantity was found and changed, its ``clocks`` of which clock each channel is, where these
        are several.

    Raises
    ------
    InputError
        When the file cannot be read, or holds several passes. Where it does not tell its quantities, the line ends with
        options that would do.
    """
    recordings = read_passes(path, mapped)
    if len(recordings) > 1:
        raise InputError(f"{path}: holds {len(recordings)} passes, expected one; read them with read_passes")
    return recordings[0]


def read_passes(path: Path, mapped: Mapped = _NOTHING) -> list[Recording]:
    """Read the recordings in a file, as `read_foreign` does: one of each pass of its clock, in their order."""
    if is_bag(path):
        return bag_recordings(path, mapped)
    return table_recordings(path, _read_table(path, mapped), mapped)


def read_together(paths: Sequence[Path], mapped: Mapped = _NOTHING) -> list[Recording] | None:
    """Read files that hold one channel each, as oscilloscopes write them, as the channels of one recording.

    Returns
    -------
    list of Recording or None
        None where the files are no such set, because one holds more channels or none that tells its times: then each is a
        recording of its own.
    """
    if len(paths) < 2 or any(map(is_bag, paths)) or mapped.rate is not None:
        return None
    tables = {path: _read_table(path, mapped) for path in paths}
    firsts = [
        next((column for column in table.columns if column.name and not column.text), None) for table in tables.values()
    ]
    if any(column is not None and is_no_time(column) for column in firsts):
        return None
    joined = join_tables({path.stem: table for path, table in tables.items()})
    return None if joined is None else table_recordings(paths[0], joined, mapped)


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag, or of a folder that holds the files of one."""
    return path.is_dir() or path.suffix.lower() in BAG.suffixes


def find_files(paths: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the files and bags that paths mean: a folder that is no bag means what is in it, a pattern what fits it.

    Returns
    -------
    files, skipped : list of Path
        Of a folder, those whose ending tells a recording, in the order of their names; and the others.

    Raises
    ------
    InputError
        When a pattern or a folder means nothing.
    """
    files: list[Path] = []
    skipped: list[Path] = []
    for path in paths:
        found = [path]
        if not path.exists() and glob.has_magic(str(path)):
            found = [Path(name) for name in sorted(glob.glob(str(path), recursive=True))]
            if not found:
                raise InputError(f"{path}: no file fits this pattern; expected a recording")
        for each in found:
            if not each.is_dir() or is_own(each):
                files.append(each)
                continue
            inside = sorted(entry for entry in each.iterdir() if not entry.name.startswith("."))
            usable = [entry for entry in inside if _is_recording(entry)]
            if not usable:
                raise InputError(f"{each}: is a folder without a recording; expected {', '.join(_ENDINGS)} or a bag")
            files += usable
            skipped += [entry for entry in inside if entry not in usable]
    return files, skipped


def _is_recording(path: Path) -> bool:
    return is_own(path) if path.is_dir() else path.suffix.lower() in _ENDINGS


def _read_table(path: Path, mapped: Mapped) -> Table:
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a recording")
    with path.open("rb") as stream:
        if stream.read(len(_ROS_1)) == _ROS_1:
            raise InputError(
                f"{path}: is a bag of ROS 1, expected one of ROS 2; convert it: rosbags-convert --src {path} --dst FOLDER"
            )
    if mapped.topics:
        raise InputError(f"{path}: --topics is for bags; name the columns of this file with --map")
    return READERS.get(path.suffix.lower(), read_text_table)(path)


__all__ = ["Mapped", "find_files", "read_foreign", "read_passes", "read_together"]
