"""Least squares from the knee of the front, and what it says of the parameters' uncertainty."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from mrd_identification.problem import Problem

Array = NDArray[np.float64]

FEWEST_SPARE_BLOCKS = 5
"""Independent stretches of the residual beyond the number of parameters, below which intervals would be made up."""

_BORDER = 1e-6  # of the unit box: closer than this is on the bound


@dataclass(frozen=True)
class Intervals:
    """Uncertainty of the free parameters.

    Attributes
    ----------
    lower, upper : ndarray (free,)
        95 % interval; nan where the parameter cannot be determined or lies on a bound.
    correlation : ndarray (free, free)
    on_bound : ndarray (free,) of bool
    condition : float
        Condition number of the scaled sensitivity matrix.
    blocks : int
        Stretches of the residual that count as independent; with too few of them there are no intervals.
    """

    lower: Array
    upper: Array
    correlation: Array
    on_bound: NDArray[np.bool_]
    condition: float
    blocks: int


def polish(problem: Problem, theta: Array, max_evaluations: int = 100) -> Array:
    """Local least squares on all counted residuals within the bounds, from ``theta``."""

    def residuals(unit: Array) -> Array:
        return problem.residuals(problem.theta(unit))

    def jacobian(unit: Array) -> Array:
        return problem.jacobian(unit, residuals(unit))

    # trf needs a start strictly inside.
    start = np.clip(problem.unit(theta), 1e-4, 1 - 1e-4)
    found = least_squares(
        residuals, start, jac=jacobian, bounds=(0.0, 1.0), x_scale="jac", max_nfev=max_evaluations, xtol=1e-10, ftol=1e-10
    )
    on_lower, on_upper = found.x < _BORDER, found.x > 1 - _BORDER
    return np.asarray(problem.theta(np.where(on_lower, 0.0, np.where(on_upper, 1.0, found.x))))


def intervals(problem: Problem, theta: Array) -> Intervals:
    """95 % intervals from the sensitivities at ``theta``.

    Residuals of a damper model are strongly correlated in time, so the covariance is the sandwich (JᵀJ)⁻¹ M (JᵀJ)⁻¹ whose
    middle M sums the scores Jᵀr over blocks longer than that correlation (Liang & Zeger, 1986), and Student's t counts
    blocks, not samples.
    """
    unit = problem.unit(theta)
    residuals = problem.residuals(theta)
    jacobian = problem.jacobian(unit, residuals)
    on_bound = (unit < _BORDER) | (unit > 1 - _BORDER)
    norm = np.linalg.norm(jacobian, axis=0)
    seen = (norm > 0) & ~on_bound
    count = len(unit)
    lower = np.full(count, np.nan)
    upper = np.full(count, np.nan)
    correlation = np.eye(count)
    if not seen.any():
        return Intervals(lower, upper, correlation, on_bound, np.inf, 0)
    scaled = jacobian[:, seen] / norm[seen]
    _, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
    inverse = (vt.T / np.maximum(singular, singular[0] * 1e-10) ** 2) @ vt
    blocks = _blocks(problem, residuals)
    if len(blocks) < int(seen.sum()) + FEWEST_SPARE_BLOCKS:
        return Intervals(lower, upper, correlation, on_bound, condition, len(blocks))
    scores = np.stack([scaled[block].T @ residuals[block] for block in blocks])
    spare = len(blocks) - int(seen.sum())
    covariance = inverse @ (scores.T @ scores) @ inverse * len(blocks) / spare
    deviation = np.sqrt(np.diag(covariance))
    correlation[np.ix_(seen, seen)] = covariance / np.outer(deviation, deviation)
    half = student.ppf(0.975, spare) * deviation / norm[seen]
    parameters = [p for p, use in zip(problem.parameters, seen, strict=True) if use]
    middle = theta[np.array(problem.free)[seen]]
    width = half * problem.scale(theta)[seen]
    for i, j in enumerate(np.flatnonzero(seen)):
        if parameters[i].log:
            factor = np.exp(width[i] / middle[i])
            lower[j], upper[j] = middle[i] / factor, middle[i] * factor
        else:
            lower[j], upper[j] = middle[i] - width[i], middle[i] + width[i]
    return Intervals(lower, upper, correlation, on_bound, condition, len(blocks))


def _blocks(problem: Problem, residuals: Array) -> list[slice]:
    """Stretches of the residual, each within one run and four times as long as its correlation lasts; at most 400 in all."""
    spectrum = np.abs(np.fft.rfft(residuals - residuals.mean(), 2 * len(residuals))) ** 2
    autocorrelation = np.fft.irfft(spectrum)[: len(residuals)]
    below = np.flatnonzero(autocorrelation < 0.1 * autocorrelation[0])
    correlated = int(below[0]) if below.size else len(residuals)
    length = max(4 * correlated, len(residuals) // 400, 1)
    blocks, start = [], 0
    for recording in problem.recordings:
        samples = len(recording.force)
        edges = np.linspace(start, start + samples, max(1, samples // length) + 1).astype(int)
        blocks += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
        start += samples
    return blocks
