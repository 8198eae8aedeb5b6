"""Uncertainty of each parameter as the recordings determine it: covariance, correlation, profile of the objective."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from mrd_identification.least_squares import BOUND_TOLERANCE, levenberg_marquardt
from mrd_identification.problem import Problem
from mrd_identification.residual_correlation import correlation_length, independent_segments

Array = NDArray[np.float64]

LEAST_DEGREES_OF_FREEDOM = 5
"""Degrees of freedom: independent segments of the residuals beyond the number of parameters. With fewer, the covariance of
the scores is too uncertain for intervals."""

MOST_ATTEMPTS = 10
"""Offsets that are tried to find one end of a profile."""

ROUNDING = 1e-10
"""Change of the force over the force; smaller changes are dominated by rounding errors."""

RISE_TOLERANCE = 0.1
"""Relative error of the rise of the objective at the end of a profile; it moves the end by a twentieth of the interval."""


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the free parameters.

    Attributes
    ----------
    lower, upper : ndarray (free,)
        95 % interval from the covariance; nan where the parameter cannot be determined or lies on a bound.
    profile_lower, profile_upper : ndarray (free,)
        95 % interval from the profile of the objective. It ends on a bound where the objective does not rise enough before
        it. nan where it was not computed.
    correlation : ndarray (free, free)
    on_bound : ndarray (free,) of bool
    beyond : ndarray (free,)
        Distance in standard deviations from a parameter on its bound to the unbounded optimum outside; else 0.
    condition : float
        Condition number of the scaled sensitivity matrix.
    segments : int
        Number of independent segments of the residuals; with too few of them there are no intervals.
    sensitivity : ndarray (samples, free)
        Derivatives in N of the residuals with respect to the unit coordinates; 0 where rounding errors dominate.
    """

    lower: Array
    upper: Array
    profile_lower: Array
    profile_upper: Array
    correlation: Array
    on_bound: NDArray[np.bool_]
    beyond: Array
    condition: float
    segments: int
    sensitivity: Array


@dataclass(frozen=True)
class SandwichCovariance:
    """Normal matrix and scores of scaled parameters, from which their covariance follows.

    Attributes
    ----------
    norm : ndarray (free,)
        Norm in N of the derivatives with respect to each unit coordinate, by which they are scaled.
    gram : ndarray (free, free)
        Normal matrix of the scaled derivatives: the second derivatives of the objective.
    scores : ndarray (segments, free)
        Derivative in N of half the objective of each independent segment.
    spare : int
        Degrees of freedom: segments beyond the parameters.
    seen : ndarray (free,) of bool
        Parameters inside their bounds that change the force.
    """

    norm: Array
    gram: Array
    scores: Array
    spare: int
    seen: NDArray[np.bool_]

    @property
    def student_t(self) -> float:
        """Half the width of a 95 % interval in standard deviations."""
        return float(stdtrit(self.spare, 0.975))

    @cached_property
    def seen_root(self) -> tuple[Array, Array]:
        """`covariance_root` of the parameters ``seen``."""
        return self.covariance_root(self.seen)

    @cached_property
    def half(self) -> Array:
        """Half the width of the 95 % interval (free,) in unit coordinates; nan of parameters that are not ``seen``."""
        half = np.full(len(self.norm), np.nan)
        half[self.seen] = self.student_t * np.linalg.norm(self.seen_root[1], axis=1) / self.norm[self.seen]
        return half

    def covariance_root(self, among: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Return the inverse normal matrix of some parameters, and a root R of their covariance R Rᵀ."""
        inverse = normal_inverse(self.gram[np.ix_(among, among)])
        return inverse, inverse @ self.scores[:, among].T * np.sqrt(len(self.scores) / self.spare)


def uncertainty(
    problem: Problem, theta: Array, *, intervals: bool = True, profile: bool = True, step: Callable[[], None] = lambda: None
) -> Uncertainty:
    """Compute 95 % intervals of the free parameters at the optimum ``theta``.

    Residuals of a damper model are strongly correlated in time, so the covariance is the sandwich (JᵀJ)⁻¹ M (JᵀJ)⁻¹ whose
    middle M sums the scores Jᵀr over segments longer than that correlation (Liang & Zeger, 1986), and the degrees of freedom
    of Student's t count segments, not samples. With a robust loss, the scores have its first derivative, and the normal
    matrix its second one (Huber & Ronchetti, 2009, ch. 7.6). The profile (Venzon & Moolgavkar, 1988) fixes one parameter
    after the other and refits the rest. It ends where the objective has risen to what the covariance implies for 95 %, so it
    includes curvature and bounds. A parameter on a bound has a profile on its inner side.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
    intervals : bool
        Compute intervals at all: there are none where ``theta`` is no optimum.
    profile : bool
        Compute the profiles, the costly part.
    step : callable
        Called after each profile.
    """
    unit = problem.unit(theta)
    residuals = problem.residuals(theta)
    sensitivity = problem.jacobian(unit)
    root = problem.robust_weights(residuals)
    jacobian, weighted = sensitivity * root[:, None], residuals * root
    on_bound = (unit < BOUND_TOLERANCE) | (unit > 1 - BOUND_TOLERANCE)
    norm = np.linalg.norm(jacobian, axis=0)
    invisible = norm <= _least_force_change(problem)
    sensitivity[:, invisible] = norm[invisible] = 0.0
    seen = (norm > 0) & ~on_bound
    count = len(unit)
    nan = np.full(count, np.nan)
    result = Uncertainty(nan, nan, nan, nan, np.eye(count), on_bound, np.zeros(count), np.inf, 0, sensitivity)
    if not (norm > 0).any():
        return result
    scaled = jacobian / np.where(norm > 0, norm, 1.0)
    gram = scaled.T @ (scaled * problem.relative_curvature(residuals)[:, None])
    segments = _segments(problem, weighted, int(seen.sum()))
    scores = np.stack([scaled[segment].T @ weighted[segment] for segment in segments])
    result = replace(result, condition=_condition(gram[np.ix_(seen, seen)]), segments=len(segments))
    spare = len(segments) - int(seen.sum()) - problem.run_offsets
    if not intervals or spare < LEAST_DEGREES_OF_FREEDOM:
        return result
    sandwich = SandwichCovariance(norm, gram, scores, spare, seen)
    result = _with_intervals(problem, theta, sandwich, result)
    return _with_bounds_and_profiles(problem, theta, sandwich, result, step if profile else None)


def _least_force_change(problem: Problem) -> float:
    """Return the norm in N of a change of the weighted force below which rounding errors dominate."""
    return ROUNDING * float(np.linalg.norm(problem.force * problem.root_weight))


def _segments(problem: Problem, weighted: Array, parameters: int) -> list[slice]:
    """Return the slices of the residuals that count as independent: whole runs, or segments within them.

    Whole runs where there are enough: they also account for an error that is the same throughout a run.
    """
    enough = len(problem.blocks) >= parameters + LEAST_DEGREES_OF_FREEDOM + problem.run_offsets
    return problem.blocks if enough else independent_segments(problem.blocks, correlation_length(weighted))


def _condition(gram: Array) -> float:
    """Return the condition number of the sensitivities with this normal matrix."""
    values = np.linalg.eigvalsh(gram) if gram.size else np.zeros(1)
    return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else np.inf


def _with_intervals(problem: Problem, theta: Array, sandwich: SandwichCovariance, result: Uncertainty) -> Uncertainty:
    """Return the result with the intervals and the correlation of the covariance."""
    _, root_covariance = sandwich.seen_root
    deviation = np.linalg.norm(root_covariance, axis=1)
    directions = root_covariance / np.where(deviation > 0, deviation, 1.0)[:, None]
    correlation = result.correlation.copy()
    correlation[np.ix_(sandwich.seen, sandwich.seen)] = directions @ directions.T
    np.fill_diagonal(correlation, 1.0)
    scale = problem.scale(theta) * sandwich.half
    value = theta[list(problem.free)]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        factor = np.exp(scale / value)
        lower = np.where(problem.log, value / factor, value - scale)
        upper = np.where(problem.log, value * factor, value + scale)
    # No parameter lies beyond its bounds: the lag of a sensor is not negative.
    bounds = np.array([problem.model.parameters[place].limits for place in problem.free]).T
    lower, upper = np.maximum(lower, bounds[0]), np.minimum(upper, bounds[1])
    return replace(result, lower=lower, upper=upper, correlation=correlation)


def _with_bounds_and_profiles(
    problem: Problem, theta: Array, sandwich: SandwichCovariance, result: Uncertainty, step: Callable[[], None] | None
) -> Uncertainty:
    """Return the result with `Uncertainty.beyond` and, where ``step`` is given, with profiles."""
    unit, norm, best = problem.unit(theta), sandwich.norm, problem.cost(theta)
    least = _least_force_change(problem)
    beyond = np.zeros(len(unit))
    profile_lower, profile_upper = np.full((2, len(unit)), np.nan)
    for index in map(int, np.flatnonzero(norm > 0)):
        among = sandwich.seen.copy()
        among[index] = True
        place = int(among[:index].sum())
        (inverse, _), half = sandwich.seen_root, sandwich.half[index]
        if result.on_bound[index]:
            inverse, root_covariance = sandwich.covariance_root(among)
            deviation = np.linalg.norm(root_covariance[place])
            half = sandwich.student_t * deviation / norm[index]
            outward = 1.0 if unit[index] > 0.5 else -1.0
            step_out = -outward * inverse[place, place] * sandwich.scores[:, index].sum()
            beyond[index] = max(0.0, step_out / deviation) if deviation > 0 else 0.0
        if step is None:
            continue
        force_change = half * norm[index]  # while the other parameters stay
        ends = [unit[index], unit[index]]
        if force_change > least:
            direction = np.zeros(len(unit))
            direction[among] = inverse[:, place] / inverse[place, place] / norm[among] * norm[index]
            rise = 0.5 * force_change**2 / inverse[place, place]
            ends = [_profile_end(problem, unit, index, side * half, direction, rise, best) for side in (-1.0, 1.0)]
        profile_lower[index], profile_upper[index] = (_value(problem, unit, index, end) for end in ends)
        step()
    return replace(result, beyond=beyond, profile_lower=profile_lower, profile_upper=profile_upper)


def normal_inverse(gram: Array) -> Array:
    """Return the inverse of a normal matrix; a direction that the recordings do not determine gets a large variance."""
    values, vectors = np.linalg.eigh(gram)
    return np.asarray((vectors / np.maximum(values, values.max(initial=0.0) * 1e-14)) @ vectors.T)


def _profile_end(
    problem: Problem, unit: Array, index: int, half: float, direction: Array, rise: float, best: float
) -> float:
    """Return the unit coordinate where the refitted objective has risen by ``rise``, on the side of the sign of ``half``."""
    reach = (1.0 if half > 0 else 0.0) - unit[index]
    if reach == 0.0:
        return float(unit[index])
    offset = float(np.clip(half, -abs(reach), abs(reach)))
    inside, root_inside, outside, root_outside = 0.0, 0.0, np.inf, np.inf
    for attempt in range(MOST_ATTEMPTS):
        start = np.clip(unit + offset * direction, 0.0, 1.0)
        start[index] = unit[index] + offset
        risen = (problem.cost(problem.theta(start)) - best) / rise
        # Where the objective still is the parabola of the optimum, a refit would not change it.
        expected = (offset / half) ** 2
        if abs(risen - expected) > RISE_TOLERANCE * expected or attempt:
            cost, refitted = _refit(problem, start, index, 0.02 * rise / best)
            risen = (cost - best) / rise
            direction = (refitted - unit) / offset
        if abs(risen - 1.0) < RISE_TOLERANCE or (risen < 1.0 and offset == reach):
            break
        # The root of the rise is nearly linear in the offset: interpolate between two offsets, or extrapolate.
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
    """Return the least objective near ``start`` over the parameters other than ``index``, and the point of the unit box."""
    others = np.delete(np.arange(len(start)), index)
    refitted, cost = levenberg_marquardt(problem, start, others, 10, tolerance)
    return cost, refitted


def _value(problem: Problem, unit: Array, index: int, end: float) -> float:
    """Return the value of a free parameter at the unit coordinate ``end``."""
    shifted = unit.copy()
    shifted[index] = np.clip(end, 0.0, 1.0)
    return float(problem.theta(shifted)[problem.free[index]])
