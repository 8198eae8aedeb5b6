"""Flux follows the current late."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

DIFFUSION, INDUCTANCE, CHAINS = range(3)

MODES = np.array([1.0, 1 / 9, 1 / 25])
"""Weights of the modes of a slab over the first, and their time constants over the longest (odd modes only)."""

LAG = size("lag", 0.015, 0.06)

EFFECT = TrueEffect(
    "coil_lag",
    "Flux follows the current late",
    (
        development("diffusion", "eddy currents in a slab of iron, three modes (Stoll 1974)", LAG),
        development(
            "inductance",
            "inductance that falls with the current (Nehl, Fouad & Demerdash 1982)",
            LAG,
            shape("falling_current", 0.2, 0.8),
        ),
        evaluation(
            "chains",
            "particles form chains behind the flux: two lags (Koo, Goncalves & Ahmadian 2006)",
            LAG,
            shape("chain_share", 0.2, 0.5),
        ),
    ),
)


@njit(cache=True, nogil=True)
def lagged_current(p: PlantValues, current: Array, step: float, memory: Array) -> Array:
    """Return the current that acts behind eddy currents, inductance and chains.

    Parameters
    ----------
    p : PlantValues
    current : ndarray (samples,)
    step : float
        Sampling period in s.
    memory : ndarray (3,)
        Lagged currents; nan at the start; updated in place.
    """
    lag = p.coil_lag_lag
    if lag == 0.0:
        return current
    acting = np.empty_like(current)
    if np.isnan(memory[0]):
        memory[:] = current[0]
    diffusing = np.exp(-step / (lag * MODES))
    share = p.coil_lag_chain_share
    first, second = np.exp(-step / (lag * (1.0 - share))), np.exp(-step / (lag * share)) if share > 0.0 else 0.0
    for i in range(len(current)):
        towards = 0.5 * (current[max(i - 1, 0)] + current[i])
        if p.coil_lag_formula == CHAINS:
            before = memory[0]
            memory[0] = towards + first * (before - towards)
            middle = 0.5 * (before + memory[0])
            memory[1] = middle + second * (memory[1] - middle)
            acting[i] = memory[1]
        elif p.coil_lag_formula == INDUCTANCE:
            faster = 1.0 + abs(memory[0]) / p.coil_lag_falling_current
            memory[0] = towards + np.exp(-step / lag * faster) * (memory[0] - towards)
            acting[i] = memory[0]
        else:
            acting[i] = 0.0
            for k in range(3):
                memory[k] = towards + diffusing[k] * (memory[k] - towards)
                acting[i] += MODES[k] * memory[k] / MODES.sum()
    return acting
