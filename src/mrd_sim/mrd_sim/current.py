"""From measured current to the coefficients of a model."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def lagged_current(lag: float, state: Array, dt: Array, current: Array) -> Array:
    """Effective current u in A after a first-order lag, u' = (I - u) / lag, exact for I linear between vertices.

    ``state`` holds u and I at the previous vertex and is updated; ``lag`` in s, 0 passes the current through.
    """
    effective = np.empty_like(current)
    u, before = state[0], state[1]
    for k in range(len(current)):
        now = current[k]
        if lag <= 0.0:
            u = now
        elif dt[k] > 0.0:
            rise = (now - before) / dt[k] * lag
            u = now - rise + (u - before + rise) * np.exp(-dt[k] / lag)
        effective[k] = u
        before = now
    state[0], state[1] = u, before
    return effective


@njit(cache=True, nogil=True)
def affine_rows(theta: Array, at_zero: NDArray[np.intp], slope: NDArray[np.intp], current: Array) -> Array:
    """Coefficients (m, quantities) on the vertices: theta[at_zero] + theta[slope] u; a slope index -1 means constant."""
    rows = np.empty((len(current), len(at_zero)))
    for j in range(len(at_zero)):
        a = theta[at_zero[j]]
        b = theta[slope[j]] if slope[j] >= 0 else 0.0
        for k in range(len(current)):
            rows[k, j] = a + b * current[k]
    return rows
