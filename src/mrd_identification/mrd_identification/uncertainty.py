"""How well the recordings determine each parameter: covariance, correlation, profile of the objective."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from mrd_identification.least_squares import BOUND_TOLERANCE, levenberg_marquardt
from mrd_identification.problem import Problem
from mrd_identification.residual_correlation import correlation_length, independent_segments

Array = NDArray[np.float64]

FEWEST_SPARE_BLOCKS = 5
"""Independent stretches of the residual beyond the number of parameters, below which intervals would be made up."""

MOST_ATTEMPTS = 10
"""At the end of a profile."""

ROUNDING = 1e-10
"""Share of the force below which a change of it drowns in rounding errors."""


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
    beyond : ndarray (free,)
        How far beyond its bound the recordings want a parameter that lies on one, in standard deviations; else 0.
    condition : float
        Condition number of the scaled sensitivity matrix.
    blocks : int
        Stretches of the residual that count as independent; with too few of them there are no intervals.
    sensitivity : ndarray (samples, free)
        Derivatives in N of the residuals to the unit coordinates; 0 where they drown in rounding errors.
    """

    lower: Array
    upper: Array
    profile_lower: Array
    profile_upper: Array
    correlation: Array
    on_bound: NDArray[np.bool_]
    beyond: Array
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
    A parameter on a bound has a profile on its inner side.

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
    on_bound = (unit < BOUND_TOLERANCE) | (unit > 1 - BOUND_TOLERANCE)
    norm = np.linalg.norm(jacobian, axis=0)
    least = ROUNDING * float(np.linalg.norm(problem.force * problem.root_weight))
    sensitivity[:, norm <= least] = norm[norm <= least] = 0.0
    seen = (norm > 0) & ~on_bound
    count = len(unit)
    lower, upper, profile_lower, profile_upper = np.full((4, count), np.nan)
    correlation = np.eye(count)
    beyond = np.zeros(count)
    condition, blocks = np.inf, 0

    def found() -> Uncertainty:
        return Uncertainty(
            lower, upper, profile_lower, profile_upper, correlation, on_bound, beyond, condition, blocks, sensitivity
        )

    if not (norm > 0).any():
        return found()
    scaled = jacobian / np.where(norm > 0, norm, 1.0)
    gram = scaled.T @ scaled
    # Where there are runs enough, they are what is independent: an error that each of them repeats all over is seen, too.
    needed = int(seen.sum()) + FEWEST_SPARE_BLOCKS + problem.run_offsets
    enough = len(problem.blocks) >= needed
    parts = problem.blocks if enough else independent_segments(problem.blocks, correlation_length(weighted))
    blocks = len(parts)
    scores = np.stack([scaled[part].T @ weighted[part] for part in parts])
    if seen.any():
        values = np.linalg.eigvalsh(gram[np.ix_(seen, seen)])
        condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else np.inf
    spare = blocks - int(seen.sum()) - problem.run_offsets
    if spare < FEWEST_SPARE_BLOCKS:
        return found()
    student_t = float(stdtrit(spare, 0.975))

    def spread(among: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Inverse of the normal matrix of some parameters, and a root R of their covariance R Rᵀ."""
        inverse = normal_inverse(gram[np.ix_(among, among)])
        return inverse, inverse @ scores[:, among].T * np.sqrt(blocks / spare)

    inverse, root_covariance = spread(seen)
    deviation = np.linalg.norm(root_covariance, axis=1)
    directions = root_covariance / np.where(deviation > 0, deviation, 1.0)[:, None]
    correlation[np.ix_(seen, seen)] = directions @ directions.T
    np.fill_diagonal(correlation, 1.0)
    half = np.full(count, np.nan)
    half[seen] = student_t * deviation / norm[seen]
    scale = problem.scale(theta) * half
    value = theta[list(problem.free)]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        factor = np.exp(scale / value)
        lower = np.where(problem.log, value / factor, value - scale)
        upper = np.where(problem.log, value * factor, value + scale)

    best = problem.cost(theta)
    for index in map(int, np.flatnonzero(norm > 0)):
        among = seen.copy()
        among[index] = True
        place = int(among[:index].sum())
        joint = inverse
        if on_bound[index]:
            joint, root_covariance = spread(among)
            deviation_here = np.linalg.norm(root_covariance[place])
            half[index] = student_t * deviation_here / norm[index]
            outward = 1.0 if unit[index] > 0.5 else -1.0
            step_out = -outward * joint[place, place] * scores[:, index].sum()
            beyond[index] = max(0.0, step_out / deviation_here) if deviation_here > 0 else 0.0
        if not profile:
            continue
        moved = half[index] * norm[index]  # change of the force, while the others stay
        ends = [unit[index], unit[index]]
        if moved > least:
            direction = np.zeros(count)
            direction[among] = joint[:, place] / joint[place, place] / norm[among] * norm[index]
            rise = 0.5 * moved**2 / joint[place, place]
            ends = [_profile_end(problem, unit, index, side * half[index], direction, rise, best) for side in (-1.0, 1.0)]
        profile_lower[index], profile_upper[index] = (_value(problem, unit, index, end) for end in ends)
        step()
    return found()


def normal_inverse(gram: Array) -> Array:
    """Inverse of a normal matrix; what the recordings do not determine gets a large variance."""
    values, vectors = np.linalg.eigh(gram)
    return np.asarray((vectors / np.maximum(values, values.max(initial=0.0) * 1e-14)) @ vectors.T)


def _profile_end(
    problem: Problem, unit: Array, index: int, half: float, direction: Array, rise: float, best: float
) -> float:
    """Unit coordinate, on the side that ``half`` points to, where the refitted objective has risen by ``rise``."""
    reach = (1.0 if half > 0 else 0.0) - unit[index]
    if reach == 0.0:
        return float(unit[index])
    offset = float(np.clip(half, -abs(reach), abs(reach)))
    inside, root_inside, outside, root_outside = 0.0, 0.0, np.inf, np.inf
    for attempt in range(MOST_ATTEMPTS):
        start = np.clip(unit + offset * direction, 0.0, 1.0)
        start[index] = unit[index] + offset
        risen = (problem.cost(problem.theta(start)) - best) / rise
        # Where the objective is the parabola that it is near the optimum, nothing is left to refit.
        expected = (offset / half) ** 2
        if abs(risen - expected) > 0.1 * expected or attempt:
            cost, refitted = _refit(problem, start, index, 0.02 * rise / best)
            risen = (cost - best) / rise
            direction = (refitted - unit) / offset
        if abs(risen - 1.0) < 0.1 or (risen < 1.0 and offset == reach):
            break
        # The root of the rise is nearly linear: on between two offsets, or as far again.
        root = np.sqrt(max(risen, 0.0))
        if risen < 1.0:
            inside, root_inside = offset, root
        else:
            outside, root_outside = offset, root
        if np.isfinite(outside):
            share = (1.0 - root_inside) / (root_outside - root_inside)
            offset = inside + float(np.clip(share, 0.1, 0.9)) * (outside - inside)
        else:
            offset = float(np.clip(offset / max(root, 0.3), -abs(reach), abs(reach)))
    return float(unit[index] + offset)


def _refit(problem: Problem, start: Array, index: int, tolerance: float) -> tuple[float, Array]:
    """Smallest objective over the parameters other than ``index``, near ``start``, and where it is."""
    others = np.delete(np.arange(len(start)), index)
    refitted, cost = levenberg_marquardt(problem, start, others, 10, tolerance)
    return cost, refitted


def _value(problem: Problem, unit: Array, index: int, end: float) -> float:
    moved = unit.copy()
    moved[index] = np.clip(end, 0.0, 1.0)
    return float(problem.theta(moved)[problem.free[index]])
