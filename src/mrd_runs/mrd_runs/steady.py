"""A measured coil current without its sensor's noise, its steps left sharp.

The sensor's noise is white; the current itself is levels with steps between them, ramps, or slow waves. So every sample is
read off the line or parabola through a stretch around it: of all stretches that are so but for noise, the one that leaves
least of it (adaptive local polynomials: Katkovnik, Egiazarian and Astola 2006). Beside a step, it lies on one side of it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]

_FOURTH = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
# Share of the stretches that truly are lines or parabolas and are taken for such: a stricter test rounds curves less.
_ACCEPTED = 0.9


def current_noise(current: Array) -> float:
    """Standard deviation in A of the white noise in a measured current (n,), from its fourth differences.

    Their median is blind to steps and outliers, their order to waves and ramps. A reading that hardly ever changes has none.
    """
    if len(current) < len(_FOURTH):
        return 0.0
    differences = np.convolve(current, _FOURTH, "valid")
    # 0.6745: median of the absolute value of a standard normal variable.
    return float(np.median(np.abs(differences)) / (0.6745 * np.linalg.norm(_FOURTH)))


def steady_current(current: Array, window: int = 15) -> Array:
    """Take the sensor's noise off a measured current without rounding its steps.

    Parameters
    ----------
    current : ndarray (n,)
        A, as measured.
    window : int
        Number of samples in the longest stretch, odd.

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
    for _, place, weights, coefficients, holds in sorted(_polynomials(cleaned, noise, window), key=lambda each: each[0]):
        taken = np.flatnonzero(todo[place : place + len(holds)] & holds)
        found[taken + place] = coefficients[taken] @ weights
        todo[taken + place] = False
    return found


def _polynomials(
    series: Array, noise: float, longest: int
) -> list[tuple[float, int, Array, Array, NDArray[np.bool_]]]:
    """Polynomials through all stretches, at each of their places.

    Each is (share of the noise variance left, place, weights (terms,), coefficients (stretches, terms), whether it holds).
    """
    found = []
    for length in sorted({max(length, 3) | 1 for length in (longest, 2 * longest // 3, longest // 2, longest // 3, 3)}):
        if length > len(series):
            continue
        # Orthonormal polynomials, so that each takes its share of the squares.
        basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, length), 3, increasing=True))[0]
        coefficients = np.stack([np.correlate(series, polynomial, "valid") for polynomial in basis.T], axis=1)
        squares = np.convolve(series**2, np.ones(length), "valid")
        for terms in (2, 3):
            if terms < length:
                misfit = squares - np.sum(coefficients[:, :terms] ** 2, axis=1)
                holds = misfit <= noise**2 * chdtri(length - terms, 1.0 - _ACCEPTED)
                for place, weights in enumerate(basis[:, :terms]):
                    found.append((float(weights @ weights), place, weights, coefficients[:, :terms], holds))
    return found


def _without_outliers(current: Array, noise: float) -> Array:
    """Replace what stands out from the two neighbours at either side by more than they differ among each other."""
    padded = np.pad(current, 2, mode="edge")
    neighbours = np.sort([padded[:-4], padded[1:-3], padded[3:-1], padded[4:]], axis=0)
    middle = (neighbours[1] + neighbours[2]) / 2
    outlier = np.abs(current - middle) > 3.0 * noise + (neighbours[3] - neighbours[0])
    outlier[[0, -1]] = False
    return np.where(outlier, middle, current)
