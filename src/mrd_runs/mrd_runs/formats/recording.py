"""The result of a reader of a file format, and the description of a file format."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """Content of a file, before `mrd_runs.validation.make_run` checks it.

    Attributes
    ----------
    columns : dict of str to ndarray (n,)
        Columns as `make_run` takes them.
    info : mapping
        Facts about the recording, among them ``notes``, ``lost`` and ``recovered`` (see `read_run`).
    place : callable
        Returns how an error message names the sample of an index.
    """

    columns: dict[str, Array]
    info: Mapping[str, Any]
    place: Callable[[int], str] = "sample {}".format


@dataclass(frozen=True)
class FileFormat:
    """A file format of recordings.

    Attributes
    ----------
    suffixes : tuple of str
        Endings of the file names, in lower case.
    description : str
        Noun phrase for help texts and error messages.
    read : callable
        Reads a file; raises InputError when it is unusable.
    folders : bool
        Whether a recording may be a folder.
    """

    suffixes: tuple[str, ...]
    description: str
    read: Callable[[Path], Recording]
    folders: bool = False
