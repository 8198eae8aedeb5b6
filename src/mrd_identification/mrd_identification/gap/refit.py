"""Refits that know the noise floor and what differs from run to run, each judged on what it has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mrd_identification.polish import bounded_step, descend
from mrd_identification.problem import Problem, in_threads

Array = NDArray[np.float64]

FREEZING = 1e-6
"""Information about a parameter, relative to what all parts together have, below which the rest say nothing about it."""


@dataclass(frozen=True)
class Scatter:
    """What differs from run to run though nothing of physics does: standard deviations.

    Attributes
    ----------
    gain : float
        Of the force's scale, relative.
    offset : float
        Of its zero, N.
    """

    gain: float
    offset: float


@dataclass(frozen=True)
class Whitening:
    """Makes the errors of a run, if they were noise and scatter, white with variance one.

    The errors of a run have the covariance diag(sigma²) + B diag(gain², offset²) Bᵀ, the columns of B being the run's force
    and one; their symmetric inverse root is a weight and a correction of rank two.

    Attributes
    ----------
    weight : ndarray (n,)
        1 / sigma.
    basis : ndarray (n, 2)
        Orthonormal, spans what gain and offset can do.
    damping : ndarray (2,)
        Share that is taken out.
    own : ndarray (2, n)
        Gain and offset of the run follow from its errors by this matrix.
    """

    weight: Array
    basis: Array
    damping: Array
    own: Array

    def __call__(self, errors: Array) -> Array:
        """White errors (n,) or (n, columns)."""
        white = (errors.T * self.weight).T
        return np.asarray(white - self.basis @ ((self.basis.T @ white).T * self.damping).T)


def whitening(sigma: Array, force: Array, scatter: Scatter) -> Whitening:
    """Whitening of a run from its noise ``sigma`` (n,) in N, its modelled ``force`` (n,) and the scatter of runs."""
    weight = 1.0 / sigma
    nuisance = np.stack([scatter.gain * force, np.full_like(force, scatter.offset)], axis=1)
    scaled = nuisance * weight[:, None]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, 1e-12)
    basis = scaled @ vectors / np.sqrt(values)
    own = np.linalg.solve(scaled.T @ scaled + np.eye(2), scaled.T * weight)
    return Whitening(weight, basis, 1.0 - 1.0 / np.sqrt(1.0 + values), np.array([[scatter.gain], [scatter.offset]]) * own)


@dataclass(frozen=True)
class GapProblem(Problem):
    """A problem whose residuals are white where the model is true.

    Attributes
    ----------
    whitenings : tuple of Whitening
        One for each run.
    """

    whitenings: tuple[Whitening, ...] = ()

    @cached_property
    def _alike(self) -> bool:
        return False

    def _counted(self, errors: Array) -> Array:
        return np.concatenate([white(errors[block]) for white, block in zip(self.whitenings, self.blocks, strict=True)])


def parts_of(problem: Problem, count: int) -> list[tuple[int, slice]]:
    """Each run cut into ``count`` parts of equal length: place of the run, and samples among all that count."""
    parts = []
    for run, block in enumerate(problem.blocks):
        edges = np.linspace(block.start, block.stop, count + 1).astype(int)
        parts += [(run, slice(int(a), int(b))) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    return parts


@dataclass(frozen=True)
class Refit:
    """A model refitted to all runs, and to all but each part.

    Attributes
    ----------
    problem : GapProblem
    theta : ndarray (parameters,)
        Fitted to everything.
    cost : ndarray (parts,)
        Squared white residual of each part.
    unseen : ndarray (parts,)
        The same of parameters that have not seen the part.
    thetas : ndarray (parts, parameters)
        These parameters.
    """

    problem: GapProblem
    theta: Array
    cost: Array
    unseen: Array
    thetas: Array

    @property
    def total(self) -> float:
        """Squared white residual of everything, unseen."""
        return float(self.unseen.sum())


def refit(problem: GapProblem, start: Array, parts: Sequence[tuple[int, slice]], evaluations: int = 40) -> Refit:
    """Fit a model to all runs, then without each part in turn.

    Leaving a part out moves the optimum a little: one Gauss-Newton step with the part's share of the normal equations taken
    out finds it without fitting anew. A parameter of which only that part tells keeps its neutral value, if it has one.

    Parameters
    ----------
    problem : GapProblem
    start : ndarray (parameters,)
    parts : sequence of (int, slice)
        See `parts_of`.
    evaluations : int
        At most.
    """
    unit, _ = descend(problem, problem.unit(start), np.arange(len(problem.free)), evaluations, 1e-6, renewal=3)
    theta = problem.theta(unit)
    residuals, jacobian = problem.residuals(theta), problem.jacobian(unit)
    grams = np.stack([jacobian[part].T @ jacobian[part] for _, part in parts])
    slopes = np.stack([jacobian[part].T @ residuals[part] for _, part in parts])
    cost = np.array([residuals[part] @ residuals[part] for _, part in parts])
    units = without_each(unit, grams, slopes, problem.unit(problem.model.defaults))
    thetas = problem.theta(units)
    return Refit(problem, theta, cost, unseen_cost(problem, thetas, parts), thetas)


def without_each(unit: Array, grams: Array, slopes: Array, neutral: Array) -> Array:
    """Optimum (parts, free) in the unit box without each part, given normal matrices and slopes of the parts at ``unit``."""
    gram, slope = grams.sum(axis=0), slopes.sum(axis=0)
    found = np.empty((len(grams), len(unit)))
    for index, (own, pull) in enumerate(zip(grams, slopes, strict=True)):
        rest = gram - own
        told = np.diag(rest) > FREEZING * np.maximum(np.diag(gram), 1e-300)
        moved = np.where(told, unit, neutral)
        chosen = np.flatnonzero(told)
        step = bounded_step(
            rest[np.ix_(chosen, chosen)] + 1e-9 * np.diag(np.diag(rest)[chosen]), (slope - pull)[chosen],
            -unit[chosen], 1.0 - unit[chosen],
        )
        moved[chosen] = unit[chosen] + step
        found[index] = np.clip(moved, 0.0, 1.0)
    return found


def unseen_cost(problem: GapProblem, thetas: Array, parts: Sequence[tuple[int, slice]]) -> Array:
    """Squared white residual of each part with parameters of its own."""

    def of(index: int) -> float:
        run, part = parts[index]
        error = problem.modelled(thetas[index], run) - problem.recordings[run].force
        start = problem.blocks[run].start
        white = problem.whitenings[run](error)[part.start - start : part.stop - start]
        return float(white @ white)

    return np.array(in_threads(of, range(len(parts))))
