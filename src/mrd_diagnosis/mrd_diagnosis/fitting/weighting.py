"""Weighting of residuals: noise, model discrepancy and run-to-run scatter, which make true residuals white."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.diagnosis import RunNoise
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, consecutive_forces
from mrd_identification.residual_correlation import correlation_length
from mrd_identification.run_start import estimate_starts
from mrd_runs.scales import Scales
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

FOLD_DURATION = 4.0
"""Duration in s of a cross-validation fold: the errors within shorter ones depend on those of their neighbours too much."""

LEAST_FOLDS = 8
"""Folds of all runs together; fewer say too little about how much the error scatters."""

DIVERGED = 1e3
"""Ratio to the largest measured force beyond which a modelled force has diverged."""

MOST_FOLDS_OF_RUN = 3
"""Folds into which one of many runs is divided at most."""


@dataclass(frozen=True)
class RunScatter:
    """Standard deviations of what differs from run to run although no physics does.

    Attributes
    ----------
    gain : float
        Relative gain error of the force.
    offset : float
        Offset of the force in N.
    """

    gain: float
    offset: float


def usual_run_scatter(scales: Scales) -> RunScatter:
    """Return the scatter of the runs of one bench that is assumed before it is estimated."""
    return RunScatter(0.01, 0.002 * scales.force)


@dataclass(frozen=True)
class Whitening:
    """Linear map that makes the errors of a run white with variance one if they are noise and run scatter.

    The errors have the covariance diag(sigma²) + B Bᵀ. The columns of B are the run's force times the scatter of the gain,
    the scatter of the offset, and what other starts of the run would change. The symmetric inverse root of the covariance is
    a weight and a correction of low rank.

    Attributes
    ----------
    weight : ndarray (n,)
        1 / sigma.
    basis : ndarray (n, columns)
        Orthonormal basis of what gain, offset and start can change.
    damping : ndarray (columns,)
        Share that is removed along each basis vector.
    run_errors : ndarray (columns, n)
        Matrix that gives gain error, offset in N and start of the run from its errors.
    nuisance : ndarray (n, columns)
        What these sizes multiply: force in N for the gain, ones for the offset, and what other starts would change in N.
    """

    weight: Array
    basis: Array
    damping: Array
    run_errors: Array
    nuisance: Array

    def __call__(self, errors: Array) -> Array:
        """Return the white errors (n,) or (n, columns)."""
        white = (errors.T * self.weight).T
        return np.asarray(white - self.basis @ ((self.basis.T @ white).T * self.damping).T)

    def without_run_errors(self, errors: Array) -> Array:
        """Return errors (n,) in N without what is particular to the run: gain error, offset and start."""
        return np.asarray(errors - self.nuisance @ (self.run_errors @ errors))

    def without_weight(self) -> "Whitening":
        """Return a map that gives the run no weight."""
        return replace(self, weight=np.zeros_like(self.weight), basis=np.zeros_like(self.basis))


def whitening(sigma: Array, force: Array, scatter: RunScatter, other_starts: Array | None = None) -> Whitening:
    """Make the whitening of a run from its noise ``sigma`` (n,) in N, its modelled ``force`` (n,) and the run scatter.

    ``other_starts`` (n, k) in N is what other states at the first sample would change; any share of each may occur.
    """
    weight = 1.0 / sigma
    others = np.empty((len(force), 0)) if other_starts is None else other_starts
    nuisance = np.column_stack([force, np.ones_like(force), others])
    deviations = np.concatenate([[scatter.gain, scatter.offset], np.ones(others.shape[1])])
    scaled = nuisance * deviations * weight[:, None]
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, 1e-12)
    basis = scaled @ vectors / np.sqrt(values)
    run_errors = np.asarray(np.linalg.solve(scaled.T @ scaled + np.eye(len(values)), scaled.T * weight), np.float64)
    run_errors *= deviations[:, None]
    return Whitening(weight, basis, 1.0 - 1.0 / np.sqrt(1.0 + values), run_errors, nuisance)


def _bounded(force: Array, recording: Recording) -> Array:
    """Return a modelled force (n,) that is finite: one that has diverged tells nothing about the gain of a run."""
    largest = DIVERGED * float(np.abs(recording.force).max(initial=0.0))
    return np.asarray(np.clip(np.nan_to_num(force, nan=0.0), -largest, largest))


@dataclass(frozen=True)
class WeightedProblem(Problem):
    """A fitting problem whose residuals are white where the model is true.

    Attributes
    ----------
    whitenings : tuple of Whitening
        One for each run.
    sigmas : tuple of ndarray
        Noise of each run in N at the counted samples.
    remainder : tuple of ndarray (n, columns)
        Columns in N of a linear function that is added to the modelled force of each run, see
        `mrd_diagnosis.wrong_form.form_remainder`. The prior of its coefficients is a standard normal distribution. Empty
        where the model stands alone.
    unexplained : float
        See `Weighting`.
    """

    whitenings: tuple[Whitening, ...] = ()
    sigmas: tuple[Array, ...] = ()
    remainder: tuple[Array, ...] = ()
    unexplained: float = 0.0

    def whitened(self, errors: Array) -> Array:
        """Return the white errors (samples,)."""
        return np.concatenate([white(errors[block]) for white, block in zip(self.whitenings, self.blocks, strict=True)])

    def counted(self, errors: Array) -> Array:
        """Return the white errors (samples,) that the remainder leaves: their squares are the cost, penalty included."""
        white = self.whitened(errors)
        if not self.remainder:
            return white
        basis, damping = self._profile
        return np.asarray(white - basis @ (damping * (basis.T @ white)))

    @property
    def noise_cost(self) -> float:
        """Sum of squared white errors that noise alone contributes."""
        return float(sum(np.sum((s * w.weight) ** 2) for s, w in zip(self.sigmas, self.whitenings, strict=True)))

    @cached_property
    def white_remainder(self) -> Array:
        """The whitened columns (samples, columns) of the remainder."""
        if not self.remainder:
            return np.empty((len(self.force), 0))
        return np.concatenate([white(of_run) for white, of_run in zip(self.whitenings, self.remainder, strict=True)])

    @cached_property
    def _profile(self) -> tuple[Array, Array]:
        """Orthonormal basis of the remainder, and the share that it removes along each vector.

        With D the columns, the root of (I + D Dᵀ)⁻¹ maps errors to errors whose squares are the least penalised cost.
        """
        columns = self.white_remainder
        values, vectors = np.linalg.eigh(columns.T @ columns)
        values = np.maximum(values, 1e-12 * values[-1])
        return columns @ (vectors / np.sqrt(values)), 1.0 - 1.0 / np.sqrt(1.0 + values)

    def coefficients(self, theta: Array) -> Array:
        """Return the coefficients (columns,) of the remainder that fit best beside these parameters."""
        if not self.remainder:
            return np.empty(0)
        columns = self.white_remainder
        matrix = columns.T @ columns + np.eye(columns.shape[1])
        return np.asarray(-np.linalg.solve(matrix, columns.T @ self.whitened(self.errors(theta))))

    def remainder_of_run(self, coefficients: Array, run: int) -> Array:
        """Return the force (n,) in N that the remainder adds to a run."""
        return self.remainder[run] @ coefficients if self.remainder else np.zeros(len(self.recordings[run].force))


class RunError(NamedTuple):
    """Modelled minus measured force (n,) of a run: white, and in N without the run's offset, gain error and start."""

    white: Array
    newtons: Array


def error_of_run(problem: WeightedProblem, theta: Array, run: int, coefficients: Array | None = None) -> RunError:
    """Return the error of a model in a run.

    ``coefficients`` are those of the remainder, which belongs to the modelled force; without them it is left out.
    """
    error = problem.modelled(theta, run) - problem.recordings[run].force
    if coefficients is not None:
        error = error + problem.remainder_of_run(coefficients, run)
    whitening_of_run = problem.whitenings[run]
    return RunError(whitening_of_run(error), whitening_of_run.without_run_errors(error))


def sum_of_squares(errors: Array) -> float:
    """Return the sum of squared errors (n,): not finite where the model has diverged, as a damper of negative viscosity
    does behind a spring.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return float(errors @ errors)


@dataclass(frozen=True)
class Weighting:
    """Recordings with everything that is known about their errors.

    Attributes
    ----------
    recordings : sequence of Recording
    noise : sequence of RunNoise
        Noise of each run.
    scatter : RunScatter
    fixed : mapping
        Values of the model's parameters that are not searched.
    discrepancy : float
        Error in N rms of the best model so far beyond noise. While something is missing, samples without noise tell no more
        than others.
    error_correlation : float
        Number of samples over which that error is correlated. The run's gain and offset are restricted accordingly;
        otherwise they would compensate for what is missing.
    remainder : tuple of ndarray (n, columns)
        See `WeightedProblem`. Beside it, only the parameters of effects are searched.
    unexplained : float
        Share of the variance of the noise that is no noise, but what no effect explains.
    """

    recordings: Sequence[Recording]
    noise: Sequence[RunNoise]
    scatter: RunScatter
    fixed: Mapping[str, float]
    discrepancy: float = 0.0
    error_correlation: float = 1.0
    remainder: tuple[Array, ...] = ()
    unexplained: float = 0.0

    def problem(self, model: DamperModel, theta: Array, freed: Sequence[str] = ()) -> WeightedProblem:
        """Make the fitting problem of a model on these recordings.

        Parameters
        ----------
        model : DamperModel
        theta : ndarray (parameters,)
            Parameters near the optimum: the run's gain multiplies the force that they give.
        freed : sequence of str
            See `mrd_identification.problem.make_problem`.
        """
        plain, _ = make_problem(model, self.recordings, fixed=self.fixed, freed=freed)
        base = plain.base.copy()
        # Beside a remainder, the parameters of the damper are redundant: it would leave them undetermined.
        free = tuple(i for i in plain.free if not self.remainder or "." in model.names[i])
        # A parameter that is never searched, such as the frequency of the mains, keeps its value.
        kept = [i for i, p in enumerate(model.parameters) if not (p.free or p.name in freed or p.name in self.fixed)]
        kept += [i for i in plain.free if i not in free]
        base[kept] = theta[kept].real
        sigmas = tuple(noise.sigma for noise in self.noise)
        whitenings = self._whitenings(consecutive_forces(model, theta, self.recordings))
        return WeightedProblem(
            plain.model,
            plain.recordings,
            free,
            base,
            whitenings=whitenings,
            sigmas=sigmas,
            remainder=self.remainder,
            unexplained=self.unexplained,
        )

    def _whitenings(self, forces: Sequence[Array]) -> tuple[Whitening, ...]:
        """Return the whitening of each run from its modelled force (n,)."""
        root = np.sqrt(self.error_correlation)
        scatter = RunScatter(self.scatter.gain / root, self.scatter.offset / root)
        return tuple(
            whitening(
                np.sqrt(noise.sigma**2 + self.discrepancy**2), _bounded(force, recording), scatter, recording.other_starts
            )
            for noise, force, recording in zip(self.noise, forces, self.recordings, strict=True)
        )

    def updated(self, model: DamperModel, theta: Array, coefficients: Array | None = None) -> "Weighting":
        """Return the weighting with the starts of the runs and the discrepancy of another best model and its remainder."""
        added: list[Array | float] = [0.0] * len(self.recordings)
        if coefficients is not None and self.remainder:
            added = [of_run @ coefficients for of_run in self.remainder]
        plain = replace(self, recordings=[replace(r, other_starts=None) for r in self.recordings])
        first = plain._with_discrepancy(model, theta, added)
        recordings = estimate_starts(
            model,
            theta,
            first.recordings,
            [recording.force - of_run for recording, of_run in zip(first.recordings, added, strict=True)],
            first._whitenings(consecutive_forces(model, theta, first.recordings)),
        )
        return replace(first, recordings=recordings)._with_discrepancy(model, theta, added)

    def _with_discrepancy(self, model: DamperModel, theta: Array, added: Sequence[Array | float]) -> "Weighting":
        """Return the weighting with the discrepancy that a model leaves beside what is ``added`` to its force."""
        remaining = []
        forces = consecutive_forces(model, theta, self.recordings)
        for recording, noise, force, of_run in zip(self.recordings, self.noise, forces, added, strict=True):
            of_noise = whitening(noise.sigma, force, self.scatter, recording.other_starts)
            remaining.append(of_noise.without_run_errors(force - recording.force + of_run))
        error, sigma = np.concatenate(remaining), np.concatenate([noise.sigma for noise in self.noise])
        discrepancy = float(np.sqrt(max(float(np.mean(error**2 - sigma**2)), 0.0)))
        white = error / np.sqrt(sigma**2 + discrepancy**2)
        share = discrepancy**2 / (discrepancy**2 + float(np.mean(sigma**2)))
        correlation = 1.0 + share * (correlation_length(white) - 1.0)
        return replace(self, discrepancy=discrepancy, error_correlation=correlation)

    @property
    def noise_cost(self) -> float:
        """Sum of squared white errors that noise alone contributes."""
        return float(sum(np.sum(n.sigma**2 / (n.sigma**2 + self.discrepancy**2)) for n in self.noise))

    @property
    def samples(self) -> int:
        """Number of counted samples."""
        return sum(len(recording.force) for recording in self.recordings)

    @property
    def folds(self) -> list[tuple[int, slice]]:
        """Number of the run and samples among all counted ones, for each fold that is held out in turn."""
        folds, start = [], 0
        least = -(-LEAST_FOLDS // len(self.recordings))
        for run, recording in enumerate(self.recordings):
            length = len(recording.force)
            count = max(least, min(MOST_FOLDS_OF_RUN, int(recording.run.duration / FOLD_DURATION)), 1)
            edges = start + np.linspace(0, length, count + 1).astype(int)
            folds += [(run, slice(int(a), int(b))) for a, b in itertools.pairwise(edges)]
            start += length
        return folds
