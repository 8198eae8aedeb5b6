"""Odd multisines: noise, even and odd nonlinear distortion of the force."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from mrd_base import InputError
from mrd_runs import Run
from mrd_runs.text import named_run

Array = NDArray[np.float64]

LEAST_EXCITATION = 1e-4
"""Mean square of the speed, over that of the strongest line, above which a line is excited."""

ABOVE_SCATTER = 30.0
"""Mean square of the motion, over that of its scatter, above which a line is excited and not noise."""

MOST_EVEN = 0.1
"""Share of the excitation at even lines up to which a multisine counts as odd."""

HARMONICS = 3
"""Multiple of the highest excited line up to which distortion counts."""

LEAST_SAMPLES = 8
"""Samples of a period, at least."""


@dataclass(frozen=True)
class Distortion:
    """Levels in N rms of the force apart from the response of a linear damper to an odd multisine.

    Attributes
    ----------
    noise : float
        Noise of one period, from the scatter between periods.
    even : float
        Level at the even lines, which a damper with an odd characteristic leaves empty, without noise.
    odd : float
        Level at the odd lines that are not excited, without noise; nan where all are excited.
    excited : int
        Number of excited lines: one for a sine.
    periods : int
        Number of periods that were compared.
    highest : float
        Highest frequency in Hz: three times the highest excited line, where the sample rate allows.
    """

    noise: float
    even: float
    odd: float
    excited: int
    periods: int
    highest: float


def distortion(run: Run, period: float) -> Distortion:
    """Return noise, even and odd distortion of the force under an odd multisine (Pintelon and Schoukens 2012, ch. 4).

    Parameters
    ----------
    run : Run
        Only its last whole periods count.
    period : float
        Period in s; its inverse is the spacing of the lines.

    Raises
    ------
    InputError
        For fewer than two periods, or a motion that is no multisine of odd lines.
    """
    periods = int((run.duration + 1.5 / run.rate) / period)
    samples = round(period * run.rate)
    if periods < 2 or samples < LEAST_SAMPLES:
        raise InputError(
            f"{named_run(run.name)}: {run.duration:.4g} s at {run.rate:.4g} Hz hold {periods} periods of {period:.4g} s, "
            f"expected at least two, of {LEAST_SAMPLES} samples or more"
        )
    times = run.time[-1] + 1 / run.rate - period * periods + np.arange(periods * samples) * (period / samples)

    def lines(series: Array) -> tuple[Array, Array]:
        """Return the mean squares of the mean over periods and of the scatter of one period, by line."""
        by_period = CubicSpline(run.time, series)(times).reshape(periods, samples)
        spectra = np.fft.rfft(by_period, axis=1) * (np.sqrt(2.0) / samples)
        return np.abs(spectra.mean(axis=0)) ** 2, np.asarray(spectra.var(axis=0, ddof=1))

    motion, motion_scatter = lines(run.position)
    line = np.arange(len(motion))
    speed = motion * line**2
    excited = (
        (speed > LEAST_EXCITATION * speed[1:].max())
        & (motion > ABOVE_SCATTER * np.mean(motion_scatter) / periods)
        & (line > 0)
    )
    if not excited.any() or np.sum(speed[excited & (line % 2 == 0)]) > MOST_EVEN * np.sum(speed[excited]):
        raise InputError(
            f"{named_run(run.name)}: found a motion with lines other than odd multiples of 1/{period:.4g} s, "
            "expected an odd multisine with this period_s"
        )
    response, scatter = lines(run.force)
    considered = (line > 0) & (line <= min(HARMONICS * int(line[excited].max()), (samples - 1) // 2))
    without_noise = response - scatter / periods
    even, odd = (considered & ~excited & (line % 2 == parity) for parity in (0, 1))
    return Distortion(
        noise=float(np.sqrt(scatter[line > 0].sum())),
        even=float(np.sqrt(max(without_noise[even].sum(), 0.0))),
        odd=float(np.sqrt(max(without_noise[odd].sum(), 0.0))) if odd.any() else float("nan"),
        excited=int(excited.sum()),
        periods=periods,
        highest=float(line[considered].max() / period),
    )
