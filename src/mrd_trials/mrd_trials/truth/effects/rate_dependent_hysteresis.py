"""Viscous branches of the fluid that relax, stiffer with the current."""

import math

from numba import njit

from mrd_trials.truth.effects.true_effect import PlantValues, TrueEffect, development, evaluation, shape, size

TWO_BRANCHES, THINNING_DASHPOT, SPRINGPOT = range(3)

BRANCHES = 3
"""Largest number of branches in parallel."""

FLOW_SPEED = 0.03
"""Speed in m/s at which the dashpot of a thinning branch has half its viscosity."""

VISCOUS, GROWTH = size("viscous", 1000.0, 3000.0), shape("growth", 1.0, 3.0)
RELAXATION = shape("relaxation", 0.006, 0.04, logarithmic=True)

EFFECT = TrueEffect(
    "rate_dependent_hysteresis",
    "Viscous branches that relax",
    (
        development(
            "two_branches", "two relaxation times, one a sixth of the other (Wiechert 1893)", VISCOUS, GROWTH, RELAXATION
        ),
        development(
            "thinning_dashpot",
            "the dashpot flows more easily under force (White & Metzner 1963)",
            VISCOUS,
            GROWTH,
            RELAXATION,
        ),
        evaluation(
            "springpot",
            "derivative of fractional order by a spread of relaxation times (Bagley & Torvik 1983)",
            VISCOUS,
            GROWTH,
            RELAXATION,
        ),
    ),
)


@njit(cache=True, nogil=True)
def _branch(p: PlantValues, k: int) -> tuple[float, float]:
    """Return the share of a branch and its relaxation time over the given one; a share of 0 is no branch."""
    if p.rate_dependent_hysteresis_viscous == 0.0:
        return 0.0, 1.0
    if p.rate_dependent_hysteresis_formula == SPRINGPOT:
        return (0.5, 1.0) if k == 0 else (0.25, 4.0) if k == 1 else (0.25, 0.25)
    if p.rate_dependent_hysteresis_formula == TWO_BRANCHES:
        return (0.7, 1.0) if k == 0 else (0.3, 1.0 / 6.0) if k == 1 else (0.0, 1.0)
    return (1.0, 1.0) if k == 0 else (0.0, 1.0)


@njit(cache=True, nogil=True)
def branch_elongation(p: PlantValues, k: int, e: float, dx: float, step: float) -> float:
    """Return the elongation of a branch's spring after a motion at constant speed."""
    share, factor = _branch(p, k)
    if share == 0.0:
        return 0.0
    relaxation = factor * p.rate_dependent_hysteresis_relaxation
    if p.rate_dependent_hysteresis_formula == THINNING_DASHPOT:
        relaxation /= 1.0 + abs(e) / (relaxation * FLOW_SPEED)
    steady = dx / step * relaxation
    return float(steady + (e - steady) * math.exp(-step / relaxation))


@njit(cache=True, nogil=True)
def branch_force(p: PlantValues, k: int, e: float, current: float) -> float:
    """Return the force (N) of a branch, whose spring stiffens with the current."""
    share, factor = _branch(p, k)
    if share == 0.0:
        return 0.0
    viscous = p.rate_dependent_hysteresis_viscous * (1.0 + p.rate_dependent_hysteresis_growth * current)
    return float(share * viscous * e / (factor * p.rate_dependent_hysteresis_relaxation))
