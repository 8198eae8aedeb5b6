"""Zero of the load cell drifts."""

import numpy as np
from numpy.typing import NDArray

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

Array = NDArray[np.float64]

WARM_UP, CREEP, DRAUGHT = range(3)

DRIFT = size("drift", 0.02, 0.2, signed=True)
"""Rate in N/s at the start of the session, or the largest one."""

EFFECT = TrueEffect(
    "load_cell_drift",
    "Zero of the load cell drifts",
    (
        development(
            "warm_up", "exponential approach while the amplifier warms up", DRIFT, shape("warm_up_time", 80.0, 400.0)
        ),
        development(
            "creep", "logarithm of the time since the load was put on (Andrade 1910)", DRIFT, shape("creep_time", 20.0, 80.0)
        ),
        evaluation(
            "draught", "the temperature of the room swings", DRIFT, shape("period", 80.0, 300.0), shape("phase", -1.0, 1.0)
        ),
    ),
)


def drift_force(p: PlantValues, time: Array) -> Array:
    """Return the zero (N) of the load cell at times (s) since the start of the session."""
    if p.load_cell_drift_formula == CREEP:
        hardened = p.load_cell_drift_creep_time or 1.0
        drifted = hardened * np.log1p(time / hardened)
    elif p.load_cell_drift_formula == DRAUGHT:
        turn = 2 * np.pi / (p.load_cell_drift_period or 1.0)
        drifted = (np.sin(turn * time + p.load_cell_drift_phase) - np.sin(p.load_cell_drift_phase)) / turn
    else:
        warm = p.load_cell_drift_warm_up_time or 1.0
        drifted = -warm * np.expm1(-time / warm)
    return np.asarray(p.load_cell_drift_drift * drifted)
