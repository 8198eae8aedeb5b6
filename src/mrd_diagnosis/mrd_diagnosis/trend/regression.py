"""Random-effects meta-regression: generalised least squares for values with known errors and additional scatter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.special import stdtrit

from mrd_diagnosis.diagnosis import Interval

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Regression:
    """Result of a meta-regression.

    Attributes
    ----------
    coefficients : ndarray (coefficients,)
    covariance : ndarray (coefficients, coefficients)
    scatter : float
        Standard deviation between the values beyond what their errors explain.
    design : ndarray (values, coefficients)
    root : ndarray (values, values)
        Lower Cholesky factor of the covariance of the values, scatter included.
    """

    coefficients: Array
    covariance: Array
    scatter: float
    design: Array
    root: Array

    @property
    def student_t(self) -> float:
        """Factor from a standard deviation to half of a 95 % interval."""
        return float(stdtrit(len(self.design) - len(self.coefficients), 0.975))

    def interval(self, combination: Array) -> Interval:
        """Return a linear combination of the coefficients with its 95 % interval."""
        value = float(combination @ self.coefficients)
        half = float(self.student_t * np.sqrt(combination @ self.covariance @ combination))
        return Interval(value, value - half, value + half)


def regress(design: Array, values: Array, covariance: Array) -> Regression:
    """Fit values whose errors are known, and which scatter by more than their errors.

    The scatter is estimated so that the weighted sum of squares equals its degrees of freedom (Paule & Mandel, 1982). The
    covariance of the coefficients follows from how the values scatter around the fit (Knapp & Hartung, 2003), so errors that
    all values share, or that are estimated too large, do no harm.

    Parameters
    ----------
    design : ndarray (values, coefficients)
    values : ndarray (values,)
    covariance : ndarray (values, values)
        Covariance of the errors of the values.
    """
    degrees_of_freedom = len(values) - design.shape[1]

    def solve(scatter: float) -> tuple[Array, Array, float, Array]:
        # Values without errors would make the covariance singular: a small share of the mean variance keeps it regular.
        regularisation = 1e-12 * float(np.trace(covariance) / len(values) + np.var(values)) + 1e-300
        root = cholesky(covariance + (scatter**2 + regularisation) * np.eye(len(values)), lower=True)
        white = solve_triangular(root, np.column_stack([design, values]), lower=True)
        inverse = np.linalg.pinv(white[:, :-1])
        coefficients = inverse @ white[:, -1]
        residuals = white[:, -1] - white[:, :-1] @ coefficients
        return coefficients, inverse @ inverse.T, float(residuals @ residuals), root

    span = float(np.ptp(values)) or 1.0
    scatter = 0.0
    if solve(0.0)[2] > degrees_of_freedom:
        scatter = float(brentq(lambda s: solve(s)[2] - degrees_of_freedom, 0.0, 10.0 * span, xtol=1e-9 * span))
    coefficients, inverse_normal_matrix, squares, root = solve(scatter)
    return Regression(coefficients, inverse_normal_matrix * squares / degrees_of_freedom, scatter, design, root)
