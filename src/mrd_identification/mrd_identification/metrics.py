"""Errors of a modelled force: rms error, NRMSE, variance accounted for, and two norms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Metrics:
    """Errors of a modelled force.

    Attributes
    ----------
    samples : int
        Number k of samples.
    rmse : float
        Root mean square error in N.
    nrmse : float
        Normalised rms error: ``rmse`` over the standard deviation of the measured force.
    fit_percent : float
        100 (1 - nrmse).
    vaf : float
        Variance accounted for in percent, 100 (1 - var(error) / var(force)).
    e2, einf : float
        Norms of the error in N: square root of the sum of squares over k, and largest error over k (Eq. 9 of the paper that
        the bench follows).
    """

    samples: int
    rmse: float
    nrmse: float
    fit_percent: float
    vaf: float
    e2: float
    einf: float


def error_norms(error: Array) -> tuple[float, float]:
    """Return `Metrics.e2` and `Metrics.einf` of errors in N."""
    k = len(error)
    return float(np.sqrt(error @ error)) / k, float(np.max(np.abs(error))) / k


def nrmse(error: Array, force: Array) -> float:
    """Return the rms of errors in N over the standard deviation of the measured force; infinite for a constant force."""
    spread = float(np.std(force))
    return float(np.sqrt(np.mean(error**2))) / spread if spread > 0 else float("inf")


@np.errstate(over="ignore", invalid="ignore")  # a model may diverge on a run to which it was not fitted
def metrics(measured: Array, modelled: Array) -> Metrics:
    """Compare two equally long series of force in N."""
    error = measured - modelled
    e2, einf = error_norms(error)
    spread = float(np.std(measured))
    rmse = float(np.sqrt(np.mean(error**2)))
    relative = nrmse(error, measured)
    vaf = 100 * (1 - float(np.var(error)) / spread**2) if spread > 0 else float("-inf")
    return Metrics(
        samples=len(error), rmse=rmse, nrmse=relative, fit_percent=100 * (1 - relative), vaf=vaf, e2=e2, einf=einf
    )
