"""Iron remembers the current."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

Array = NDArray[np.float64]

DUHEM, JILES_ATHERTON, BOUC_WEN = range(3)

REVERSAL = 2.0
"""Change of current over which a Duhem loop is crossed, in half widths; below 2, the loop would bulge backwards."""

HALF_WIDTH = size("half_width", 0.04, 0.12)

EFFECT = TrueEffect(
    "magnetic_hysteresis",
    "Iron remembers the current",
    (
        development("duhem", "magnetisation relaxes towards the side of the change (Coleman & Hodgdon 1986)", HALF_WIDTH),
        development(
            "jiles_atherton", "walls are pinned until they bend back (Jiles & Atherton 1986, Deane 1994)", HALF_WIDTH
        ),
        evaluation("bouc_wen", "loop with a sharp knee, exponent 2 (Wen 1976)", HALF_WIDTH),
    ),
)


@njit(cache=True, nogil=True)
def remanent_current(p: PlantValues, current: Array, memory: Array) -> Array:
    """Return the current that acts behind the loop of the iron.

    Parameters
    ----------
    p : PlantValues
    current : ndarray (samples,)
    memory : ndarray (2,)
        Lag of the magnetisation in half widths (-1 to 1) and the current before; nan at the start; updated in place.
    """
    width = p.magnetic_hysteresis_half_width
    if width == 0.0:
        return current
    acting = np.empty_like(current)
    if np.isnan(memory[0]):
        memory[0], memory[1] = 0.0, current[0]
    for i in range(len(current)):
        change = (current[i] - memory[1]) / width
        lag, side = memory[0], 1.0 if change > 0.0 else -1.0
        if p.magnetic_hysteresis_formula == JILES_ATHERTON:
            free = -min(side * lag, 0.0)  # change that only bends the walls back
            lag += side * min(abs(change), free)
            rest = max(abs(change) - free, 0.0)
            lag = side + (lag - side) * np.exp(-rest) if rest > 0.0 else lag
        elif p.magnetic_hysteresis_formula == BOUC_WEN:
            free = -min(side * lag, 0.0)
            lag += side * min(abs(change), free)
            turned = np.tanh(max(abs(change) - free, 0.0))
            if turned > 0.0:
                lag = side * (side * lag + turned) / (1.0 + side * lag * turned)
        else:
            lag = side + (lag - side) * np.exp(-abs(change) / REVERSAL)
        memory[0], memory[1] = lag, current[i]
        acting[i] = max(current[i] - width * lag, 0.0)
    return acting
