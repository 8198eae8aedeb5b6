"""How well the recordings determine each parameter: covariance, correlation, profile of the objective."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from mrd_identification.polish import BORDER
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

FEWEST_SPARE_BLOCKS = 5
"""Independent stretches of the residual beyond the number of parameters, below which intervals would be made up."""


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the free parameters.

    Attributes
    ----------
    lower, upper : ndarray (free,)
        95 % interval from the covariance; nan where the parameter cannot be determined or lies on a bound.
    profile_lower, profile_upper : ndarray (free,)
        95 % interval from the profile of the objective; ends on a bound where the objective does not rise enough before it.
        nan where it was not computed.
    correlation : ndarray (free, free)
    on_bound : ndarray (free,) of bool
    condition : float
        Condition number of the scaled sensitivity matrix.
    blocks : int
        Stretches of the residual that count as independent; with too few of them there are no intervals.
    sensitivity : ndarray (samples, free)
        Derivatives in N of the residuals to the unit coordinates.
    """

    lower: Array
    upper: Array
    profile_lower: Array
    profile_upper: Array
    correlation: Array
    on_bound: NDArray[np.bool_]
    condition: float
    blocks: int
    sensitivity: Array


def uncertainty(
    problem: Problem, theta: Array, *, profile: bool = True, step: Callable[[], None] = lambda: None
) -> Uncertainty:
    """95 % intervals of the free parameters at the optimum ``theta``.

    Residuals of a damper model are strongly correlated in time, so the covariance is the sandwich (JᵀJ)⁻¹ M (JᵀJ)⁻¹ whose
    middle M sums the scores Jᵀr over blocks longer than that correlation (Liang & Zeger, 1986), and Student's t counts
    blocks, not samples. The profile (Venzon & Moolgavkar, 1988) fixes one parameter after the other and refits the rest; it
    ends where the objective has risen as far as the covariance says that it must for 95 %, so it sees curvature and bounds.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
    profile : bool
        Compute the profiles, the costly part.
    step : callable
        Called after each of them.
    """
    unit = problem.unit(theta)
    residuals = problem.residuals(theta)
    sensitivity = problem.jacobian(unit)
    root = problem.robust_weights(residuals)
    jacobian, weighted = sensitivity * root[:, None], residuals * root
    on_bound = (unit < BORDER) | (unit > 1 - BORDER)
    norm = np.linalg.norm(jacobian, axis=0)
    seen = (norm > 0) & ~on_bound
    count = len(unit)
    lower, upper, profile_lower, profile_upper = np.full((4, count), np.nan)
    correlation = np.eye(count)
    condition, blocks = np.inf, 0

    def found() -> Uncertainty:
        return Uncertainty(
            lower, upper, profile_lower, profile_upper, correlation, on_bound, condition, blocks, sensitivity
        )

    if not seen.any():
        return found()
    scaled = jacobian[:, seen] / norm[seen]
    _, singular, vt = np.linalg.svd(scaled, full_matrices=False)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
    inverse = (vt.T / np.maximum(singular, singular[0] * 1e-10) ** 2) @ vt
    stretches = _stretches(problem, weighted)
    blocks = len(stretches)
    spare = blocks - int(seen.sum())
    if spare < FEWEST_SPARE_BLOCKS:
        return found()
    scores = np.stack([scaled[stretch].T @ weighted[stretch] for stretch in stretches])
    covariance = inverse @ (scores.T @ scores) @ inverse * blocks / spare
    deviation = np.sqrt(np.diag(covariance))
    correlation[np.ix_(seen, seen)] = covariance / np.outer(deviation, deviation)
    student_t = float(student.ppf(0.975, spare))
    half = np.full(count, np.nan)
    half[seen] = student_t * deviation / norm[seen]
    scale = problem.scale(theta) * half
    middle = theta[list(problem.free)]
    with np.errstate(over="ignore", invalid="ignore"):
        factor = np.exp(scale / middle)
        lower = np.where(problem.log, middle / factor, middle - scale)
        upper = np.where(problem.log, middle * factor, middle + scale)
    if profile:
        best = problem.cost(theta)
        direction = np.zeros((count, count))
        direction[np.ix_(seen, seen)] = (inverse / np.diag(inverse)) / norm[seen][:, None] * norm[seen]
        rise = student_t**2 * np.diag(covariance) / np.diag(inverse)
        for place, index in enumerate(map(int, np.flatnonzero(seen))):
            ends = [
                _profile_end(problem, unit, index, side * half[index], direction[:, index], best + 0.5 * rise[place], best)
                for side in (-1.0, 1.0)
            ]
            profile_lower[index], profile_upper[index] = (_value(problem, unit, index, end) for end in ends)
            step()
    return found()


def _profile_end(
    problem: Problem, unit: Array, index: int, half: float, direction: Array, target: float, best: float
) -> float:
    """Unit coordinate, on the side that ``half`` points to, where the refitted objective rises to ``target``."""
    others = np.arange(len(unit)) != index
    border = 1.0 if half > 0 else 0.0
    reach = border - unit[index]
    offset = np.clip(half, -abs(reach), abs(reach))
    for _ in range(4):
        start = np.clip(unit + offset * direction, 1e-6, 1 - 1e-6)
        start[index] = unit[index] + offset
        cost = _refit(problem, start, others)
        risen = (cost - best) / (target - best)
        if abs(risen - 1.0) < 0.1 or (risen < 1.0 and offset == reach):
            break
        # Near the optimum the root of the rise is linear.
        offset = np.clip(offset * np.clip(1.0 / np.sqrt(max(risen, 1e-3)), 0.3, 3.0), -abs(reach), abs(reach))
    return float(unit[index] + offset)


def _refit(problem: Problem, start: Array, others: NDArray[np.bool_]) -> float:
    """Smallest objective over the other parameters, near ``start``."""
    if not others.any():
        return problem.cost(problem.theta(start))

    def whole(part: Array) -> Array:
        unit = start.copy()
        unit[others] = part
        return unit

    found = least_squares(
        lambda part: problem.residuals(problem.theta(whole(part))),
        start[others],
        jac=lambda part: problem.jacobian(whole(part), np.flatnonzero(others)),
        bounds=(0.0, 1.0),
        x_scale="jac",
        loss=problem.loss,
        f_scale=problem.loss_scale,
        max_nfev=3,
    )
    return float(found.cost)


def _value(problem: Problem, unit: Array, index: int, end: float) -> float:
    moved = unit.copy()
    moved[index] = np.clip(end, 0.0, 1.0)
    return float(problem.theta(moved)[problem.free[index]])


def _stretches(problem: Problem, residuals: Array) -> list[slice]:
    """Stretches of the residual, each within one run and four times as long as its correlation lasts; at most 400 in all."""
    spectrum = np.abs(np.fft.rfft(residuals - residuals.mean(), 2 * len(residuals))) ** 2
    autocorrelation = np.fft.irfft(spectrum)[: len(residuals)]
    below = np.flatnonzero(autocorrelation < 0.1 * autocorrelation[0])
    correlated = int(below[0]) if below.size else len(residuals)
    length = max(4 * correlated, len(residuals) // 400, 1)
    found: list[slice] = []
    for block in problem.blocks:
        edges = np.linspace(block.start, block.stop, max(1, (block.stop - block.start) // length) + 1).astype(int)
        found += [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    return found
