"""Run scatter: how much gain and offset of the force differ from run to run, estimated from the errors of a refit."""

import numpy as np

from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.weighting import RunScatter, usual_run_scatter

LEAST_RUN_SCATTER, LARGEST_RUN_SCATTER = RunScatter(1e-3, 1e-4), RunScatter(0.04, 0.02)
"""Least scatter of the runs of any bench, and the largest that is still attributed to the bench and not to physics; offsets
are shares of half the span of the force."""

ROUNDS = 50
"""Rounds of expectation maximisation."""


def estimate_run_scatter(refitted: Refit) -> RunScatter:
    """Estimate the scatter of gain and offset of runs by expectation maximisation from the errors that a refit leaves."""
    problem = refitted.problem
    known = []
    for index, block in enumerate(problem.blocks):
        whitening = problem.whitenings[index]
        columns = whitening.nuisance[:, :2] * whitening.weight[:, None]
        error = (problem.modelled(refitted.theta, index) - problem.force[block]) * whitening.weight
        # A gap is not noise: the larger it is, the less certain are offset and gain of the run.
        known.append((columns.T @ columns, columns.T @ error, max(1.0, float(np.mean(error**2)))))
    scales = problem.model.scales
    usual = usual_run_scatter(scales)
    variance = np.array([usual.gain**2, usual.offset**2])
    least, largest = (
        [limit.gain**2, (limit.offset * scales.force) ** 2] for limit in (LEAST_RUN_SCATTER, LARGEST_RUN_SCATTER)
    )
    for _ in range(ROUNDS):
        moments = []
        for matrix, right, chi_square in known:
            covariance = np.linalg.inv(matrix / chi_square + np.diag(1 / variance))
            moments.append((covariance @ right / chi_square) ** 2 + np.diag(covariance))
        variance = np.clip(np.mean(moments, axis=0), least, largest)
    return RunScatter(float(np.sqrt(variance[0])), float(np.sqrt(variance[1])))
