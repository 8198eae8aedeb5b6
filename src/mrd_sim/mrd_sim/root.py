"""One step of a search for a root that always ends."""

from typing import Any

from numba import njit


@njit(cache=True, nogil=True)
def next_iterate(at: Any, step: Any, low: float, high: float, last: float) -> tuple[Any, float]:
    """Return the next point of a search for a root between ``low`` and ``high``, and the size of the step to it.

    It is Newton's step where that stays in the bracket and is less than half the ``last`` one. Else it is the middle of the
    bracket, because Newton's method alone may go to and fro over a kink for ever.
    """
    if low < (at + step).real < high and 2.0 * abs(step.real) < last:
        return at + step, abs(step.real)
    return 0.5 * (low + high) + 0.0 * at, 0.5 * (high - low)
