"""Refits: a model fitted to all runs, and to all but each cross-validation fold."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.weighting import WeightedProblem, Weighting, error_of_run, sum_of_squares
from mrd_identification.least_squares import bounded_step, levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

EVALUATIONS = 40
"""Evaluations of the model in one refit, at most."""

CONVERGED = 1e-6
"""Relative decrease of the cost below which a refit has converged."""

NO_INFORMATION = 1e-6
"""Share of the information on a parameter below which the other folds say nothing about it."""


PLAUSIBLE_STEP = 0.3
"""Share of its range by which a parameter moves without a fold where the others do not determine it: the standard deviation
of a normal prior. A step of first order says nothing there: the travel of a loop without width went from one end of its
range to the other, and the fold without it was predicted a hundred times as badly. The mean of the prior is the joint
optimum for parameters of the damper, and the neutral value for the size of an effect: what other folds do not show is not
there."""


@dataclass(frozen=True)
class Refit:
    """A model refitted to all runs, and to all but each fold.

    Attributes
    ----------
    problem : WeightedProblem
    folds : tuple of (int, slice)
        Number of the run and samples of each fold.
    theta : ndarray (parameters,)
        Parameters fitted to all folds.
    fold_costs : ndarray (folds,)
        Sum of squared white residuals of each fold with these parameters.
    held_out_costs : ndarray (folds,)
        The same with parameters that were fitted without the fold.
    held_out_squares : ndarray (folds,)
        Sum of squared errors in N² with those parameters, without the run's offset and gain error.
    held_out_chi_squares : ndarray (folds,)
        The same over the variance of the noise alone.
    coefficients : ndarray (columns,)
        Coefficients of the problem's remainder.
    normal_matrices : ndarray (folds, free + columns, free + columns)
        Normal matrix of each fold at the optimum, for the free parameters and the coefficients of the remainder.
    gradients : ndarray (folds, free + columns)
        Gradient of half the cost of each fold.
    averaging_gradient : ndarray (free + columns,)
        Jacobian transposed times the white change of the force if its samples were means over the sampling period.
    null_gradients : ndarray (folds, draws, free + columns)
        Jacobian transposed times white errors that are only noise, see `refit`.
    """

    problem: WeightedProblem
    folds: tuple[tuple[int, slice], ...]
    theta: Array
    fold_costs: Array
    held_out_costs: Array
    held_out_squares: Array
    held_out_chi_squares: Array
    coefficients: Array
    normal_matrices: Array
    gradients: Array
    averaging_gradient: Array
    null_gradients: Array

    @property
    def held_out_cost(self) -> float:
        """Sum of squared white residuals of all folds, each held out; infinite where it is not finite."""
        total = float(self.held_out_costs.sum())
        return total if np.isfinite(total) else np.inf

    @property
    def chi_square(self) -> float:
        """Reduced chi-square on held-out folds: mean squared error over the noise variance, 1 where nothing is missing."""
        return float(self.held_out_chi_squares.sum() / len(self.problem.force))

    @property
    def values(self) -> dict[str, float]:
        """The fitted parameters by name."""
        return dict(zip(self.problem.model.names, map(float, self.theta), strict=True))

    @property
    def information(self) -> Array:
        """Normal matrix (free + columns, free + columns) of all folds and of the prior of the remainder."""
        prior = np.concatenate([np.zeros(len(self.problem.free)), np.ones(len(self.coefficients))])
        return np.asarray(self.normal_matrices.sum(axis=0) + np.diag(prior))

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects in the model."""
        return tuple(effect.id for effect in self.problem.model.effects)


def refit(
    problem: WeightedProblem,
    start: Array,
    folds: Sequence[tuple[int, slice]],
    null_errors: Sequence[Array] = (),
    converged: float = CONVERGED,
    sensitivity: Array | None = None,
) -> Refit:
    """Fit a model to all runs, then without each fold in turn.

    Leaving a fold out moves the optimum a little. One Gauss-Newton step with the fold's contribution removed from the normal
    equations finds the new optimum without another fit. A parameter that only this fold determines takes its neutral value,
    if it has one. A model that diverges at the optimum predicts nothing: its held-out costs are infinite.

    Parameters
    ----------
    problem : WeightedProblem
    start : ndarray (parameters,)
    folds : sequence of (int, slice)
        See `mrd_diagnosis.fitting.weighting.Weighting.folds`.
    null_errors : sequence of ndarray (draws, n), optional
        White errors of each run if there were no gap.
    converged : float
        Relative decrease of the cost below which the fit ends.
    sensitivity : ndarray (samples, free), optional
        Derivatives of the residuals with which the fit begins, roughly; each exact one takes a pass over the samples.
    """
    unit = problem.unit(start)
    if problem.free:
        moving = np.arange(len(unit))
        unit, _ = levenberg_marquardt(problem, unit, moving, EVALUATIONS, converged, 3, sensitivity)
    theta = problem.theta(unit)
    coefficients = problem.coefficients(theta)
    alone = replace(problem, remainder=())
    force = alone.forces(theta)
    jacobian = np.concatenate([alone.jacobian(unit), problem.white_remainder], axis=1)
    residuals = alone.counted(force - problem.force) + problem.white_remainder @ coefficients
    with np.errstate(over="ignore", invalid="ignore"):
        normal_matrices = np.stack([jacobian[fold].T @ jacobian[fold] for _, fold in folds])
    # A damper of negative viscosity diverges behind an element in series: its derivatives are no numbers any more.
    diverges = not np.isfinite(normal_matrices).all()
    if diverges:
        jacobian, normal_matrices = np.zeros_like(jacobian), np.zeros_like(normal_matrices)
    gradients = np.stack([jacobian[fold].T @ residuals[fold] for _, fold in folds])
    costs = np.array([residuals[fold] @ residuals[fold] for _, fold in folds])
    joined = np.concatenate(null_errors, axis=1) if len(null_errors) else np.empty((0, len(residuals)))
    null_gradients = [joined[:, fold] @ jacobian[fold] for _, fold in folds]
    averaging = jacobian.T @ alone.counted(averaged_over_period(force, problem) - force)
    if diverges:
        nothing = np.full(len(folds), np.inf)
        held_out = nothing, nothing, nothing
    else:
        held_out = held_out_errors(problem, *without_each(problem, unit, coefficients, normal_matrices, gradients), folds)
    return Refit(
        replace(problem),  # a copy without cached columns: fits of many effects are kept beside each other
        tuple(folds),
        theta,
        costs,
        *held_out,
        coefficients,
        normal_matrices,
        gradients,
        averaging,
        np.array(null_gradients),
    )


def refit_on(weighting: Weighting, old: Refit) -> Refit:
    """Refit the same model with another weighting."""
    return refit(weighting.problem(old.problem.model, old.theta), old.theta, weighting.folds)


def averaged_over_period(series: Array, problem: Problem) -> Array:
    """Average runs (n,) over the sampling period around each counted sample, with straight lines between these.

    The force is not smooth: a play is crossed within one period. Straight lines give the mean that is expected of a jump
    anywhere between two samples, an eighth of it beside each if every sample is counted. The change of a smooth force, a
    24th of the second difference, is overestimated, and stays small.
    """
    averaged = series.copy()
    for block, recording in zip(problem.blocks, problem.recordings, strict=True):
        averaged[block][1:-1] += np.diff(series[block], 2) / (8.0 * recording.step)
    return averaged


def without_each(
    problem: Problem, unit: Array, coefficients: Array, normal_matrices: Array, gradients: Array
) -> tuple[Array, Array]:
    """Estimate the parameters (pieces, parameters) and the remainder's coefficients (pieces, columns) without each piece.

    Parameters
    ----------
    problem : Problem
    unit : ndarray (free,)
        Joint optimum in unit coordinates.
    coefficients : ndarray (columns,)
        Coefficients of the remainder at the joint optimum.
    normal_matrices : ndarray (pieces, free + columns, free + columns)
    gradients : ndarray (pieces, free + columns)
    """
    free = len(unit)
    prior = np.concatenate([np.zeros(free), np.ones(len(coefficients))])
    matrix = normal_matrices.sum(axis=0) + np.diag(prior)
    joint = np.concatenate([unit, coefficients])
    gradient = gradients.sum(axis=0) + prior * joint
    # The scatter of the pieces' gradients tells by how much errors count less than independent ones of variance one.
    scatter = (gradients[:, :free] ** 2).sum(axis=0) / np.maximum(np.diag(matrix)[:free], np.finfo(float).tiny)
    hold = np.concatenate([scatter / PLAUSIBLE_STEP**2, np.zeros(len(coefficients))])
    neutral = np.concatenate([problem.unit(problem.model.defaults), np.zeros(len(coefficients))])
    sizes = {f"{effect.id}.{effect.parameters[0].name}" for effect in problem.model.effects}
    is_size = [parameter.name in sizes for parameter in problem.parameters] + [False] * len(coefficients)
    pull = np.where(is_size, hold * (joint - neutral), 0.0)
    lower, upper = -joint, 1.0 - joint
    lower[free:], upper[free:] = -np.inf, np.inf
    solutions = np.empty((len(normal_matrices), len(joint)))
    for index, (matrix_of_piece, gradient_of_piece) in enumerate(zip(normal_matrices, gradients, strict=True)):
        rest = matrix - matrix_of_piece
        only_here = np.diag(rest) <= NO_INFORMATION * np.diag(matrix)
        # What no piece determines, such as a second parameter of what is absent, stays where it is.
        new = np.where(only_here & (np.diag(matrix) > 0.0), neutral, joint)
        chosen = np.flatnonzero(~only_here)
        step = bounded_step(
            rest[np.ix_(chosen, chosen)] + np.diag(1e-9 * np.diag(rest)[chosen] + hold[chosen]),
            (gradient - gradient_of_piece + pull)[chosen],
            lower[chosen],
            upper[chosen],
        )
        new[chosen] = joint[chosen] + step
        solutions[index] = new
    return problem.theta(np.clip(solutions[:, :free], 0.0, 1.0)), solutions[:, free:]


def scaled_inverse(matrix: Array, least: float) -> Array:
    """Invert a normal matrix after scaling all parameters alike; eigenvalues below ``least`` are taken as ``least``.

    A parameter on which nothing depends has a very large variance that is finite, also where nothing depends on any.
    """
    largest = np.diag(matrix).max(initial=0.0) or 1.0
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-12 * largest))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return np.asarray((vectors / np.maximum(values, least)) @ vectors.T / np.outer(size, size))


def held_out_errors(
    problem: WeightedProblem, thetas: Array, coefficients: Array, folds: Sequence[tuple[int, slice]]
) -> tuple[Array, Array, Array]:
    """Sum the squared errors of each fold with its own parameters and coefficients of the remainder: white, in N², and over
    the noise variance.
    """

    def errors_of(index: int) -> tuple[float, float, float]:
        run, fold = folds[index]
        start = problem.blocks[run].start
        samples = slice(fold.start - start, fold.stop - start)
        error = error_of_run(problem, thetas[index], run, coefficients[index])
        white, newtons = error.white[samples], error.newtons[samples]
        relative = newtons / problem.sigmas[run][samples]
        return sum_of_squares(white), sum_of_squares(newtons), sum_of_squares(relative)

    white, newtons, relative = np.array(in_threads(errors_of, range(len(folds)))).T
    return white, newtons, relative


def costs_of_halves(refitted: Refit) -> Array:
    """Return the sum of squared white residuals (2,) of every second fold, predicted from the others."""
    problem, folds = refitted.problem, refitted.folds
    halves = [np.arange(first, len(folds), 2) for first in (0, 1)]
    matrices = np.stack([refitted.normal_matrices[half].sum(axis=0) for half in halves])
    gradients = np.stack([refitted.gradients[half].sum(axis=0) for half in halves])
    thetas, coefficients = without_each(problem, problem.unit(refitted.theta), refitted.coefficients, matrices, gradients)
    costs = []
    for half, theta, of_remainder in zip(halves, thetas, coefficients, strict=True):
        pieces = [folds[index] for index in half]
        shape = (len(pieces), 1)
        white, _, _ = held_out_errors(problem, np.tile(theta, shape), np.tile(of_remainder, shape), pieces)
        costs.append(float(white.sum()))
    return np.array(costs)
