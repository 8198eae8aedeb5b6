"""Times that begin again: times of day at midnight, and counters of a limited number of bits."""

import numpy as np
from numpy.typing import NDArray

from mrd_runs.importing.clocks import usual_step

Array = NDArray[np.float64]

_PERIODS_OF_DAY = (86400.0, 43200.0, 3600.0, 60.0)
_BITS = (8, 10, 12, 14, 15, 16, 20, 24, 31, 32)
_FEWEST_BITS = 16
"""Bits of a counter whose single jump back is a wrap; that of a shorter one has to come again, since runs are short, too."""
_SLACK = 3.0  # usual steps from one count to the next over the jump


def unwrap(time: Array, *, of_day: bool) -> tuple[Array, str]:
    """Return times that go on where they began again, and a clause about it; "" where nothing was changed.

    Parameters
    ----------
    time : ndarray (n,)
        As the file has it.
    of_day : bool
        Whether they are times of day in s; else only whole numbers are those of a counter.
    """
    if not np.isfinite(time).all():
        return time, ""
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if not len(back) or not (of_day or np.array_equal(time, np.rint(time))):
        return time, ""
    fewest = _FEWEST_BITS if len(back) == 1 else _BITS[0]
    periods = _PERIODS_OF_DAY if of_day else [float(2**bits) for bits in _BITS if bits >= fewest]
    step = usual_step(time)
    for period in periods:
        after = steps[back] + period
        if np.all((after > 0) & (after <= _SLACK * step)):
            begins = np.zeros(len(time))
            begins[back + 1] = period
            name = f"after {period / 3600:g} h" if of_day and period >= 3600 else f"after {period:g}"
            return time + np.cumsum(begins), f"the times begin again {name} and were continued"
    return time, ""
