"""Tables in MATLAB files: vectors, matrices, and structures of them."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_runs.importing.arrays import columns_of, flatten
from mrd_runs.importing.hdf5 import is_hdf5, read_hdf5_table
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
        values = sum(int(np.prod(shape, dtype=np.float64)) for _, shape, _ in whosmat(path))
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
    arrays: dict[str, Any] = {}
    for name, leaf in flatten({key: value for key, value in content.items() if not key.startswith("__")}):
        if isinstance(leaf, np.ndarray) and leaf.dtype.kind in "fiu":
            arrays |= {column: leaf[index] for column, index in columns_of(name, leaf.shape)}
    if not arrays:
        raise InputError(
            f"{path}: holds no vectors of numbers; save time, position and force as vectors or as a structure of them "
            "(tables and timeseries of MATLAB can be read by MATLAB only)"
        )
    return Table(
        tuple(Column(name) for name in arrays),
        lambda names: {name: np.ascontiguousarray(arrays[name], np.float64) for name in names},
    )
