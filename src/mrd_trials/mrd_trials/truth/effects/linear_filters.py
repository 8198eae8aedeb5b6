"""Linear filters that several effects of the signal chain use, exact for a polygon."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter, lfilter_zi

Array = NDArray[np.float64]


def lagged(lag: float, signal: Array, step: float) -> Array:
    """Return a signal behind a first-order lag; the lag begins at rest."""
    if lag == 0.0:
        return signal
    keep = np.exp(-step / lag)
    late = (1.0 - keep) * lag / step  # share of the step by which a ramp lags behind
    return np.asarray(lfilter([1.0 - late, late - keep], [1.0, -keep], signal, zi=[late * signal[0]])[0])


def second_order(frequency: float, damping: float, signal: Array, step: float) -> Array:
    """Return a signal behind a resonance of second order; a steady signal passes unchanged, and it begins at rest."""
    w = 2 * np.pi * frequency
    return filtered([w * w], [1.0, 2 * damping * w, w * w], signal, step)


def filtered(numerator: list[float], denominator: list[float], signal: Array, step: float) -> Array:
    """Return a signal behind a transfer function of the Laplace variable, given by its coefficients; it begins at rest."""
    b, a, _ = cont2discrete((numerator, denominator), step, method="foh")
    b = np.ravel(b)
    return np.asarray(lfilter(b, a, signal, zi=lfilter_zi(b, a) * signal[0])[0])
