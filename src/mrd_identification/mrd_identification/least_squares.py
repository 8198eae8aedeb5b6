"""Least squares from candidates of the front."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from mrd_identification.nsga2 import Front
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

BOUND_TOLERANCE = 1e-6
"""of the unit box: closer than this is on the bound."""

LEAST_DAMPING = 1e-11
"""Keeps the normal equations regular where two parameters do the same."""


def fit_least_squares(problem: Problem, theta: Array, max_evaluations: int = 100) -> tuple[Array, float]:
    """Local least squares on all counted residuals within the bounds.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
        Where to start.
    max_evaluations : int

    Returns
    -------
    theta : ndarray (parameters,)
    cost : float
        Half the sum of the loss in N².
    """
    unit, cost = levenberg_marquardt(problem, problem.unit(theta), np.arange(len(problem.free)), max_evaluations)
    return problem.theta(unit), cost


def levenberg_marquardt(
    problem: Problem, unit: Array, moving: NDArray[np.intp], max_evaluations: int, tolerance: float = 1e-10, renewal: int = 1
) -> tuple[Array, float]:
    """Point of the unit box where the objective is least over the coordinates ``moving``, near ``unit``, and its cost.

    Levenberg-Marquardt (Marquardt, 1963) with Nielsen's (1999) damping, each step the optimum of its parabola within the
    box, from the normal equations: with exact derivatives of a few scaled parameters these are as good as a factorisation of
    all samples, which would take longer than the model itself. A robust loss weighs the residuals anew at each step.

    With a ``renewal`` above 1 the derivatives are computed only every so many steps, and corrected by what a step has shown
    (Broyden, 1965) between: worth it where the model takes long.
    """
    unit = np.clip(unit, 0.0, 1.0)
    residuals = problem.residuals(problem.theta(unit))
    cost = _cost(problem, unit, residuals)
    damping, growth, left = 1e-3, 2.0, max_evaluations - 1
    age, sensitivity = renewal, np.empty(0)
    while left > 0 and np.isfinite(cost):
        root = problem.robust_weights(residuals)
        if age >= renewal:
            age, sensitivity = 0, problem.jacobian(unit, moving)
        jacobian = sensitivity * root[:, None]
        gram, slope = jacobian.T @ jacobian, jacobian.T @ (residuals * root)
        if not (np.isfinite(gram).all() and gram.any()):
            break
        size = np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max())
        while left > 0:
            damped = gram + damping * np.diag(size)
            step = bounded_step(damped, slope, -unit[moving], 1.0 - unit[moving])
            trial = unit.copy()
            trial[moving] = np.clip(unit[moving] + step, 0.0, 1.0)
            step = trial[moving] - unit[moving]
            expected = -(slope @ step + 0.5 * step @ gram @ step)
            if expected <= 1e-3 * tolerance * cost or np.abs(step).max() <= tolerance * 1e-3:
                return unit, cost
            before, residuals = residuals, problem.residuals(problem.theta(trial))
            left -= 1
            reached = _cost(problem, trial, residuals)
            gain = float((cost - reached) / expected) if np.isfinite(reached) else -1.0
            if gain > 1e-4:
                break
            residuals = before
            damping, growth = damping * growth, 2.0 * growth
            if age:
                break
        else:
            break
        if gain <= 1e-4:  # old derivatives have misled
            age = renewal
            continue
        age += 1
        if age < renewal:
            surprise = residuals - before - sensitivity @ step
            sensitivity += np.outer(surprise, step / (step @ step))
        settled = cost - reached <= tolerance * cost and gain > 0.25
        damping, growth = max(LEAST_DAMPING, damping * max(1 / 3, 1.0 - (2.0 * gain - 1.0) ** 3)), 2.0
        unit, cost = trial, reached
        if settled:
            break
    return unit, cost


def _cost(problem: Problem, unit: Array, residuals: Array) -> float:
    return float(0.5 * residuals @ residuals) if problem.loss == "linear" else problem.cost(problem.theta(unit))


def bounded_step(gram: Array, slope: Array, lower: Array, upper: Array) -> Array:
    """Where within the bounds the parabola with this Hessian and slope is least."""
    size = np.sqrt(np.diag(gram))
    root, _ = cho_factor(gram / np.outer(size, size), lower=True)
    step = -cho_solve((root, True), slope / size) / size
    if ((step >= lower) & (step <= upper)).all():
        return np.asarray(step)
    right = -solve_triangular(root, slope / size, lower=True)
    return np.asarray(lsq_linear(np.tril(root).T * size, right, bounds=(lower, upper), method="bvls").x)


def fit_from_front(problem: Problem, front: Front) -> Array:
    """Optimum (parameters,) of least squares from the ends and the knee of a front, briefly; the best goes on."""
    starts = np.unique([0, front.knee, len(front.thetas) - 1])
    brief = [fit_least_squares(problem, front.thetas[start], 12) for start in starts]
    return fit_least_squares(problem, min(brief, key=lambda found: found[1])[0])[0]


def with_loss_scale(problem: Problem, front: Front) -> Problem:
    """The problem with its robust loss scaled to the residuals of the front's best candidate (Huber's 1.345 sigma)."""
    if problem.loss == "linear":
        return problem
    residuals = problem.residuals(front.thetas[0])
    sigma = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    return replace(problem, loss_scale=max(1.345 * sigma, 1e-9))
