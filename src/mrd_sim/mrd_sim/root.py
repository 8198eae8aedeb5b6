"""A search for a root that always ends."""

from typing import Any

from numba import njit


@njit(cache=True, nogil=True)
def settled(at: Any, step: Any, low: float, high: float, last: float) -> tuple[Any, float]:
    """Next point of a search for a root between ``low`` and ``high``, and the size of the step to it.

    Newton's step, or bisection wherever that leaves the bracket or is not half the ``last``: it may go to and fro over a
    kink.
    """
    if low < (at + step).real < high and 2.0 * abs(step.real) < last:
        return at + step, abs(step.real)
    return 0.5 * (low + high) + 0.0 * at, 0.5 * (high - low)
