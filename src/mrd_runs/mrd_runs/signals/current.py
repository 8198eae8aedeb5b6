"""A measured coil current without its sensor's noise, its steps left sharp.

The sensor's noise is white; the current itself is levels with steps between them, ramps, or slow waves. So every sample is
read off the line or parabola through a stretch around it: of all stretches that are so but for noise, the one that leaves
least of it (adaptive local polynomials: Katkovnik, Egiazarian and Astola 2006). Beside a step, it lies on one side of it.
"""

from collections.abc import Iterator

import numpy as np
from numba import njit
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]

_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
# Samples of the stretches: short ones at every place, long ones at so many places a length.
_SHORT, _LONG, _PLACES = (3, 5, 7, 11, 15), (31, 63, 127, 255), 8
# Share of the stretches that truly are lines or parabolas and are taken for such: a stricter test rounds curves less. In
# long ones a curve hides in the noise, unless it is looked for where it shows: in the next terms of the polynomial.
_ACCEPTED, _HIGHER, _ACCEPTED_LONG = 0.9, 4, 0.5
# Share of the samples below which what stands out alone is an outlier.
_FEW = 0.01


def current_noise(current: Array) -> float:
    """Standard deviation in A of the white noise in a measured current (n,).

    From its fourth differences, whose median is blind to outliers and steps, their order to waves and ramps; or, where steps
    come every few samples, from those first differences that have none. A reading that hardly ever changes has none.
    """
    if len(current) < len(_FOURTH):
        return 0.0
    noise = normal_deviation(np.convolve(current, _FOURTH, "valid")) / float(np.linalg.norm(_FOURTH))
    change = np.abs(np.diff(current))
    # At least a quarter of the changes are taken to be noise.
    quiet = float(np.quantile(change, 0.25))
    for _ in range(10 if quiet > 0.0 else 0):
        quiet = normal_deviation(change[change <= 4.0 * quiet])
    return min(noise, quiet / np.sqrt(2.0)) if quiet > 0.0 else noise


def normal_deviation(values: Array) -> float:
    """Standard deviation of a normal variable (n,) with outliers; 0.6745 is the median of a standard one's magnitude."""
    return float(np.median(np.abs(values)) / 0.6745)


def steady_current(current: Array) -> Array:
    """Take the sensor's noise off a measured current without rounding its steps.

    Parameters
    ----------
    current : ndarray (n,)
        A, as measured.

    Returns
    -------
    ndarray (n,)
        A. Isolated outliers are gone, ramps and waves are not delayed, and a current without noise comes back as it is.
    """
    current = np.asarray(current, np.float64)
    noise = current_noise(current)
    if noise <= 1e-6 * float(np.abs(current).max(initial=0.0)):
        return current.copy()
    found = _without_outliers(current, noise)
    cleaned, left = found.copy(), np.ones(len(current))
    for length in _SHORT + _LONG:
        if length <= len(cleaned):
            for starts, basis, coefficients in _polynomials(cleaned, noise, length):
                _take(starts, basis, coefficients, np.sum(basis**2, axis=1), found, left)
    return found


def _polynomials(series: Array, noise: float, length: int) -> Iterator[tuple[NDArray[np.intp], Array, Array]]:
    """Lines, then parabolas, through the stretches of a length where they hold.

    Each is (starts (stretches,), orthonormal polynomials (length, terms), their coefficients (stretches, terms)).
    """
    starts = np.arange(0, len(series) - length + 1, 1 if length in _SHORT else length // _PLACES)
    stretches = sliding_window_view(series, length)[starts]
    # Orthonormal, so that each takes its share of the squares.
    powers = np.vander(np.linspace(-1.0, 1.0, length), min(3 + _HIGHER, length), increasing=True)
    basis = np.linalg.qr(powers)[0]
    coefficients = stretches @ basis
    squares = np.einsum("ij,ij->i", stretches, stretches)
    for terms in (2, 3):
        if terms == length:
            continue
        misfit = squares - np.sum(coefficients[:, :terms] ** 2, axis=1)
        holds = misfit <= noise**2 * chdtri(length - terms, 1.0 - _ACCEPTED)
        if length in _LONG:
            higher = np.sum(coefficients[:, terms : terms + _HIGHER] ** 2, axis=1)
            holds &= higher <= noise**2 * chdtri(_HIGHER, 1.0 - _ACCEPTED_LONG)
        yield starts[holds], np.ascontiguousarray(basis[:, :terms]), coefficients[holds, :terms]


@njit(cache=True, nogil=True)
def _take(starts, basis, coefficients, share, found, left):  # type: ignore[no-untyped-def]
    """Put the polynomials' values into ``found`` where they leave less of the noise's variance than ``left``."""
    length, terms = basis.shape
    for stretch, start in enumerate(starts):
        for place in range(length):
            if share[place] < left[start + place]:
                value = 0.0
                for term in range(terms):
                    value += coefficients[stretch, term] * basis[place, term]
                found[start + place] = value
                left[start + place] = share[place]


def _without_outliers(current: Array, noise: float) -> Array:
    """Replace what stands out from the two neighbours at either side by more than they differ among each other.

    Where much does, the current itself switches for single samples, and nothing is replaced.
    """
    padded = np.pad(current, 2, mode="edge")
    neighbours = np.sort([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    middle = (neighbours[1] + neighbours[2]) / 2
    outlier = np.abs(current - middle) > 3.0 * noise + (neighbours[3] - neighbours[0])
    outlier[[0, -1]] = False
    return np.where(outlier, middle, current) if outlier.mean() < _FEW else current.copy()
