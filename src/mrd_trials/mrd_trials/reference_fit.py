"""Reference fit of a damper model to a plant without effects, and the signal of effects over its noise floor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_identification.least_squares import fit_least_squares
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_sim.models import find_model

Array = NDArray[np.float64]

STARTS = 16
"""Random points of which the best are fitted; few are enough because linear parameters follow from the others."""

NEAR_TARGET = 0.25
"""Logarithmic distance from the target at which the signal to floor is near enough: well within a stratum."""


@dataclass(frozen=True)
class ReferenceFit:
    """A model fitted to the runs of a plant without effects.

    Attributes
    ----------
    problem : Problem
        The model and the recordings.
    theta : ndarray (parameters,)
    gains : bool
        Whether the gains of the runs are free beside their offsets.
    errors : ndarray (samples,)
        Modelled minus measured force in N.
    counted : tuple of slice
        Samples of each run that count.
    nuisance : ndarray (samples, k)
        Orthonormal basis of what the model's parameters, and an offset and perhaps a gain of each run, can imitate.
    remainder : ndarray (samples,)
        What the fit leaves of the errors in N.
    """

    problem: Problem
    theta: Array
    gains: bool
    errors: Array
    counted: tuple[slice, ...]
    nuisance: Array
    remainder: Array

    @classmethod
    def from_runs(cls, model_id: str, runs: Sequence[Run], rng: np.random.Generator, gains: bool = True) -> "ReferenceFit":
        """Fit a model to runs of a plant without effects; without ``gains``, only the offsets of the runs are free."""
        problem, theta = fit_model(model_id, in_threads(prepare_recording, runs), rng)
        return cls._around(problem, theta, gains)

    @classmethod
    def _around(cls, problem: Problem, theta: Array, gains: bool) -> "ReferenceFit":
        free = offsets_and_gains(consecutive_forces(problem.model, theta, problem.recordings))
        scatter = free if gains else free[:, ::2]
        nuisance = orthonormal_basis(np.hstack([problem.jacobian(problem.unit(theta)), scatter]))
        errors = problem.errors(theta)
        counted = tuple(recording.counted for recording in problem.recordings)
        return cls(problem, theta, gains, errors, counted, nuisance, errors - nuisance @ (nuisance.T @ errors))

    def unexplained_change(self, runs: Sequence[Run]) -> Array:
        """Return what effects change in the errors (samples,) and the model cannot take up, in N.

        ``runs`` are recorded with the effects, under the same commands and with the same noise as those of the fit.
        """
        prepared = in_threads(prepare_recording, runs)
        recordings = [replace(recording, counted=part) for recording, part in zip(prepared, self.counted, strict=True)]
        forces = consecutive_forces(self.problem.model, self.theta, recordings)
        change = np.concatenate([f - r.force for f, r in zip(forces, recordings, strict=True)]) - self.errors
        return np.asarray(change - self.nuisance @ (self.nuisance.T @ change))

    def signal_to_floor(self, runs: Sequence[Run]) -> float:
        """Return the mean square of `unexplained_change` over that of what the fit leaves without effects."""
        return float(np.mean(self.unexplained_change(runs) ** 2) / np.mean(self.remainder**2))

    def added_error(self, runs: Sequence[Run]) -> float:
        """Return by how much the effects raise the mean square of what the fit leaves, over that without effects.

        The parameters follow the effects to first order. Unlike `signal_to_floor`, it counts that an effect may make up for
        a part of the error that was there before; and the runs may take longer with the effects.
        """
        problem = replace(self.problem, recordings=in_threads(prepare_recording, runs))
        with_effects = self._around(problem, self.theta, self.gains)
        return float(np.mean(with_effects.remainder**2) / np.mean(self.remainder**2)) - 1.0


def fit_model(model_id: str, recordings: Sequence[Recording], rng: np.random.Generator) -> tuple[Problem, Array]:
    """Fit a damper model without effects by least squares, and return the problem and the parameters (parameters,).

    Of random points, the best are fitted briefly, and the best of these to the end (multi-start).
    """
    problem, _ = make_problem(find_model(model_id), recordings, fixed={"coil_lag": 0.0})  # the lag is an effect
    units = np.vstack([problem.unit(problem.model.defaults), rng.random((STARTS, len(problem.free)))])
    thetas, norms = problem.project(problem.theta(units))
    best = np.argsort(norms[:, 0], kind="stable")[: 1 + STARTS // 20]
    brief = [fit_least_squares(problem, theta, 15) for theta in thetas[best]]
    return problem, fit_least_squares(problem, min(brief, key=lambda fit: fit[1])[0], 100)[0]


def offsets_and_gains(forces: Sequence[Array]) -> Array:
    """Return what an offset and a gain of each run change in the forces (samples, 2 runs), run after run."""
    ends = np.cumsum([0, *map(len, forces)])
    columns = np.zeros((ends[-1], 2 * len(forces)))
    for place, force in enumerate(forces):
        block = slice(ends[place], ends[place + 1])
        columns[block, 2 * place], columns[block, 2 * place + 1] = 1.0, force
    return columns


def orthonormal_basis(columns: Array) -> Array:
    """Return an orthonormal basis (samples, k) of the span of columns; directions that hardly differ count once."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-12)
    gram = columns.T @ columns / np.outer(size, size)
    values, vectors = np.linalg.eigh(gram)
    kept = values > 1e-10 * len(gram)
    return np.asarray((columns / size) @ (vectors[:, kept] / np.sqrt(values[kept])))


def find_strength(
    target: float, signal_at: Callable[[float], float], strongest: float, evaluations: int = 8
) -> tuple[float, float]:
    """Return the strength, at most ``strongest``, at which the signal to floor comes near a target; and that signal.

    The signal grows about with the square of the strength, so a secant on logarithmic scales is used. Beyond a threshold,
    such as that of a void, it grows much faster: where the secant leaves the bracket of strengths that are known to be too
    weak and too strong, the bracket is halved.
    """
    strength, weak, strong = 1.0, 0.0, np.inf
    known: list[tuple[float, float]] = []
    for _ in range(evaluations):
        signal = max(signal_at(strength), 1e-9)
        known.append((strength, signal))
        if abs(np.log(signal / target)) < NEAR_TARGET or (strength >= strongest and signal < target):
            break
        weak, strong = (max(weak, strength), strong) if signal < target else (weak, min(strong, strength))
        slope = 2.0
        if len(known) > 1:
            (a, signal_a), (b, signal_b) = known[-2:]
            slope = float(np.clip(np.log(signal_b / signal_a) / np.log(b / a), 0.5, 6.0))
        strength = float(min(strength * np.exp(np.clip(np.log(target / signal) / slope, -3.0, 3.0)), strongest))
        if not weak < strength < strong:
            strength = float(np.sqrt(max(weak, 0.1 * strong) * strong))
    return min(known, key=lambda pair: abs(np.log(pair[1] / target)))
