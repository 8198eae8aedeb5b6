"""How well an actuator follows the emulated motion, by the three numbers of the RTHS benchmark problem."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_DELAY = 0.2
"""s, up to which a delay is looked for."""


@dataclass(frozen=True)
class Tracking:
    """Tracking of a wanted motion: Silva et al., Mech. Syst. Signal Process. 135 (2020) 106381, criteria J1 to J3.

    Attributes
    ----------
    delay : float
        s, at which the correlation of wanted and measured position is largest; > 0: the rod is late.
    nrms : float
        rms error over rms of the wanted position.
    peak : float
        Largest error over largest wanted position.
    """

    delay: float
    nrms: float
    peak: float


def tracking(wanted: Array, measured: Array, period: float) -> Tracking:
    """Return the tracking of positions (n,) in m sampled every ``period`` in s.

    The benchmark problem gives the delay in whole samples; here a parabola through the largest correlation and its
    neighbours resolves parts of a sample.
    """
    error = measured - wanted
    return Tracking(
        correlation_delay(wanted, measured, period),
        float(np.sqrt(np.mean(error**2) / np.mean(wanted**2))),
        float(np.abs(error).max() / np.abs(wanted).max()),
    )


def correlation_delay(wanted: Array, measured: Array, period: float) -> float:
    """Return the delay in s of ``measured`` after ``wanted``, at the largest correlation."""
    n = len(wanted)
    most = min(int(MOST_DELAY / period), n // 4)
    middle = slice(most, n - most)
    shifts = np.arange(-most, most + 1)
    reference = measured[middle] - measured[middle].mean()
    errors = np.empty(len(shifts))
    for i, shift in enumerate(shifts):
        shifted = wanted[middle.start - shift : middle.stop - shift]
        shifted = shifted - shifted.mean()
        errors[i] = 1.0 - reference @ shifted / np.sqrt((reference @ reference) * (shifted @ shifted))
    best = int(np.clip(np.argmin(errors), 1, len(shifts) - 2))
    before, at, after = errors[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    return float(period * (shifts[best] + (0.5 * (before - after) / bend if bend > 0.0 else 0.0)))
