"""Tables in HDF5 files, among them those of MATLAB since version 7.3."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.arrays import columns_of
from mrd_runs.importing.attributes import scaling_problem, text_of, unit_attribute
from mrd_runs.importing.extras import load_extra
from mrd_runs.importing.rates import stated_rate
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_APPLIED = ("scale_factor", "add_offset")
"""Attributes of packed numbers, by the conventions of netCDF: factor, and what is added then."""


class _Place(NamedTuple):
    """Where a column stands: data set, field of its type, and index."""

    name: str
    field: str
    selection: tuple[int | slice, ...]


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
    places: dict[str, _Place] = {}
    facts: list[tuple[str, str]] = []

    def visit(name: str, item: Any) -> None:
        attributes = dict(item.attrs)
        facts.extend((key, _number_or_text(value)) for key, value in attributes.items())
        # MATLAB keeps what cells and strings refer to under #refs#, and texts as the numbers of their characters.
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        kind = text_of(attributes.get("MATLAB_class"))
        if kind in ("char", "cell") or (attributes.get("MATLAB_object_decode") is not None and kind):
            columns.append(Column(name, text=f"a {kind} of MATLAB" if kind not in ("char", "cell") else kind))
            return
        if item.size == 1 and item.dtype.kind in "fiu":
            facts.append((name.rpartition("/")[2], str(item[()].reshape(-1)[0] if item.shape else item[()])))
        for field in item.dtype.names or ("",):
            kind = (item.dtype[field] if field else item.dtype).kind
            if kind not in "fiu":
                columns.append(Column(f"{name}.{field}" if field else name, text="text" if kind in "SOU" else "no numbers"))
                continue
            found = list(columns_of(f"{name}.{field}" if field else name, item.shape))
            names, units = _labels(attributes, len(found))
            for (column, index), label, unit in zip(found, names, units, strict=True):
                column = f"{name}/{label}" if label and f"{name}/{label}" not in places else column
                columns.append(Column(column, unit, problem=scaling_problem(attributes, _APPLIED)))
                places[column] = _Place(name, field, index)

    try:
        with h5py.File(path, "r") as file:
            facts.extend((key, _number_or_text(value)) for key, value in file.attrs.items())
            file.visititems(visit)
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as an HDF5 file ({one_line(error)})") from None
    if not places:
        others = "; ".join(f"{one_line(column.name)} is {column.text}" for column in columns[:5])
        raise InputError(
            f"{path}: holds no data sets of numbers; expected time, position and force" + (f" ({others})" if others else "")
        )
    return Table(tuple(columns), lambda names: _read(h5py, path, places, names), rate=stated_rate(facts))


def _read(h5py: Any, path: Path, places: Mapping[str, _Place], names: Sequence[str]) -> dict[str, Array]:
    series = {}
    try:
        with h5py.File(path, "r") as file:
            for column in names:
                name, field, index = places[column]
                data = file[name]
                if max(data.shape) > MOST_VALUES // len(names):
                    raise InputError(f"{path}: {one_line(name)} has {max(data.shape)} values; split the file")
                values = np.ascontiguousarray(data.fields(field)[index] if field else data[index], np.float64)
                for fill in ("_FillValue", "missing_value"):
                    if fill in data.attrs:
                        values[values == float(np.ravel(data.attrs[fill])[0])] = np.nan
                factor, zero = (data.attrs.get(key, neutral) for key, neutral in zip(_APPLIED, (1.0, 0.0), strict=True))
                series[column] = values * float(np.ravel(factor)[0]) + float(np.ravel(zero)[0])
    except InputError:
        raise
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as an HDF5 file ({one_line(error)})") from None
    return series


def _labels(attributes: Mapping[str, Any], count: int) -> tuple[list[str], list[str]]:
    """Return names and units of the columns of a data set, where its attributes list them; else its unit for all."""
    names, units = [""] * count, [unit_attribute(attributes)] * count
    for key, value in attributes.items():
        texts = [text_of(each) for each in np.ravel(value)] if isinstance(value, np.ndarray | list | tuple) else []
        if count < 2 or len(texts) != count or not all(texts):
            continue
        if re.fullmatch(r"(unit|units)", key, re.IGNORECASE):
            units = texts
        elif re.search(r"name|column|channel|label|field", key, re.IGNORECASE) and len(set(texts)) == count:
            names = texts
    return names, units


def _number_or_text(value: Any) -> str:
    return text_of(value) or (str(np.ravel(value)[0]) if np.size(value) == 1 else "")
