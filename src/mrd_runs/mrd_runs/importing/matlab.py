"""Tables in MATLAB files: vectors, matrices, and structures of them."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.arrays import columns_of, leaves_of
from mrd_runs.importing.attributes import listed_names, with_facts_beside
from mrd_runs.importing.hdf5 import is_hdf5, read_hdf5_table
from mrd_runs.importing.rates import stated_rate
from mrd_runs.importing.table import MOST_VALUES, Column, Table
from mrd_runs.text import one_line

Array = NDArray[np.float64]

_LARGEST_FILE = 8 * MOST_VALUES  # bytes

# A damaged file can end the process in SciPy's compiled reader. So a process of its own reads it first.
_TRIAL = "import sys; from scipy.io import loadmat; loadmat(sys.argv[1], simplify_cells=True)"


def read_matlab_table(path: Path) -> Table:
    """Read a MATLAB file; since version 7.3 these are HDF5 files.

    Raises
    ------
    InputError
        When the file cannot be read or is larger than any recording, or h5py is needed and not installed.
    """
    if is_hdf5(path):
        return read_hdf5_table(path)
    from scipy.io import loadmat, whosmat

    try:
        listed = whosmat(path)
        values = sum(int(np.prod(shape, dtype=np.float64)) for _, shape, _ in listed)
        if path.stat().st_size > _LARGEST_FILE or values > MOST_VALUES:
            raise InputError(f"{path}: holds more than {MOST_VALUES} values; split it")
        trial = subprocess.run([sys.executable, "-c", _TRIAL, str(path.resolve())], stderr=subprocess.DEVNULL, check=False)
        if trial.returncode < 0:
            raise InputError(f"{path}: is damaged, so that no reader survives it; save it anew")
        content = loadmat(path, simplify_cells=True)
    except InputError:
        raise
    except Exception as error:  # scipy raises many kinds for a damaged file
        raise InputError(f"{path}: cannot be read as a MATLAB file ({one_line(error)})") from None
    columns: dict[str, Column] = {}
    arrays: dict[str, Any] = {}
    numbers: list[tuple[str, float]] = []
    texts: list[tuple[str, str]] = []
    for name, leaf in leaves_of({key: value for key, value in content.items() if not key.startswith("__")}):
        if isinstance(leaf.values, np.ndarray) and leaf.values.dtype.kind in "fiu":
            found = list(columns_of(name, leaf.values.shape))
            names, units = listed_names(leaf.lists, len(found))
            parent = name.rpartition(".")[0]
            for (column, index), label, unit in zip(found, names, units, strict=True):
                column = (f"{parent}.{label}" if parent else label) if label else column
                columns[column] = Column(column, unit or leaf.unit, time=leaf.time, problem=leaf.problem)
                arrays[column] = leaf.values[index]
        elif isinstance(leaf.values, int | float | np.number):
            numbers.append((name.rpartition(".")[2], float(leaf.values)))
        else:
            texts += [(name, leaf.values)] if isinstance(leaf.values, str) else []
            columns[name] = Column(name, text=_kind(leaf.values))
    if any(kind in ("opaque", "object") for *_, kind in listed):
        columns |= {name: Column(name, text=f"a {kind} of MATLAB") for name, kind in _objects(path).items()}
    if not arrays:
        others = "; ".join(f"{one_line(name)} is {column.text}" for name, column in list(columns.items())[:5])
        raise InputError(
            f"{path}: holds no vectors of numbers{f' ({others})' if others else ''}; save time, position and force as "
            "vectors or as a structure of them (tables, timeseries and other objects of MATLAB can be read by MATLAB only)"
        )
    facts = [*((name, f"{number:g}") for name, number in numbers), *texts]
    described, remarks = with_facts_beside(list(columns.values()), facts)
    return Table(
        described,
        lambda names: {name: np.ascontiguousarray(arrays[name], np.float64) for name in names},
        rate=stated_rate(numbers),
        remarks=remarks,
    )


def _kind(value: object) -> str:
    return "text" if isinstance(value, str) else "empty" if np.size(np.asarray(value, object)) == 0 else "no numbers"


def _objects(path: Path) -> dict[str, str]:
    """Return the kinds of the variables that are objects, by name; SciPy names them only."""
    from scipy.io import loadmat

    found = {}
    for name, value in loadmat(path).items():
        if isinstance(value, np.ndarray) and value.dtype.names == ("s0", "s1", "s2", "arr"):
            found[str(name)] = str(value.reshape(-1)[0]["s2"].decode(errors="replace")) or "object"
    return found
