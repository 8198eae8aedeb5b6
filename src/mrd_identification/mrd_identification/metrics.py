"""How far a model's force is from the measured one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Metrics:
    """Errors of a model over ``samples`` samples.

    Attributes
    ----------
    samples : int
        k, the number of samples counted.
    rmse : float
        Root mean square error in N.
    nrmse : float
        rmse / standard deviation of the measured force.
    fit_percent : float
        100 (1 - nrmse).
    vaf : float
        Variance accounted for, 100 (1 - var(error) / var(force)).
    e2, einf : float
        The two norms of the followed paper's Eq. 9 in N: sqrt(sum of squares) / k and largest error / k.
    """

    samples: int
    rmse: float
    nrmse: float
    fit_percent: float
    vaf: float
    e2: float
    einf: float


def error_norms(error: Array) -> tuple[float, float]:
    """e2 and einf, the two norms of the followed paper's Eq. 9, of errors in N."""
    k = len(error)
    return float(np.sqrt(error @ error)) / k, float(np.max(np.abs(error))) / k


def metrics(measured: Array, modelled: Array) -> Metrics:
    """Metrics of two equally long series of force in N."""
    error = measured - modelled
    e2, einf = error_norms(error)
    spread = float(np.std(measured))
    rmse = float(np.sqrt(np.mean(error**2)))
    # A force that never varies has no scale to compare with.
    nrmse = rmse / spread if spread > 0 else float("inf")
    vaf = 100 * (1 - float(np.var(error)) / spread**2) if spread > 0 else float("-inf")
    return Metrics(samples=len(error), rmse=rmse, nrmse=nrmse, fit_percent=100 * (1 - nrmse), vaf=vaf, e2=e2, einf=einf)
