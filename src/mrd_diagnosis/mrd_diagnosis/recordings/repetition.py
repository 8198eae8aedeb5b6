"""Repetition: which runs repeat each other, and after which period a run repeats itself."""

import numpy as np
from numpy.typing import NDArray

from mrd_runs.signals.current import current_noise
from mrd_runs.signals.smoothed_run import SmoothedRun

Array = NDArray[np.float64]

TOLERANCE = 0.005
"""Share of their span by which motions and currents may differ (rms, apart from noise) and still count as the same."""

CLOCK_TOLERANCE = 0.1
"""Share of the sampling interval by which the sampling instants may differ."""

LENGTH_TOLERANCE = 0.01
"""Share of the samples by which a run may be longer than its repeat: no recorder ends at the same sample twice."""

LEAST_SAMPLES = 96
"""Samples of a run, at least, in which a period is looked for."""


def runs_repeat(smoothed: SmoothedRun, other: SmoothedRun) -> bool:
    """Whether two different runs have the same motion and current at the same times, as long as both last."""
    run, again = smoothed.run, other.run
    n = min(len(run), len(again))
    if max(len(run), len(again)) - n > LENGTH_TOLERANCE * n:
        return False
    if np.abs(run.time[:n] - again.time[:n]).max() > CLOCK_TOLERANCE / run.rate:
        return False
    if np.array_equal(run.force[:n], again.force[:n]):
        return False
    noise = current_noise(run.current)
    return _same(run.current[:n], again.current[:n], noise, np.abs(run.current).max()) and _same(
        smoothed.motion.position[:n], other.motion.position[:n], smoothed.motion.position_noise, np.ptp(run.position)
    )


def repeating_period(smoothed: SmoothedRun) -> float | None:
    """Return the period in s after which motion and current of a run repeat, at least three times; None without one."""
    run, motion = smoothed.run, smoothed.motion
    n, interval = len(run), float(np.median(np.diff(run.time)))
    if n < LEAST_SAMPLES or np.abs(np.diff(run.time) - interval).max() > CLOCK_TOLERANCE * interval:
        return None
    position = motion.position - motion.position.mean()
    lags = np.arange(1, n // 3 + 1)
    spectrum = np.fft.rfft(position, 2 * n)
    products = np.fft.irfft(np.abs(spectrum) ** 2, 2 * n)[lags]
    squares = np.cumsum(position**2)
    # Mean square of x(t + lag) - x(t).
    change = (squares[n - 1 - lags] + squares[-1] - squares[lags - 1] - 2 * products) / (n - lags)
    tolerance = (TOLERANCE * float(np.ptp(position)) + 2.0 * motion.position_noise) ** 2
    rises = np.flatnonzero(change > float(np.var(position)))
    noise = current_noise(run.current)
    for k in range(int(rises[0]) if len(rises) else n, len(lags) - 1):
        if change[k] <= min(change[k - 1], change[k + 1], tolerance):
            lag = int(lags[k])
            if _same(run.current[lag:], run.current[:-lag], noise, np.abs(run.current).max()):
                left, middle, right = change[k - 1 : k + 2]
                return interval * (lag + 0.5 * float(left - right) / float(left - 2 * middle + right))
    return None


def _same(series: Array, other: Array, noise: float, span: float) -> bool:
    """Whether two series (n,) differ by no more than noise and tolerance."""
    return bool(np.sqrt(np.mean((series - other) ** 2)) <= TOLERANCE * span + 2.0 * noise)
