"""Text files that somebody names, who may be a stranger: of bounded size, in UTF-8 with or without a byte order mark."""

import stat
from pathlib import Path

from mrd_base.errors import InputError

LARGEST = 2**30
"""Bytes of a text file, at most."""


def read_text_file(path: Path, expected: str, largest: int = LARGEST) -> str:
    """Return the text of a file.

    Parameters
    ----------
    path : Path
    expected : str
        What should have been named, for the error message.
    largest : int
        Bytes that it may have.

    Raises
    ------
    InputError
        When it is no file, is larger, cannot be read, or is not text.
    """
    try:
        found = path.stat()
        # A device may have no end, and a pipe may never have a beginning.
        is_file = stat.S_ISREG(found.st_mode)
        if is_file and found.st_size <= largest:
            return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text ({error.reason} at byte {error.start}), expected {expected}") from None
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if not is_file:
        raise InputError(f"{path}: is not a file, expected {expected}")
    raise InputError(f"{path}: has {found.st_size} bytes, expected {expected} of at most {largest}")
