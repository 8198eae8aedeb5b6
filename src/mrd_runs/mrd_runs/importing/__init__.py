"""Recordings of other benches and programs: reading them as columns in SI units."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.bag import read_bag
from mrd_runs.definitions import SAMPLES_TYPE
from mrd_runs.formats import BAG, Recording
from mrd_runs.importing.hdf5 import read_hdf5_table
from mrd_runs.importing.integration import integrate_velocity
from mrd_runs.importing.matlab import read_matlab_table
from mrd_runs.importing.quantities import Source, find_sources, propose_topics
from mrd_runs.importing.sheet import read_sheet_table
from mrd_runs.importing.synchronise import synchronise
from mrd_runs.importing.table import Table
from mrd_runs.importing.tdms import read_tdms_table
from mrd_runs.importing.text import read_text_table
from mrd_runs.importing.topics import list_numbers, parse_address, read_topics
from mrd_runs.importing.units import COLUMNS, si_unit, to_si
from mrd_runs.text import one_line

Array = NDArray[np.float64]

READERS: Mapping[str, Callable[[Path], Table]] = {
    ".mat": read_matlab_table,
    ".h5": read_hdf5_table,
    ".hdf5": read_hdf5_table,
    ".hdf": read_hdf5_table,
    ".xlsx": read_sheet_table,
    ".xlsm": read_sheet_table,
    ".tdms": read_tdms_table,
}
"""Readers by the ending of the name; any other file is read as text."""


@dataclass(frozen=True)
class Mapped:
    """What a user says about a file.

    Attributes
    ----------
    columns, topics : mapping of str to str
        Column of the file, or number of a topic, of a quantity.
    units : mapping of str to str
        Unit of a quantity, in place of the one that the file names.
    flip : tuple of str
        Quantities whose sign is turned.
    current : float, optional
        Constant current in A.
    rate : float, optional
        Sample rate in Hz of a file without time; or to which the series of a bag are resampled.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    flip: tuple[str, ...] = ()
    current: float | None = None
    rate: float | None = None


def read_foreign(path: Path, mapped: Mapped = Mapped()) -> Recording:
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
        Its ``notes`` say how each quantity was found and changed.

    Raises
    ------
    InputError
        When the file cannot be read. Where it does not tell its quantities, the line ends with options that would do.
    """
    if path.is_dir() or path.suffix.lower() in BAG.suffixes:
        return _read_bag(path, mapped)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a recording")
    if mapped.topics:
        raise InputError(f"{path}: --topics is for bags; name the columns of this file with --map")
    table = READERS.get(path.suffix.lower(), read_text_table)(path)
    sources = find_sources(
        table.columns,
        mapped.columns,
        str(path),
        current_is_given=mapped.current is not None,
        rate_is_given=mapped.rate is not None,
    )
    values = table.read([source.name for source in sources.values()])
    series = {quantity: values[source.name] for quantity, source in sources.items()}
    lengths = {quantity: len(column) for quantity, column in series.items()}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{count} of {one_line(sources[quantity].name)}" for quantity, count in lengths.items())
        raise InputError(f"{path}: holds {shown}; expected equally many, of one table")
    notes = [table.layout] if table.layout else []
    unused = [column.name for column in table.columns if column.name and not column.text and column.name not in values]
    if unused:
        notes.append(f"not used: {', '.join(map(one_line, unused[:20]))}" + (", ..." if len(unused) > 20 else ""))
    if mapped.rate is not None:
        series["time"] = np.arange(len(next(iter(series.values())))) / mapped.rate
    return _finish(path, series, sources, mapped, notes, table.place)


def _read_bag(path: Path, mapped: Mapped) -> Recording:
    if mapped.columns:
        raise InputError(f"{path}: --map is for tables; name the numbers of this bag with --topics")
    if not mapped.topics:
        if any(topic.message_type == SAMPLES_TYPE for topic in read_bag(path, set()).topics.values()):
            return _read_own_bag(path, mapped)
        raise InputError(propose_topics(str(path), list_numbers(path), current_is_given=mapped.current is not None))
    addresses = {quantity: parse_address(text, f"--topics {quantity}") for quantity, text in mapped.topics.items()}
    needed = {"force": "force" in addresses, "position": "position" in addresses or "velocity" in addresses}
    needed["current"] = "current" in addresses or mapped.current is not None
    if not all(needed.values()):
        missing = " and ".join(quantity for quantity, given in needed.items() if not given)
        raise InputError(
            f"{path}: --topics names no {missing}; expected position (or velocity), force and current (or --current)"
        )
    if "time" in addresses:
        raise InputError(f"{path}: --topics names a time; the times are those of the messages, leave it out")
    found, notes = read_topics(path, addresses)
    series, done = synchronise(found, mapped.rate, str(path))
    sources = {quantity: Source(str(address), "") for quantity, address in addresses.items()}
    return _finish(path, series, sources, mapped, notes + done)


def _read_own_bag(path: Path, mapped: Mapped) -> Recording:
    """Read a bag of this bench, or one that was imported before, to change its signs, units or current."""
    if not (mapped.flip or mapped.units or mapped.current is not None):
        raise InputError(
            f"{path}: is a bag of this bench already; every tool reads it as it is. Expected --flip, --units or --current, "
            "which change it"
        )
    if mapped.rate is not None:
        raise InputError(f"{path}: is a bag of this bench already and has its times; leave --rate out")
    recording = BAG.read(path)
    series = {quantity: recording.columns[name] for quantity, name in COLUMNS.items() if name in recording.columns}
    made = _finish(path, series, {}, mapped, list(recording.info["notes"]))
    return replace(made, info={**recording.info, **made.info})


def _finish(
    path: Path,
    series: Mapping[str, Array],
    sources: Mapping[str, Source],
    mapped: Mapped,
    notes: list[str],
    place: Callable[[int], str] = "sample {}".format,
) -> Recording:
    """Convert series to SI units, and add what the file lacks."""
    absent = [quantity for quantity in (*mapped.units, *mapped.flip) if quantity not in series]
    if absent:
        raise InputError(f"{path}: --units or --flip names the {absent[0]}, which is not read; expected {', '.join(series)}")
    columns, told = {}, []
    for quantity, values in series.items():
        source = sources.get(quantity)
        unit = mapped.units.get(quantity) or (source.unit if source else "")
        columns[quantity] = to_si(quantity, values, unit or si_unit(quantity), str(path))
        if source:
            told.append(f"{quantity} is {one_line(source.name)} in {unit or f'{si_unit(quantity)} (no unit given)'}")
        elif quantity in mapped.units:
            told.append(f"{quantity} is in {unit}")
    if told:
        notes.append("; ".join(told))
    for quantity in mapped.flip:
        columns[quantity] = -columns[quantity]
        notes.append(f"the sign of the {quantity} was turned")
    if mapped.current is not None:
        columns["current"] = np.full(len(columns["time"]), mapped.current)
        notes.append(f"current of {mapped.current:g} A as given")
    if "position" not in columns:
        time = columns["time"]
        if len(time) < 2 or not (np.isfinite(columns["velocity"]).all() and np.all(np.diff(time) > 0)):
            raise InputError(
                f"{path}: holds no position, and its velocity or time cannot be integrated; expected rising times"
            )
        columns["position"], note = integrate_velocity(time, columns["velocity"])
        # The mean error of the velocity is out of the position; the velocity is computed from it again.
        del columns["velocity"]
        notes.append(note)
    info = {"format": path.suffix.lstrip(".") or "text", "notes": notes, "lost": 0, "recovered": False}
    return Recording({COLUMNS[quantity]: columns[quantity] for quantity in COLUMNS if quantity in columns}, info, place)


__all__ = ["Mapped", "read_foreign"]
