"""The base fit: the model without any effect, fitted to the recordings, to which effects are then added."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_diagnosis.fitting.null_distribution import draw_null_errors
from mrd_diagnosis.fitting.refit import Refit, refit, scaled_inverse
from mrd_diagnosis.fitting.weighting import Weighting, usual_run_scatter
from mrd_diagnosis.noise.noise_model import estimate_noise
from mrd_identification.least_squares import fit_least_squares
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording
from mrd_identification.run_start import fit_with_starts
from mrd_sim.effects import find_effects
from mrd_sim.models import DamperModel

Array = NDArray[np.float64]

RANDOM_STARTS = 64
"""Random points from whose best the fit starts when nothing is known about the parameters."""


@dataclass(frozen=True)
class LinearisedRefit:
    """A refitted model to which effects are added, linearised for their scores.

    Attributes
    ----------
    refit : Refit
    residual : ndarray (samples,)
        White residual.
    jacobian : ndarray (samples, free)
        Derivatives of the residual.
    inverse : ndarray (free, free)
        Inverse of the normal matrix.
    """

    refit: Refit
    residual: Array
    jacobian: Array
    inverse: Array

    @classmethod
    def around(cls, weighting: Weighting, refitted: Refit) -> "LinearisedRefit":
        """Linearise a model around a refit. The run's gain multiplies the force of this refit."""
        problem = weighting.problem(refitted.problem.model, refitted.theta)
        jacobian = problem.jacobian(problem.unit(refitted.theta))
        inverse = scaled_inverse(jacobian.T @ jacobian, 1e-10)
        return cls(refitted, problem.residuals(refitted.theta), jacobian, inverse)

    def unabsorbed(self, change: Array) -> Array:
        """Return what the model's own parameters cannot imitate of a change of the white residual (samples,)."""
        return np.asarray(change - self.jacobian @ (self.inverse @ (self.jacobian.T @ change)))

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects in the model."""
        return self.refit.effects


@dataclass(frozen=True)
class FittedBase:
    """The model without effects, fitted to recordings.

    Attributes
    ----------
    weighting : Weighting
    base : Refit
    null_errors : list of ndarray
        Errors of this model by noise alone, see `mrd_diagnosis.fitting.null_distribution.draw_null_errors`.
    notes : list of str
        What limits the fit.
    """

    weighting: Weighting
    base: Refit
    null_errors: list[Array]
    notes: list[str]


def fit_base(
    model: DamperModel, parameters: Array | None, recordings: Sequence[Recording], rng: np.random.Generator
) -> FittedBase:
    """Fit the model without effects.

    Parameters
    ----------
    model : DamperModel
    parameters : ndarray (parameters,) or None
        Parameters of the simulator as it is, from which the fit starts.
    recordings : sequence of Recording
    rng : numpy Generator
    """
    # The lag behind the current is a candidate, unless the simulator has one already.
    fixed = {} if parameters is not None and parameters[model.names.index("coil_lag")] > 0.0 else {"coil_lag": 0.0}
    plain, notes = make_problem(model, recordings, fixed=fixed)
    theta = global_fit(plain, parameters, rng)
    plain, theta = fit_with_starts(plain, theta)
    recordings = plain.recordings
    noise = estimate_noise(recordings, model, theta, rng)
    weighting = Weighting(recordings, noise, usual_run_scatter(model.scales), fixed).updated(model, theta)
    problem = weighting.problem(model, theta)
    null_errors = draw_null_errors(problem, theta, [of_run.force for of_run in weighting.noise], weighting.scatter, rng)
    base = refit(problem, theta, weighting.folds, null_errors)
    return FittedBase(weighting, base, null_errors, notes)


def global_fit(
    problem: Problem,
    start: Array | None,
    rng: np.random.Generator,
    random_starts: int = RANDOM_STARTS,
    evaluations: int = 100,
) -> Array:
    """Fit parameters (parameters,) by least squares from ``start``, if there is one, and from the best of random points.

    Parameters in which the force is linear follow from the others (variable projection), so few points are enough.
    """
    units = np.vstack([problem.unit(problem.model.defaults), rng.random((random_starts, len(problem.free)))])
    thetas, norms = problem.project(problem.theta(units))
    best = np.argsort(norms[:, 0], kind="stable")[: 1 + random_starts // 20]
    starts = [*thetas[best], *([] if start is None else [problem.theta(problem.unit(start))])]
    brief = [fit_least_squares(problem, theta, 15) for theta in starts]
    return fit_least_squares(problem, min(brief, key=lambda fit: fit[1])[0], evaluations)[0]


def without_effect(model: DamperModel, theta: Array, effect: str) -> tuple[DamperModel, Array]:
    """Return the model without one of its effects, and its other parameters."""
    reduced = model.with_effects([other for other in model.effects if other.id != effect])
    values = dict(zip(model.names, theta, strict=True))
    return reduced, np.array([values[name] for name in reduced.names])


def with_effect(model: DamperModel, theta: Array, effect: str) -> tuple[DamperModel, Array]:
    """Return the model with one more effect, and its parameters with this effect neutral."""
    present = [other.id for other in model.effects if other.id != effect]
    extended = replace(model, effects=()).with_effects(find_effects([*present, effect], model.scales))
    values = dict(zip(model.names, theta, strict=True))
    return extended, np.array([values.get(p.name, p.default) for p in extended.parameters])
