"""A measured coil current without the noise of its sensor, with its steps still sharp.

The noise of the sensor is white, or nearly so behind a filter. The current itself has constant levels with steps between
them, ramps, or slow waves. Each sample is therefore estimated by a constant, a line or a parabola through a window around it
(adaptive local polynomials: Katkovnik, Egiazarian and Astola 2006). Of all windows in which such a polynomial fits up to the
noise, the one with the least variance of the estimate is taken. Next to a step, this window lies on one side of it.
"""

import math
from collections.abc import Iterator
from functools import cache

import numpy as np
import scipy
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]

_FOURTH_DIFFERENCE = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
# Lengths of the windows in samples. Short ones start at every sample, long ones this many times in their length.
_SHORT, _LONG, _STARTS_PER_LENGTH = (3, 5, 7, 11, 15), (31, 63, 127, 255, 511, 1023), 8
# Probability that the test of the residual accepts a window in which the current is a line or parabola. A larger value would
# round curves more.
_ACCEPTED = 0.9
# In a long window the noise hides a curve from that test. A second test, of this many further terms of the polynomial, shows
# the curve; it accepts with this probability.
_HIGHER_TERMS, _ACCEPTED_LONG = 4, 0.5
# Single deviating samples are outliers when their share is smaller than this; otherwise the current switches that fast.
_LARGEST_OUTLIER_SHARE = 0.01
# Median magnitude of a standard normal variable.
_NORMAL_MEDIAN_MAGNITUDE = 0.6745


# Correlations of neighbouring samples that are told from none, and the largest of a noise that is uncorrelated beyond.
_LEAST_CORRELATION, _LARGEST_CORRELATION = 0.05, 0.35


def noise_correlation(current: Array) -> float:
    """Return the correlation of the noise of neighbouring samples of a measured current (n,).

    An anti-alias filter leaves some, which averages over many samples do not remove. Of fourth differences over one sampling
    interval the noise has the variance 70 - 112 r, over two and more 70. Where a current varies too fast to tell, the noise
    counts as white.
    """
    variances = []
    for stride in (1, 2, 3):
        taps = np.zeros(4 * stride + 1)
        taps[::stride] = _FOURTH_DIFFERENCE
        if len(current) <= len(taps):
            return 0.0
        variances.append(normal_deviation(np.convolve(current, taps, "valid")) ** 2)
    one, two, three = variances
    if not two > 0.0:
        return 0.0
    # Steps and waves of the current itself add to the variance, and more so over three intervals than over two.
    correlation = (1.0 - one * max(two, three) / two**2) * 70.0 / 112.0
    return min(correlation, _LARGEST_CORRELATION) if correlation >= _LEAST_CORRELATION else 0.0


def draw_current_noise(current: Array, rng: np.random.Generator, draws: int) -> Array:
    """Draw noise in A (draws, n) like that of a measured current (n,)."""
    correlation = noise_correlation(current)
    # A moving average over two samples has this correlation and none beyond.
    share = 2.0 * correlation / (1.0 + np.sqrt(1.0 - 4.0 * correlation**2))
    white = rng.normal(0.0, current_noise(current), (draws, len(current) + 1))
    return np.asarray((white[:, 1:] + share * white[:, :-1]) / np.sqrt(1.0 + share**2))


def current_noise(current: Array) -> float:
    """Return the standard deviation in A of the noise in a measured current (n,).

    It is estimated from the fourth differences, which contain hardly anything of ramps and slow waves. Their median is
    robust against outliers and steps. Where steps come every few samples, it is estimated from the first differences between
    steps. A current whose readings hardly ever change has no noise.
    """
    if len(current) < len(_FOURTH_DIFFERENCE):
        return 0.0
    fourth = np.convolve(current, _FOURTH_DIFFERENCE, "valid")
    correlation = noise_correlation(current)
    noise = normal_deviation(fourth) / math.sqrt(70.0 - 112.0 * correlation)
    changes = np.abs(np.diff(current))
    # At least a quarter of the changes are assumed to be noise.
    deviation = float(np.quantile(changes, 0.25))
    for _ in range(10 if deviation > 0.0 else 0):
        deviation = normal_deviation(changes[changes <= 4.0 * deviation])
    return min(noise, deviation / math.sqrt(2.0 - 2.0 * correlation)) if deviation > 0.0 else noise


def normal_deviation(values: Array) -> float:
    """Return the standard deviation of normally distributed values (n,) around 0, robust against outliers."""
    return float(np.median(np.abs(values)) / _NORMAL_MEDIAN_MAGNITUDE)


def steady_current(current: Array) -> Array:
    """Remove the noise of the sensor from a measured current without rounding its steps.

    Parameters
    ----------
    current : ndarray (n,)
        Measured current in A.

    Returns
    -------
    ndarray (n,)
        Current in A. Single outliers are removed, ramps and waves are not delayed, a current without noise is not changed.
    """
    current = np.asarray(current, np.float64)
    noise = current_noise(current)
    if noise <= 1e-6 * float(np.abs(current).max(initial=0.0)):
        return current.copy()
    readings = _without_outliers(current, noise)
    # What averages over many samples keep of a noise whose neighbours are correlated.
    slow_noise = noise * np.sqrt(1.0 + 2.0 * noise_correlation(current))
    estimate, variance = readings.copy(), np.ones(len(current))
    for length in _SHORT + _LONG:
        if length <= len(readings):
            for starts, basis, coefficients in _polynomials(readings, noise, slow_noise, length):
                _improve(starts, basis, coefficients, np.sum(basis**2, axis=1), estimate, variance)
    return estimate


def _polynomials(
    series: Array, noise: float, slow_noise: float, length: int
) -> Iterator[tuple[NDArray[np.intp], Array, Array]]:
    """Yield the constants, the lines, then the parabolas, of the windows of a length in which they fit.

    Each item is (starts (windows,), orthonormal polynomials (length, terms), their coefficients (windows, terms)).
    """
    starts = np.arange(0, len(series) - length + 1, 1 if length in _SHORT else length // _STARTS_PER_LENGTH)
    windows = sliding_window_view(series, length)[starts]
    # With orthonormal polynomials, every coefficient accounts for its square of the sum of squares.
    basis = _orthonormal_polynomials(length)
    coefficients = windows @ basis
    squares = np.einsum("ij,ij->i", windows, windows)
    for terms in (1, 2, 3):
        if terms == length:
            continue
        residual = squares - np.sum(coefficients[:, :terms] ** 2, axis=1)
        fits = residual <= noise**2 * scipy.special.chdtri(length - terms, 1.0 - _ACCEPTED)
        if length in _LONG:
            higher = np.sum(coefficients[:, terms : terms + _HIGHER_TERMS] ** 2, axis=1)
            fits &= higher <= slow_noise**2 * scipy.special.chdtri(_HIGHER_TERMS, 1.0 - _ACCEPTED_LONG)
        yield starts[fits], np.ascontiguousarray(basis[:, :terms]), coefficients[fits, :terms]


@cache
def _orthonormal_polynomials(length: int) -> Array:
    """Return polynomials (length, terms) of rising order over a window of a length in samples."""
    powers = np.vander(np.linspace(-1.0, 1.0, length), min(3 + _HIGHER_TERMS, length), increasing=True)
    return np.linalg.qr(powers)[0]


@njit(cache=True, nogil=True)
def _improve(starts, basis, coefficients, new_variance, estimate, variance):  # type: ignore[no-untyped-def]
    """Replace ``estimate`` by the values of the polynomials where these have a smaller ``variance``.

    Variances are in units of the variance of the noise.
    """
    length, terms = basis.shape
    for window, start in enumerate(starts):
        for place in range(length):
            if new_variance[place] < variance[start + place]:
                value = 0.0
                for term in range(terms):
                    value += coefficients[window, term] * basis[place, term]
                estimate[start + place] = value
                variance[start + place] = new_variance[place]


def _without_outliers(current: Array, noise: float) -> Array:
    """Replace samples that differ from their two neighbours on either side by more than these differ from each other.

    Where there are many of them, the current itself switches for single samples, and none is replaced.
    """
    padded = np.pad(current, 2, mode="edge")
    neighbours = np.sort([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    median = (neighbours[1] + neighbours[2]) / 2
    outlier = np.abs(current - median) > 3.0 * noise + (neighbours[3] - neighbours[0])
    outlier[[0, -1]] = False
    return np.where(outlier, median, current) if outlier.mean() < _LARGEST_OUTLIER_SHARE else current.copy()
