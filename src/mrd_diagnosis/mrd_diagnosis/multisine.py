"""Odd multisines: how much of the force is noise, how much even and odd distortion."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mrd_base import InputError
from mrd_runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Distortion:
    """What the force holds beside the answer of a linear damper to an odd multisine: N rms.

    Attributes
    ----------
    noise : float
        In one period, from the scatter between periods.
    even : float
        At the even lines, which an odd damper leaves empty; noise taken off.
    odd : float
        At the odd lines that are not excited; noise taken off. Nan where all are.
    periods : int
        How many of them were compared.
    highest : float
        Hz, up to which was looked: three times the highest excited line, where the sample rate allows.
    """

    noise: float
    even: float
    odd: float
    periods: int
    highest: float


def distortion(run: Run, period: float) -> Distortion:
    """Levels of noise, even and odd distortion in the force under an odd multisine (Pintelon and Schoukens 2012, ch. 4).

    Parameters
    ----------
    run : Run
        Its last whole periods count.
    period : float
        s; the inverse spaces the lines.

    Raises
    ------
    InputError
        For fewer than two periods, or a motion that is no multisine of odd lines.
    """
    periods = int((run.duration + 1.5 / run.rate) / period)
    samples = round(period * run.rate)
    if periods < 2 or samples < 8:
        raise InputError(
            f"run {run.name}: {run.duration:.4g} s at {run.rate:.4g} Hz hold {periods} periods of {period:.4g} s, "
            "expected at least two, of 8 samples or more"
        )
    times = run.time[-1] + 1 / run.rate - period * periods + np.arange(periods * samples) * (period / samples)

    def lines(series: Array) -> tuple[Array, Array]:
        """Mean squares (N²) of the mean over periods and of the scatter of one, by line."""
        shaped = CubicSpline(run.time, series)(times).reshape(periods, samples)
        spectra = np.fft.rfft(shaped, axis=1) * (np.sqrt(2.0) / samples)
        return np.abs(spectra.mean(axis=0)) ** 2, np.asarray(spectra.var(axis=0, ddof=1))

    moved, wander = lines(run.position)
    line = np.arange(len(moved))
    speed = moved * line**2
    excited = (speed > 1e-4 * speed[1:].max()) & (moved > 30 * np.mean(wander) / periods) & (line > 0)
    if not excited.any() or np.sum(speed[excited & (line % 2 == 0)]) > 0.1 * np.sum(speed[excited]):
        raise InputError(
            f"run {run.name}: its motion has no odd lines of 1/{period:.4g} s alone, expected a multisine of that period_s"
        )
    answer, scatter = lines(run.force)
    inside = (line > 0) & (line <= min(3 * int(line[excited].max()), (samples - 1) // 2))
    rest = answer - scatter / periods
    even, odd = (inside & ~excited & (line % 2 == parity) for parity in (0, 1))
    return Distortion(
        noise=float(np.sqrt(scatter[line > 0].sum())),
        even=float(np.sqrt(max(rest[even].sum(), 0.0))),
        odd=float(np.sqrt(max(rest[odd].sum(), 0.0))) if odd.any() else float("nan"),
        periods=periods,
        highest=float(line[inside].max() / period),
    )
