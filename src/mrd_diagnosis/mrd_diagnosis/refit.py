"""Refits that know the noise floor and what differs from run to run, each judged on what it has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mrd_identification.least_squares import bounded_step, levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem

Array = NDArray[np.float64]

EVALUATIONS = 40
"""Of a model, at most, until its refit is good enough."""

SETTLED = 1e-6
"""Relative decrease of the cost below which a refit is done."""

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
    reference : ndarray (n,)
        N, what the gain multiplies.
    """

    weight: Array
    basis: Array
    damping: Array
    own: Array
    reference: Array

    def __call__(self, errors: Array) -> Array:
        """White errors (n,) or (n, columns)."""
        white = (errors.T * self.weight).T
        return np.asarray(white - self.basis @ ((self.basis.T @ white).T * self.damping).T)

    def silent(self) -> "Whitening":
        """One that counts nothing of its run."""
        return replace(self, weight=np.zeros_like(self.weight), basis=np.zeros_like(self.basis))


def whitening(sigma: Array, force: Array, scatter: Scatter) -> Whitening:
    """Whitening of a run from its noise ``sigma`` (n,) in N, its modelled ``force`` (n,) and the scatter of runs."""
    weight = 1.0 / sigma
    nuisance = np.stack([scatter.gain * force, np.full_like(force, scatter.offset)], axis=1)
    scaled = nuisance * weight[:, None]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, 1e-12)
    basis = scaled @ vectors / np.sqrt(values)
    own = np.asarray(np.linalg.solve(scaled.T @ scaled + np.eye(2), scaled.T * weight), np.float64)
    own *= np.array([[scatter.gain], [scatter.offset]])
    return Whitening(weight, basis, 1.0 - 1.0 / np.sqrt(1.0 + values), own, force)


@dataclass(frozen=True)
class GapProblem(Problem):
    """A problem whose residuals are white where the model is true.

    Attributes
    ----------
    whitenings : tuple of Whitening
        One for each run.
    sigmas : tuple of ndarray
        Noise of each run in N at the counted samples.
    """

    whitenings: tuple[Whitening, ...] = ()
    sigmas: tuple[Array, ...] = ()

    @cached_property
    def _alike(self) -> bool:
        return False

    def counted(self, errors: Array) -> Array:
        """White errors (samples,)."""
        return np.concatenate([white(errors[block]) for white, block in zip(self.whitenings, self.blocks, strict=True)])


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
    plain : ndarray (parts,)
        Squared error in N² of these parameters on the part, the run's own offset and gain taken out.
    noises : ndarray (parts,)
        The same over the variance of the noise alone.
    grams : ndarray (parts, free, free)
        Normal matrices of the parts at the optimum.
    slopes : ndarray (parts, free)
        Derivative of half the cost of each part.
    means : ndarray (free,)
        Derivatives times the white change of the force if its samples were means over the sampling period.
    nulls : ndarray (parts, draws, free)
        Derivatives times white errors that are nothing but noise, see `refit`.
    """

    problem: GapProblem
    theta: Array
    cost: Array
    unseen: Array
    plain: Array
    noises: Array
    grams: Array
    slopes: Array
    means: Array
    nulls: Array

    @property
    def total(self) -> float:
        """Squared white residual of everything, unseen."""
        total = float(self.unseen.sum())
        return total if np.isfinite(total) else np.inf

    @property
    def level(self) -> float:
        """Mean squared error over the variance of the noise, unseen: 1 where nothing is missing."""
        return float(self.noises.sum() / len(self.problem.force))


def refit(
    problem: GapProblem,
    start: Array,
    parts: Sequence[tuple[int, slice]],
    noise: Sequence[Array] = (),
    settled: float = SETTLED,
) -> Refit:
    """Fit a model to all runs, then without each part in turn.

    Leaving a part out moves the optimum a little: one Gauss-Newton step with the part's share of the normal equations taken
    out finds it without fitting anew. A parameter of which only that part tells keeps its neutral value, if it has one.

    Parameters
    ----------
    problem : GapProblem
    start : ndarray (parameters,)
    parts : sequence of (int, slice)
        See `mrd_diagnosis.weighting.Ground.parts`.
    noise : sequence of ndarray (draws, n), optional
        White errors of each run if there were no gap.
    settled : float
        Relative decrease of the cost below which the fit is done.
    """
    unit, _ = levenberg_marquardt(
        problem, problem.unit(start), np.arange(len(problem.free)), EVALUATIONS, settled, renewal=3
    )
    theta = problem.theta(unit)
    force, jacobian = problem.forces(theta), problem.jacobian(unit)
    residuals = problem.counted(force - problem.force)
    grams = np.stack([jacobian[part].T @ jacobian[part] for _, part in parts])
    slopes = np.stack([jacobian[part].T @ residuals[part] for _, part in parts])
    cost = np.array([residuals[part] @ residuals[part] for _, part in parts])
    joined = np.concatenate(noise, axis=1) if len(noise) else np.empty((0, len(residuals)))
    nulls = [joined[:, part] @ jacobian[part] for _, part in parts]
    means = jacobian.T @ problem.counted(blurred(force, problem.blocks) - force)
    thetas = without_each(problem, unit, grams, slopes)
    unseen, plain, noises = unseen_cost(problem, thetas, parts)
    return Refit(problem, theta, cost, unseen, plain, noises, grams, slopes, means, np.array(nulls))


def blurred(series: Array, blocks: Sequence[slice]) -> Array:
    """Means (n,) over the sampling period around each sample of runs, between samples as on straight lines."""
    found = series.copy()
    for block in blocks:
        found[block][1:-1] += np.diff(series[block], 2) / 8.0
    return found


def without_each(problem: Problem, unit: Array, grams: Array, slopes: Array) -> Array:
    """Parameters (pieces, parameters) without each piece of the recordings.

    Given the normal matrices (pieces, free, free) and slopes (pieces, free) of the pieces at the joint optimum ``unit``.
    """
    gram, slope = grams.sum(axis=0), slopes.sum(axis=0)
    neutral = problem.unit(problem.model.defaults)
    found = np.empty((len(grams), len(unit)))
    for index, (own, pull) in enumerate(zip(grams, slopes, strict=True)):
        rest = gram - own
        told = np.diag(rest) > FREEZING * np.maximum(np.diag(gram), 1e-300)
        moved = np.where(told, unit, neutral)
        chosen = np.flatnonzero(told)
        step = bounded_step(
            rest[np.ix_(chosen, chosen)] + 1e-9 * np.diag(np.diag(rest)[chosen]),
            (slope - pull)[chosen],
            -unit[chosen],
            1.0 - unit[chosen],
        )
        moved[chosen] = unit[chosen] + step
        found[index] = np.clip(moved, 0.0, 1.0)
    return problem.theta(found)


def scaled_inverse(gram: Array, least: float) -> Array:
    """Inverse of a normal matrix, its eigenvalues, all parameters on one scale, taken to be ``least`` at least."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max()))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    return np.asarray((vectors / np.maximum(values, least)) @ vectors.T / np.outer(size, size))


def own_error(problem: GapProblem, theta: Array, run: int) -> tuple[Array, Array]:
    """Modelled minus measured force (n,) in N of a run: white, and plain without the run's own offset and gain."""
    error = problem.modelled(theta, run) - problem.recordings[run].force
    whitening = problem.whitenings[run]
    gain, offset = whitening.own @ error
    return whitening(error), error - gain * whitening.reference - offset


def unseen_cost(problem: GapProblem, thetas: Array, parts: Sequence[tuple[int, slice]]) -> tuple[Array, Array, Array]:
    """Squared error of each part with parameters of its own: white, in N², and over the variance of the noise alone."""

    def of(index: int) -> tuple[float, float, float]:
        run, part = parts[index]
        start = problem.blocks[run].start
        here = slice(part.start - start, part.stop - start)
        white, plain = (error[here] for error in own_error(problem, thetas[index], run))
        noisy = plain / problem.sigmas[run][here]
        return float(white @ white), float(plain @ plain), float(noisy @ noisy)

    white, plain, noisy = np.array(in_threads(of, range(len(parts)))).T
    return white, plain, noisy
