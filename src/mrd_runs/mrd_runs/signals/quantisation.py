"""Quantisation of a measured channel: the step between its readings, and the error that it causes."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Largest distance of a gap from a multiple of the step, as a share of the step; scaled digits are that exact.
_TOLERANCE = 1e-3
# Smallest share of the gaps that are multiples of the step; averaged or unquantised readings have fewer.
_MULTIPLES = 0.99
# Gap over the largest reading, up to which two readings are equal but for the rounding of a calibration.
_ROUNDING = 1e-12

# Steps that a channel that stands still does not leave within a window: one that lasts so many of the longer readings, but
# no less and no more than these shares of the recording.
_STANDSTILL, _READINGS, _LEAST_SHARE, _LARGEST_SHARE = 2.5, 10.0, 1 / 200, 1 / 20


def rounding_error(readings: Array) -> float:
    """Return the largest rounding error, in their unit, that readings (n,) have as floating-point numbers."""
    return 8 * np.finfo(float).eps * float(np.abs(readings).max())


def quantisation_step(
    readings: Array, resolution: float, *, tolerance: float = _TOLERANCE, multiples: float = _MULTIPLES
) -> float:
    """Return the step of a quantised channel in the unit of its readings; 0 where it is not quantised.

    Parameters
    ----------
    readings : ndarray (n,)
        Readings of a channel, of position, force or current for instance.
    resolution : float
        Smallest difference between two readings that is not rounding, at least `rounding_error`.
    tolerance : float
        Largest distance of a gap between neighbouring values from a multiple of the step, as a share of the step.
    multiples : float
        Smallest share of such gaps that must be multiples of the step.
    """
    gaps = _gaps(readings, resolution)
    if len(gaps) == 0:
        return 0.0
    step = float(gaps.min())
    remainder = np.abs(gaps / step - np.round(gaps / step))
    return step if np.mean(remainder < tolerance) >= multiples else 0.0


def quantisation_variance(readings: Array, resolution: float) -> float:
    """Return the variance of the quantisation error of a channel, at least the squared ``resolution``.

    The error of one reading has the variance step²/12. It stays the same while the reading does, so the variance is
    multiplied by the mean number of samples between two changes: as white noise, it then weighs as much. Standstill does
    not count, however long it lasts: the channel tells nothing new there.
    """
    step = quantisation_step(readings, resolution)
    return max(step**2 / 12 * _samples_per_change(readings, step), resolution**2) if step else resolution**2


def _samples_per_change(readings: Array, step: float) -> float:
    """Return the mean number of samples between two changes where a channel moves; everywhere, if it hardly does."""
    count = len(readings)
    changes = np.concatenate([[True], np.diff(readings) != 0])
    lengths = np.diff(np.append(np.flatnonzero(changes), count))
    window = np.clip(_READINGS * np.quantile(lengths, 0.9), _LEAST_SHARE * count, _LARGEST_SHARE * count)
    starts = np.arange(0, count, max(1, int(window)))
    moves = np.maximum.reduceat(readings, starts) - np.minimum.reduceat(readings, starts) > _STANDSTILL * step
    counted = moves if moves.any() else np.full(len(starts), True)
    samples = np.diff(np.append(starts, count))[counted].sum()
    return float(samples / max(1, np.add.reduceat(changes.astype(int), starts)[counted].sum()))


def resolution(readings: Array) -> float:
    """Return the smallest difference between two readings (n,); 0 where they are continuous.

    Unlike `quantisation_step`, it does not demand that all differences are multiples of it: the readings of a file may have
    been calibrated, rounded again, or averaged.
    """
    gaps = _gaps(readings, _ROUNDING * float(np.abs(readings).max()))
    # Among n continuous readings the closest two are about span/n² apart, and the median gap is about span/n.
    return float(gaps.min()) if len(gaps) and gaps.min() > 0.1 * np.median(gaps) else 0.0


def smallest_step(readings: Array) -> float:
    """Return the smallest difference between two readings (n,), also of a continuous channel; 0 where all are equal."""
    gaps = _gaps(readings, _ROUNDING * float(np.abs(readings).max()))
    return float(gaps.min()) if len(gaps) else 0.0


def _gaps(readings: Array, least: float) -> Array:
    """Return the differences between neighbouring values of a channel that exceed ``least``."""
    gaps = np.diff(np.unique(readings))
    return np.asarray(gaps[gaps > least])
