"""Low-pass filters that recordings are processed with."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Kind = Literal["none", "first_order", "second_order", "zero_phase", "moving_average", "unknown"]

_WINDOW = 0.4429
"""Cut-off of a moving average times its window: sinc(0.4429) = 1 / sqrt(2)."""


@dataclass(frozen=True)
class LowPass:
    """A low-pass filter.

    Attributes
    ----------
    kind : str
        ``first_order`` and ``second_order`` (Butterworth) filters delay the signal, as filters of instruments do. A
        ``zero_phase`` filter (second-order Butterworth, forwards and backwards) and a ``moving_average`` do not.
        ``unknown`` where only the cut-off is known.
    cutoff : float
        Frequency in Hz at which the signal is lowered by 3 dB.
    delay : float
        Further delay in s; half the window for a moving average of past samples.
    """

    kind: Kind
    cutoff: float
    delay: float = 0.0

    @property
    def window(self) -> float:
        """Length in s of the moving average with this cut-off."""
        return _WINDOW / self.cutoff

    def response(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the complex factor (n,) of oscillations with these frequencies in Hz, without the further delay."""
        relative = frequency / self.cutoff
        if self.kind == "first_order":
            return np.asarray(1 / (1 + 1j * relative), np.complex128)
        if self.kind == "second_order":
            return np.asarray(1 / (1 + np.sqrt(2) * 1j * relative - relative**2), np.complex128)
        if self.kind == "zero_phase":
            return np.asarray(1 / (1 + (np.sqrt(2) - 1) * relative**4), np.complex128)
        if self.kind == "moving_average":
            return np.asarray(np.sinc(frequency * self.window), np.complex128)
        return np.ones(len(frequency), np.complex128)


def moving_average(window: float, delay: float = 0.0) -> LowPass:
    """Return the filter that averages over a window in s."""
    return LowPass("moving_average", _WINDOW / window, delay)
