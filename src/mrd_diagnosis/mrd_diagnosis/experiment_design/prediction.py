"""Prediction of a further run: an explanation, as the recorded runs leave it, and its force in that run."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.refit import Refit
from mrd_diagnosis.fitting.weighting import WeightedProblem
from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.recording import Recording
from mrd_sim.dual_type import columns_of, like
from mrd_sim.models import DamperModel
from mrd_sim.path import Path

Array = NDArray[np.float64]


class StateAfterRuns:
    """State of a model after recorded runs, such as heat, for any parameters.

    The state for given parameters is computed once. Threads may share the object: they can only store equal values.
    """

    def __init__(self, model: DamperModel, recordings: Sequence[Recording]) -> None:
        """Start without any computed state."""
        self.model = model
        self.recordings = recordings
        self._states: dict[bytes, Array] = {}

    def __call__(self, theta: Array) -> Array:
        """Return the state (states,) for parameters (parameters,)."""
        key = theta.tobytes()
        if key not in self._states:
            state = like(theta, self.model.initial_state(self.recordings[0].path))
            for run, recording in enumerate(self.recordings):
                state = self.model.next_state(state, recording.path) if run else state
                self.model.force(theta, recording.path, state)
            self._states[key] = state
        return self._states[key]


@dataclass(frozen=True)
class RivalModel:
    """A model with effects, and what the recorded runs say about its parameters.

    Attributes
    ----------
    problem : WeightedProblem
        All parameters are free about which further runs may tell something.
    unit : ndarray (free,)
        Optimum in unit coordinates.
    root : ndarray (free, free)
        Root of the normal matrix at the optimum.
    held_out_cost : float
        Sum of squared white residuals of the recorded runs, each held out.
    state_after_runs : StateAfterRuns
    """

    problem: WeightedProblem
    unit: Array
    root: Array
    held_out_cost: float
    state_after_runs: StateAfterRuns = field(repr=False)

    @classmethod
    def from_refit(cls, refit: Refit, fixed: Collection[str]) -> Self:
        """Make an explanation from a refit. No run may free the parameters whose names are ``fixed``."""
        problem, unit, matrix = refit.problem, refit.problem.unit(refit.theta), refit.information
        model = problem.model
        free = tuple(i for i, p in enumerate(model.parameters) if p.free and p.name not in fixed)
        undetermined = sorted(set(free) - set(problem.free))
        if undetermined:
            # Runs at one current say nothing about slopes over the current. These take their default values, and the other
            # parameters are fitted again.
            theta = refit.theta.copy()
            theta[undetermined] = model.defaults[undetermined]
            problem = replace(problem, free=free, base=theta)
            determined = np.flatnonzero(~np.isin(free, undetermined))
            unit, _ = levenberg_marquardt(problem, problem.unit(theta), determined, 10, 1e-6)
            jacobian = problem.jacobian(unit)
            matrix = jacobian.T @ jacobian
        values, vectors = np.linalg.eigh(matrix)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        return cls(problem, unit, root, refit.held_out_cost, StateAfterRuns(model, problem.recordings))

    @property
    def effects(self) -> frozenset[str]:
        """Ids of the effects in the model."""
        return frozenset(effect.id for effect in self.problem.model.effects)

    def is_nested_in(self, other: "RivalModel") -> bool:
        """Whether the other explanation is the same damper model with more effects."""
        return self.problem.model.id == other.problem.model.id and self.effects < other.effects

    def force(self, theta: Array, path: Path) -> Array:
        """Return the force (n,) in N in a run after the recorded ones."""
        model = self.problem.model
        if not any(effect.outlasts_run for effect in model.effects):
            return model.force(theta, path)
        return model.force(theta, path, model.next_state(self.state_after_runs(theta), path))


@dataclass(frozen=True, kw_only=True)
class UpdatedProblem(WeightedProblem):
    """The problem of fitting an explanation to one further run and, by its normal matrix, to the recorded runs."""

    explanation: RivalModel

    def forces(self, theta: Array) -> Array:
        """Return the modelled force (n,) in N of the further run, or with its derivatives (n, 1 + lanes)."""
        return columns_of(self.explanation.force(theta, self.recordings[0].path))

    def residuals(self, theta: Array) -> Array:
        """Return the white residuals of the further run, and those that stand for the recorded runs."""
        of_recorded_runs = self.explanation.root @ (self.unit(theta) - self.explanation.unit)
        return np.concatenate([super().residuals(theta), of_recorded_runs])

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        """Return the derivatives of the residuals to the unit coordinates, all or those of ``indices``."""
        chosen = slice(None) if indices is None else np.asarray(indices)
        return np.vstack([super().jacobian(unit, indices), self.explanation.root[:, chosen]])
