"""Least squares from candidates of the front."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mrd_identification.nsga2 import Front
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

BORDER = 1e-6
"""of the unit box: closer than this is on the bound."""


def polish(problem: Problem, theta: Array, max_evaluations: int = 100) -> tuple[Array, float]:
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
    found = least_squares(
        lambda unit: problem.residuals(problem.theta(unit)),
        # trf needs a start strictly inside.
        np.clip(problem.unit(theta), 1e-4, 1 - 1e-4),
        jac=problem.jacobian,
        bounds=(0.0, 1.0),
        x_scale="jac",
        loss=problem.loss,
        f_scale=problem.loss_scale,
        max_nfev=max_evaluations,
        xtol=1e-10,
        ftol=1e-10,
    )
    on_lower, on_upper = found.x < BORDER, found.x > 1 - BORDER
    return problem.theta(np.where(on_lower, 0.0, np.where(on_upper, 1.0, found.x))), float(found.cost)


def polish_front(problem: Problem, front: Front) -> Array:
    """Optimum (parameters,) of least squares from the ends and the knee of a front, briefly; the best goes on."""
    starts = np.unique([0, front.knee, len(front.thetas) - 1])
    brief = [polish(problem, front.thetas[start], 12) for start in starts]
    return polish(problem, min(brief, key=lambda found: found[1])[0])[0]


def with_loss_scale(problem: Problem, front: Front) -> Problem:
    """The problem with its robust loss scaled to the residuals of the front's best candidate (Huber's 1.345 sigma)."""
    if problem.loss == "linear":
        return problem
    residuals = problem.residuals(front.thetas[0])
    sigma = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    return replace(problem, loss_scale=max(1.345 * sigma, 1e-9))
