"""Conditions on which an experiment with repeats ends before its last pass."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError, quantity

Array = NDArray[np.float64]

COMPARED_PASSES = 3
"""Number of passes in which the force must have settled: two could agree by chance."""
FEWEST_PASSES = COMPARED_PASSES + 1
"""Number of passes that an experiment with a condition needs at least."""

_KELVIN = 273.15  # 0 °C in K


@dataclass(frozen=True)
class Until:
    """Conditions on which an experiment ends with the pass that runs; one of them is enough.

    Attributes
    ----------
    temperature : float or None
        In °C, as people write it; samples are in K.
    settled : float or None
        Largest change of the peak force from one pass to the next, as a share of the peak force.
    """

    temperature: float | None = quantity(None, "degC", "of the damper, from which on it is warm", lower=-100, upper=300)
    settled: float | None = quantity(
        None, "percent", "change of the peak force from pass to pass, below which it has settled", lower=1e-6, upper=1
    )

    def __post_init__(self) -> None:
        if self.temperature is None and self.settled is None:
            raise InputError("until has no condition; give temperature_degC, settled_percent or both")


def settling(peaks: Sequence[float]) -> float:
    """Return the largest change of the peak force between two of the latest passes, as a share of the latest peak.

    Parameters
    ----------
    peaks : sequence of float
        Largest magnitude of the force in N in each pass, in their order.

    Returns
    -------
    float
        Over the latest `COMPARED_PASSES` passes; inf before there are so many, or without a force.
    """
    latest = np.asarray(peaks[-COMPARED_PASSES:], dtype=float)
    if len(latest) < COMPARED_PASSES or not latest[-1] > 0:
        return math.inf
    return float(np.abs(np.diff(latest)).max() / latest[-1])


def latest_temperature(temperature: Array) -> float:
    """Return the latest known value of a series of temperatures (n,) in K, where nan is unknown; nan without one."""
    known = temperature[np.isfinite(temperature)]
    return float(known[-1]) if len(known) else math.nan


class PassMonitor:
    """Collects what the samples show of each pass of an experiment, and tells when a condition holds.

    Parameters
    ----------
    until : Until
    begin : float
        Bench time in s at which the first pass begins.
    period, duration : float
        Time in s from the start of one pass to the start of the next, and of one pass.
    """

    def __init__(self, until: Until, begin: float, period: float, duration: float) -> None:
        self._until, self._begin, self._period, self._duration = until, begin, period, duration
        self._peaks = [0.0]  # of each pass so far; the last one is not complete
        self._temperature = math.nan

    def add(self, time: Array, force: Array, temperature: Array) -> str:
        """Add samples in the order of time; return why the experiment ends, or "" where it goes on.

        Conditions are looked at whenever a pass is complete.

        Parameters
        ----------
        time, force, temperature : ndarray (n,)
            Bench time in s, force in N, and temperature of the damper in K, nan where it is unknown.
        """
        number, time_in_pass = np.divmod(time - self._begin, self._period)
        reason = ""
        for index in np.unique(number[number >= 0]).astype(int):
            if index >= len(self._peaks):
                reason = reason or self._reason()
                self._peaks += [0.0] * (index + 1 - len(self._peaks))
            here = number == index
            peak = np.abs(force[here & (time_in_pass <= self._duration)]).max(initial=0.0)
            self._peaks[index] = max(self._peaks[index], float(peak))
            known = latest_temperature(temperature[here])
            self._temperature = self._temperature if math.isnan(known) else known
        return reason

    def _reason(self) -> str:
        """Return which condition holds after the passes so far, or ""."""
        passes, warm, limit = len(self._peaks), self._until.temperature, self._until.settled
        if warm is not None and self._temperature >= warm + _KELVIN:
            return f"the damper had {self._temperature - _KELVIN:.1f} °C after {passes} passes, expected {warm:g} °C"
        if limit is not None and (change := settling(self._peaks)) < limit:
            return (
                f"the peak force settled after {passes} passes: it changed by {100 * change:.3g} % between the last "
                f"{COMPARED_PASSES}, expected less than {100 * limit:.3g} %"
            )
        return ""
