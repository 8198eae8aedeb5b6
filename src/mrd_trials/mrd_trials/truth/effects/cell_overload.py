"""The load cell bends against its overload stop."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, size

Array = NDArray[np.float64]

ROOT, TANGENT, STOP = range(3)

STOP_SHARE, SEATING = 0.7, 0.2
"""Share of the load that a stop takes beyond the limit, and over which share of the limit it seats."""

OVERLOAD = size("overload", 0.0015, 0.006)
"""One over the largest reading (1/N), or over the load at which the stop touches."""

EFFECT = TrueEffect(
    "cell_overload",
    "Load cell bends against its overload stop",
    (
        development("root", "fourth root of powers: stiffens with its load", OVERLOAD),
        development("tangent", "hyperbolic tangent: stiffens early", OVERLOAD),
        evaluation("stop", "a stop takes a part of what is beyond it", OVERLOAD),
    ),
    in_catalogue=False,
)


def overloaded_reading(p: PlantValues, force: Array) -> Array:
    """Return the reading of a load cell that stiffens with its load."""
    overload = p.cell_overload_overload
    if overload == 0.0:
        return force
    load = overload * force
    if p.cell_overload_formula == TANGENT:
        return np.asarray(np.tanh(load) / overload)
    if p.cell_overload_formula == STOP:
        beyond = np.abs(load) - 1.0
        touched = 0.5 * (beyond + np.hypot(beyond, SEATING)) - 0.5 * (np.hypot(1.0, SEATING) - 1.0)
        return np.asarray(np.sign(force) * (np.abs(load) - STOP_SHARE * touched) / overload)
    return np.asarray(force / np.sqrt(np.sqrt(1.0 + load**4)))
