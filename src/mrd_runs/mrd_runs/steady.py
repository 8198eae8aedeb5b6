"""A measured coil current without its sensor's noise, its steps left sharp.

The sensor's noise is white; the current itself is levels with steps between them, ramps, or slow waves. So every sample is
read off the line or parabola through a stretch around it: of all stretches that are so but for noise, the one that leaves
least of it (adaptive local polynomials: Katkovnik, Egiazarian and Astola 2006). Beside a step, it lies on one side of it.
"""

from collections.abc import Iterator

import numpy as np
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
    noise = _normal(np.convolve(current, _FOURTH, "valid")) / float(np.linalg.norm(_FOURTH))
    change = np.abs(np.diff(current))
    # At least a quarter of the changes are taken to be noise.
    quiet = float(np.quantile(change, 0.25))
    for _ in range(10 if quiet > 0.0 else 0):
        quiet = _normal(change[change <= 4.0 * quiet])
    return min(noise, quiet / np.sqrt(2.0)) if quiet > 0.0 else noise


def _normal(values: Array) -> float:
    """Standard deviation of a normal variable with outliers; 0.6745 is the median of a standard one's absolute value."""
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
    cleaned = _without_outliers(current, noise)
    found, todo = cleaned.copy(), np.ones(len(current), dtype=bool)
    for _, samples, values in sorted(_polynomials(cleaned, noise), key=lambda each: each[0]):
        taken = todo[samples]
        found[samples[taken]] = values[taken]
        todo[samples[taken]] = False
    return found


def _polynomials(series: Array, noise: float) -> Iterator[tuple[float, NDArray[np.intp], Array]]:
    """What polynomials through stretches of all lengths say where they hold.

    Each is (share of the noise variance left, samples, their values), the samples at the same place of their stretches.
    """
    for length in _SHORT + _LONG:
        if length > len(series):
            continue
        starts = np.arange(0, len(series) - length + 1, 1 if length in _SHORT else length // _PLACES)
        stretches = sliding_window_view(series, length)[starts]
        # Orthonormal polynomials, so that each takes its share of the squares.
        terms = min(3 + _HIGHER, length)
        basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), terms, increasing=True))[0]
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
            for place, weights in enumerate(basis[:, :terms]):
                yield float(weights @ weights), starts[holds] + place, coefficients[holds, :terms] @ weights


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
