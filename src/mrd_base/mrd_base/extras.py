"""Libraries that only some files need."""

from importlib import import_module
from pathlib import Path
from typing import Any

from mrd_base.errors import InputError


def load_extra(module: str, package: str, extra: str, path: Path) -> Any:
    """Import the library that reads a file; raise InputError where it is not installed.

    Parameters
    ----------
    module, package : str
        Name of the module, and of the package on the index.
    extra : str
        Optional dependency of this software that brings it.
    path : Path
        File to read.
    """
    try:
        return import_module(module)
    except ImportError:
        raise InputError(
            f"{path}: this format needs the package {package}; run: pip install {package} "
            f"(or, in the folder of this software, pip install '.[{extra}]')"
        ) from None
