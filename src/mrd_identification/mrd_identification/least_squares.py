"""Nonlinear least squares within bounds, from candidates of the Pareto front."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.optimize import lsq_linear

from mrd_identification.nsga2 import Front
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

BOUND_TOLERANCE = 1e-6
"""Unit coordinate; a parameter closer to its bound than this is on the bound."""

LEAST_DAMPING = 1e-11
"""Relative to the normal matrix; keeps it positive definite where two parameters have the same effect."""

LEAST_GAIN = 1e-4
"""Actual over expected decrease of the objective above which a step is accepted."""

GOOD_GAIN = 0.25
"""Actual over expected decrease above which a small decrease means that the optimum is reached."""

BRIEF_EVALUATIONS = 12
"""Evaluations that show which of several starts leads to the best optimum."""

NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""

HUBER = 1.345
"""Huber's (1981) threshold in standard deviations, which has 95 % efficiency for normally distributed residuals."""


def fit_least_squares(problem: Problem, theta: Array, max_evaluations: int = 100) -> tuple[Array, float]:
    """Find the local optimum of the objective within the bounds, over all free parameters.

    Parameters
    ----------
    problem : Problem
    theta : ndarray (parameters,)
        Start of the search.
    max_evaluations : int

    Returns
    -------
    theta : ndarray (parameters,)
    cost : float
        Half the sum of the loss in N².
    """
    unit, cost = levenberg_marquardt(problem, problem.unit(theta), np.arange(len(problem.free)), max_evaluations)
    return problem.theta(unit), cost


# A trial that diverges, as a damper of negative viscosity does behind a spring, costs too much: that is no news.
@np.errstate(over="ignore", invalid="ignore")
def levenberg_marquardt(
    problem: Problem,
    unit: Array,
    moving: NDArray[np.intp],
    max_evaluations: int,
    tolerance: float = 1e-10,
    renewal: int = 1,
    sensitivity: Array | None = None,
) -> tuple[Array, float]:
    """Return the optimum near ``unit``, a point of the unit box, over the coordinates ``moving``, and its cost.

    Levenberg-Marquardt (Marquardt, 1963) with Nielsen's (1999) damping. Each step is the minimum of the local parabola
    within the box, from the normal equations: with exact derivatives of a few scaled parameters these are as accurate as a
    factorisation of all samples, which would take longer than the model itself. A robust loss reweights the residuals at
    each step.

    With a ``renewal`` above 1 the derivatives are computed only every ``renewal`` steps, and corrected between from the
    residuals of each step (Broyden, 1965): this saves time where the model is slow. The first ones may be given as
    ``sensitivity`` (samples, moving), roughly.
    """
    unit = np.clip(unit, 0.0, 1.0)
    residuals = problem.residuals(problem.theta(unit))
    cost = _cost(problem, unit, residuals)
    damping, growth, evaluations_left = 1e-3, 2.0, max_evaluations - 1
    age = renewal if sensitivity is None else 1
    while evaluations_left > 0 and np.isfinite(cost):
        root = problem.robust_weights(residuals)
        if sensitivity is None or age >= renewal:
            age, sensitivity = 0, problem.jacobian(unit, moving)
        jacobian = sensitivity * root[:, None]
        gram, gradient = jacobian.T @ jacobian, jacobian.T @ (residuals * root)
        if not (np.isfinite(gram).all() and gram.any()):
            break
        while evaluations_left > 0:
            trial, step = _damped_step(gram, gradient, damping, unit, moving)
            expected = -(gradient @ step + 0.5 * step @ gram @ step)
            if expected <= 1e-3 * tolerance * cost or np.abs(step).max() <= tolerance * 1e-3:
                return unit, cost
            previous, residuals = residuals, problem.residuals(problem.theta(trial))
            evaluations_left -= 1
            trial_cost = _cost(problem, trial, residuals)
            gain = float((cost - trial_cost) / expected) if np.isfinite(trial_cost) else -1.0
            if gain > LEAST_GAIN:
                break
            residuals = previous
            damping, growth = damping * growth, 2.0 * growth
            if age:
                break
        else:
            break
        if gain <= LEAST_GAIN:  # Derivatives of an earlier step gave a wrong direction.
            age = renewal
            continue
        age += 1
        if age < renewal:
            unpredicted = residuals - previous - sensitivity @ step
            sensitivity += np.outer(unpredicted, step / (step @ step))
        converged = cost - trial_cost <= tolerance * cost and gain > GOOD_GAIN
        damping, growth = max(LEAST_DAMPING, damping * max(1 / 3, 1.0 - (2.0 * gain - 1.0) ** 3)), 2.0
        unit, cost = trial, trial_cost
        if converged:
            break
    return unit, cost


def _damped_step(gram: Array, gradient: Array, damping: float, unit: Array, moving: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the next point of the unit box, and the step to it in the coordinates ``moving``."""
    size = np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max())
    step = bounded_step(gram + damping * np.diag(size), gradient, -unit[moving], 1.0 - unit[moving])
    trial = unit.copy()
    trial[moving] = np.clip(unit[moving] + step, 0.0, 1.0)
    return trial, trial[moving] - unit[moving]


def _cost(problem: Problem, unit: Array, residuals: Array) -> float:
    return float(0.5 * residuals @ residuals) if problem.loss == "linear" else problem.cost(problem.theta(unit))


def bounded_step(gram: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """Return the minimum, within bounds, of the parabola with the Hessian ``gram`` and this gradient."""
    size = np.sqrt(np.diag(gram))
    root, _ = cho_factor(gram / np.outer(size, size), lower=True)
    step = -cho_solve((root, True), gradient / size) / size
    if ((step >= lower) & (step <= upper)).all():
        return np.asarray(step)
    right = -solve_triangular(root, gradient / size, lower=True)
    return np.asarray(lsq_linear(np.tril(root).T * size, right, bounds=(lower, upper), method="bvls").x)


def fit_from_front(problem: Problem, front: Front) -> Array:
    """Return the least squares optimum (parameters,) from a Pareto front.

    A few steps start at both ends and at the knee; the best of these three is continued.
    """
    starts = np.unique([0, front.knee, len(front.thetas) - 1])
    brief = [fit_least_squares(problem, front.thetas[start], BRIEF_EVALUATIONS) for start in starts]
    best, _ = min(brief, key=lambda theta_and_cost: theta_and_cost[1])
    return fit_least_squares(problem, best)[0]


def with_loss_scale(problem: Problem, front: Front) -> Problem:
    """Return the problem with its robust loss scaled to the residuals of the front's candidate with the least e2."""
    if problem.loss == "linear":
        return problem
    residuals = problem.residuals(front.thetas[0])
    sigma = NORMAL_MAD * float(np.median(np.abs(residuals - np.median(residuals))))
    return replace(problem, loss_scale=max(HUBER * sigma, 1e-9))
