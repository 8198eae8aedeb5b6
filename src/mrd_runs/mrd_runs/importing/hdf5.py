"""Tables in HDF5 files, among them those of MATLAB since version 7.3."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.extras import load_extra
from mrd_runs.importing.arrays import columns_of
from mrd_runs.importing.attributes import listed_names, scaling_problem, text_of, texts_of, unit_attribute, with_facts_beside
from mrd_runs.importing.rates import stated_rate
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.importing.time_of_day import clock_seconds
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_APPLIED = ("scale_factor", "add_offset")
"""Attributes of packed numbers, by the conventions of netCDF: factor, and what is added then."""


_STARTS = ("t0", "t_0", "x0", "start", "start_time", "t_start", "time_offset", "start_offset", "wf_start_offset")
"""Attributes that tell the time of the first sample of a data set, in s or as a date."""
_MOST_NAMES = 64


class _Grid(NamedTuple):
    """The times of a data set that has an interval: this one and the first time, in s."""

    interval: float
    start: float


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
    facts: list[tuple[str, str | float]] = []
    beside: dict[str, dict[str, list[str]]] = {}
    grids: dict[str, _Grid] = {}
    single: list[tuple[str, str]] = []

    def collect(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "SO" and 1 < item.size <= _MOST_NAMES:
            group, _, own = name.rpartition("/")
            beside.setdefault(group, {})[own] = texts_of(item[()])

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
            facts.append((name.rpartition("/")[2], _number_or_text(item[()])))
            single.append((facts[-1][0], str(np.ravel(item[()])[0])))
        if item.size == 1 and item.dtype.kind in "SO":
            single.append((name, text_of(item[()])))
        for field in item.dtype.names or ("",):
            kind = (item.dtype[field] if field else item.dtype).kind
            if kind not in "fiu":
                columns.append(Column(f"{name}.{field}" if field else name, text="text" if kind in "SOU" else "no numbers"))
                continue
            found = list(columns_of(f"{name}.{field}" if field else name, item.shape))
            lists = {key: texts_of(value) for key, value in attributes.items()}
            names, units = listed_names({**beside.get(name.rpartition("/")[0], {}), **lists}, len(found))
            for (column, index), label, unit in zip(found, names, units, strict=True):
                column = f"{name}/{label}" if label and f"{name}/{label}" not in places else column
                unit = unit or unit_attribute(attributes)
                columns.append(Column(column, unit, problem=scaling_problem(attributes, (*_APPLIED, *_STARTS))))
                places[column] = _Place(name, field, index)
                if grid := _grid(attributes):
                    grids[column] = grid

    try:
        with h5py.File(path, "r") as file:
            facts.extend((key, _number_or_text(value)) for key, value in file.attrs.items())
            file.visititems(collect)
            file.visititems(visit)
    except Exception as error:  # h5py raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as an HDF5 file ({one_line(error)})") from None
    if not places:
        others = "; ".join(f"{one_line(column.name)} is {column.text}" for column in columns[:5])
        raise InputError(
            f"{path}: holds no data sets of numbers; expected time, position and force" + (f" ({others})" if others else "")
        )
    clocks: dict[str, tuple[_Grid, str]] = {}
    if len(set(grids.values())) > 1:
        of_grid: dict[_Grid, str] = {}
        for column, grid in grids.items():
            clocks.setdefault(of_grid.setdefault(grid, f"time of {column}"), (grid, column))
        columns = [replace(each, time=of_grid[grids[each.name]]) if each.name in grids else each for each in columns]
        columns += [Column(time, "s") for time in clocks]

    def read(names: Sequence[str]) -> dict[str, Array]:
        series = _read(h5py, path, places, [*dict.fromkeys(clocks[name][1] if name in clocks else name for name in names)])
        for name in names:
            if name in clocks:
                grid, column = clocks[name]
                series[name] = grid.start + np.arange(float(len(series[column]))) * grid.interval
        return series

    described, remarks = with_facts_beside(columns, single)
    return Table(described, read, rate=stated_rate(facts), remarks=remarks)


def _grid(attributes: Mapping[str, Any]) -> _Grid | None:
    """Return the times of a data set by its own attributes, such as ``dt`` and ``t0``; None without interval and rate."""
    facts = {key: _number_or_text(value) for key, value in attributes.items()}
    rate = stated_rate(facts.items())
    starts = (facts[key] for key in facts if key.lower() in _STARTS)
    start = next((seconds for text in starts if (seconds := _seconds(text)) is not None), 0.0)
    return _Grid(1 / rate, start) if rate else None


def _seconds(text: str | float) -> float | None:
    try:
        return float(text)
    except ValueError:
        return clock_seconds(str(text))


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


def _number_or_text(value: Any) -> str | float:
    if np.size(value) == 1 and np.asarray(value).dtype.kind in "fiu":
        return float(str(np.ravel(value)[0]))
    return text_of(value)
