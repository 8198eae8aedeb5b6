"""Stacking: the damper models around which causes are judged are those that add most to a joint prediction."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.thresholds import THRESHOLDS

Array = NDArray[np.float64]

MOST_FORMS = 3
"""Damper models around which a cause is judged."""


def stacked_forms(own: Refit, others: Sequence[Refit]) -> list[Refit]:
    """Return the damper models with the largest weights; first the one around which causes are searched.

    Of refits of one model with more or less freedom, the best counts. Among the models that predict about as well as the
    best, the first is the one with the largest weight: another one may err in the same places and in more. The user's
    ``own`` model is preferred where it is among them and has a weight of its own.
    """
    best_by_model: dict[str, Refit] = {}
    for refitted in sorted([own, *others], key=lambda refitted: (refitted.held_out_cost, refitted is not own)):
        best_by_model.setdefault(refitted.problem.model.id, refitted)
    if best_by_model[own.problem.model.id].held_out_cost > own.held_out_cost * (1.0 - THRESHOLDS.formula_error):
        best_by_model[own.problem.model.id] = own
    forms = list(best_by_model.values())
    weights = stacking_weights(forms)
    best = min(form.held_out_cost for form in forms)

    def rank(index: int) -> tuple[bool, bool, float]:
        worse = forms[index].held_out_cost * (1.0 - THRESHOLDS.formula_error) > best
        preferred = forms[index] is own and weights[index] >= THRESHOLDS.listed_probability
        return worse, not preferred, -weights[index]

    first = min(range(len(forms)), key=rank)
    counted = sorted(range(len(forms)), key=lambda index: (index != first, -weights[index]))[:MOST_FORMS]
    return [forms[index] for index in counted]


def stacking_weights(refits: Sequence[Refit]) -> Array:
    """Return the weights (refits,) with which models together predict best: none negative, one in sum.

    They minimise the squared error of the weighted prediction (stacked regressions; Breiman, 1996). The errors are those of
    the joint fit: each model has few parameters for the samples.
    """
    errors = np.stack([refitted.problem.residuals(refitted.theta) for refitted in refits], axis=1)
    sum_is_one = 100.0 * np.linalg.norm(errors)
    matrix = np.linalg.cholesky(errors.T @ errors + sum_is_one**2 + 1e-9 * sum_is_one**2 * np.eye(len(refits))).T
    target = np.linalg.solve(matrix.T, np.full(len(refits), sum_is_one**2))
    weights = nnls(matrix, target)[0]
    return np.asarray(weights / weights.sum())
