"""Tables in HDF5 files, among them those of MATLAB since version 7.3."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.arrays import columns_of
from mrd_runs.importing.extras import load_extra
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_UNIT_NAMES = ("unit", "units", "Unit", "Units")


def is_hdf5(path: Path) -> bool:
    """Return whether a file is an HDF5 file; MATLAB writes 512 bytes of its own before."""
    try:
        with path.open("rb") as stream:
            content = stream.read(512 + len(_SIGNATURE))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    return content.startswith(_SIGNATURE) or content[512:] == _SIGNATURE


def read_hdf5_table(path: Path) -> Table:
    """List the data sets of an HDF5 file; each column is read when it is asked for.

    Data sets are called by their path, ``run/force``; columns of a matrix ``run/data(2)``, fields of a compound type
    ``run/data.force``.

    Raises
    ------
    InputError
        When h5py is not installed, or the file cannot be read.
    """
    h5py = load_extra("h5py", "h5py", "hdf5", path)
    columns: list[Column] = []
    places: dict[str, tuple[str, str, tuple[int | slice, ...]]] = {}

    def visit(name: str, item: Any) -> None:
        # MATLAB keeps what cells and strings refer to under #refs#, and texts as the numbers of their characters.
        if not isinstance(item, h5py.Dataset) or name.startswith("#") or _text(item.attrs.get("MATLAB_class")) == "char":
            return
        for field in item.dtype.names or ("",):
            if (item.dtype[field] if field else item.dtype).kind not in "fiu":
                continue
            unit = next((_text(item.attrs[key]) for key in _UNIT_NAMES if key in item.attrs), "")
            for column, index in columns_of(f"{name}.{field}" if field else name, item.shape):
                columns.append(Column(column, unit))
                places[column] = (name, field, index)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as an HDF5 file ({one_line(error)})") from None
    if not columns:
        raise InputError(f"{path}: holds no data sets of numbers; expected time, position and force")
    return Table(tuple(columns), lambda names: _read(h5py, path, places, names))


def _read(
    h5py: Any, path: Path, places: Mapping[str, tuple[str, str, tuple[int | slice, ...]]], names: Sequence[str]
) -> dict[str, Array]:
    series = {}
    try:
        with h5py.File(path, "r") as file:
            for column in names:
                name, field, index = places[column]
                data = file[name]
                if max(data.shape) > MOST_VALUES // len(names):
                    raise InputError(f"{path}: {one_line(name)} has {max(data.shape)} values; split the file")
                series[column] = np.ascontiguousarray(data.fields(field)[index] if field else data[index], np.float64)
    except InputError:
        raise
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as an HDF5 file ({one_line(error)})") from None
    return series


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
