"""Effects of sensing: from the force on the rod and its position to what is recorded."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from mrd_trials.truth.effects.true_effect import TrueEffect, size

Array = NDArray[np.float64]

MAINS = 50.0
"""Mains frequency in Hz."""

RATED = 0.025
"""Position in m at which the curve of the transducer is given."""

QUINTIC = 0.2
"""Share of a transducer's curve that grows with the fifth power of its reading; the rest grows with the third."""

EFFECTS = (
    TrueEffect(
        "lvdt_nonlinearity",
        "Gain and curve of the position transducer",
        (size("cubic", 0.02, 0.05, signed=True), size("gain", 0.02, 0.1, signed=True)),
    ),
    TrueEffect("load_cell_drift", "Zero of the load cell drifts", (size("drift", 0.02, 0.2, signed=True),), ("drift",)),
    TrueEffect("force_sensor_lag", "First-order lag of the force channel", (size("lag", 5e-3, 30e-3),), ("lag",)),
    TrueEffect("channel_delay", "Force channel comes late", (size("delay", 8.5e-3, 50e-3),), ("delay",)),
    TrueEffect("mains_hum", "Hum on the force channel", (size("amplitude", 2.0, 10.0),), ("amplitude",)),
    TrueEffect(
        "channel_crosstalk",
        "Other channels leak into the force",
        (size("from_position", 1000.0, 5000.0, signed=True), size("from_current", 20.0, 100.0, signed=True)),
    ),
)


def transducer_reading(cubic: float, gain: float, position: Array) -> Array:
    """Return the reading of a transducer at a position; its error grows with the reading."""
    reading = position.copy()
    for _ in range(30):  # the iteration contracts: the error is below a fifth of the reading
        square = (reading / RATED) ** 2
        reading = position / (1.0 + gain + cubic * square * (1.0 - QUINTIC + QUINTIC * square))
    return reading


def lagged(lag: float, signal: Array, step: float) -> Array:
    """Return a signal behind a first-order lag, exactly for a polygon; the lag begins at rest."""
    if lag == 0.0:
        return signal
    keep = np.exp(-step / lag)
    late = (1.0 - keep) * lag / step  # share of the step by which a ramp lags behind
    return np.asarray(lfilter([1.0 - late, late - keep], [1.0, -keep], signal, zi=[late * signal[0]])[0])
