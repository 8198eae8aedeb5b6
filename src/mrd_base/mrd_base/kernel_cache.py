"""Compiled functions on disk that several processes may write at a time.

numba numbers the files of a function's signatures by its index, and writes the index first. Two processes that compile for
two signatures at the same moment, such as the nodes of a bench after an installation, give both the same number, and one
process ends later with the code of the other; a process that is ended in between leaves an index that names old code.
"""

import contextlib
import itertools
import os
import sys
from collections.abc import Iterator
from typing import Any

from numba.core.caching import IndexDataCacheFile

if sys.platform != "win32":
    import fcntl


def write_one_at_a_time() -> None:
    """Let this process write compiled functions while no other one does, and the code before the index that names it."""
    IndexDataCacheFile.save = _save


def _save(file: Any, key: Any, code: Any) -> None:
    with _locked(file._cache_path):
        names = file._load_index()
        if key not in names:
            taken = set(names.values())
            names[key] = next(name for name in map(file._data_name, itertools.count(1)) if name not in taken)
        file._save_data(names[key], code)
        file._save_index(names)


@contextlib.contextmanager
def _locked(folder: str) -> Iterator[None]:
    if sys.platform == "win32":  # no folder can be locked there; only the order of writing protects
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
