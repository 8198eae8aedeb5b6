"""Numbers that stand for a missing value, such as -9999: programs write them where a sensor gave nothing."""

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError

Array = NDArray[np.float64]

_FAR = 3.0
"""Distance from all other values, over the largest of them, that no sensor jumps to and back."""
_NINES = re.compile(r"-?9{3,}(\.9+|\.25)?")
_FILLS = (2**15, 2**15 - 1, 2**16 - 1, 2**31, 2**31 - 1, 2**32 - 1)
"""Magnitudes at the ends of whole numbers, which loggers fill with."""
_LARGEST = 1e20
"""Magnitude above which a number measures nothing."""


def missing_number(values: Array) -> float | None:
    """Return the number that stands for missing values in a channel (n,); None where none does.

    It lies far outside of all others, and is one of those that programs use for this. Values are those of the file, in its
    unit.
    """
    finite = values[np.isfinite(values)]
    for number in (float(finite.min()), float(finite.max())) if len(finite) else ():
        if not _means_missing(number):
            continue
        others = finite[finite != number]
        if len(others) and _distance(number, others) > _FAR * float(np.abs(others).max()):
            return number
    return None


def check_missing(values: Array, name: str, where: str, place: Callable[[int], str]) -> None:
    """Refuse a channel in which one number stands for missing values; see `missing_number`.

    Parameters
    ----------
    values : ndarray (n,)
    name : str
        Of the channel.
    where : str
        Prefix of the error message.
    place : callable
        Returns how the message names the sample of an index.

    Raises
    ------
    InputError
        With the number, the first of the samples that have it, and the range of all others.
    """
    number = missing_number(values)
    if number is None:
        return
    found = np.flatnonzero(values == number)
    others = values[np.isfinite(values) & (values != number)]
    samples = "1 sample" if len(found) == 1 else f"{len(found)} samples"
    raise InputError(
        f"{where}: {place(int(found[0]))}: {name} is {number:.9g}, as in {samples}, and all others lie between "
        f"{others.min():.4g} and {others.max():.4g}; such a number stands for a missing value. Remove these samples"
    )


def _distance(number: float, others: Array) -> float:
    return max(float(others.min()) - number, number - float(others.max()))


def _means_missing(number: float) -> bool:
    return abs(number) > _LARGEST or abs(number) in _FILLS or bool(_NINES.fullmatch(f"{number:.9g}"))
