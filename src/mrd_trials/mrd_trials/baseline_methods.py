"""Baseline methods: simpler ways to rank the effects, on the same recordings as the diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mrd_identification.least_squares import levenberg_marquardt
from mrd_identification.parallel import in_threads
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import consecutive_forces, prepare_recording
from mrd_runs import Run
from mrd_sim.effects import EFFECTS, Effect
from mrd_sim.models import find_model
from mrd_trials.reference_fit import fit_model, orthonormal_basis

Array = NDArray[np.float64]

EVALUATIONS, TOLERANCE = 40, 1e-6
"""Most evaluations of a model in a refit, and the relative decrease of the cost at which it is finished."""

SMALLEST_SIZE, LARGEST_SIZE = 0.03, 3.0
"""Size, in multiples of the typical one, from which a refit begins: without the effect its shape has no influence, and far
beyond the typical size first order says little."""


@dataclass(frozen=True)
class ScatterFreeProblem(Problem):
    """A problem that does not count what a gain and an offset of each run can take up.

    Attributes
    ----------
    scatter : tuple of ndarray (n, 2)
        Orthonormal basis of gain and offset of each run.
    """

    scatter: tuple[Array, ...] = ()

    def counted(self, errors: Array) -> Array:
        """Return what of errors (samples,) in N least squares counts."""
        parts = [(errors[block], basis) for block, basis in zip(self.blocks, self.scatter, strict=True)]
        return np.concatenate([part - basis @ (basis.T @ part) for part, basis in parts])


@dataclass(frozen=True)
class BaselineScore:
    """Scores of one effect as an extension of the model.

    Attributes
    ----------
    correlation : float
        Largest correlation of the residual with the change that the effect makes at its typical size, without any refit.
    promise : float
        Squared residual in N² that the effect would remove to first order, if the model could adapt (score test).
    squared_error : float
        Squared residual in N² after the refit.
    parameters : int
        Number of parameters that the effect adds to the fit.
    """

    correlation: float
    promise: float
    squared_error: float
    parameters: int


def run_baseline_methods(runs: Sequence[Run], model_id: str, seed: int = 0) -> dict[str, tuple[str, ...]]:
    """Fit the model without and with every effect of the catalogue, and rank the effects by five methods.


    ``correlation``, ``score`` and ``in_sample`` are the first three fields of `BaselineScore`. ``bic`` is the Bayesian
    information criterion of the refits, as if all samples were independent. ``random`` is a random order.

    Parameters
    ----------
    runs : sequence of Run
        In the order in which they were recorded.
    model_id : str
    seed : int

    Returns
    -------
    dict
        Effects from the best on, by method; "" stands where the method prefers no effect to those after it.
    """
    rng = np.random.default_rng(seed)
    problem, theta = fit_model(model_id, in_threads(prepare_recording, runs), rng)
    forces = consecutive_forces(problem.model, theta, problem.recordings)
    scatter = tuple(orthonormal_basis(np.stack([force, np.ones_like(force)], axis=1)) for force in forces)
    alone, theta = _refit(_scatter_free(problem, scatter), theta)
    residual = alone.residuals(theta)
    nuisance = orthonormal_basis(alone.jacobian(alone.unit(theta)))
    # The plants of a trial have no thermometer.
    names = [name for name, effect in EFFECTS.items() if "changing temperature" not in effect.needs]
    fits = dict(zip(names, in_threads(lambda name: _fit_effect(alone, theta, nuisance, EFFECTS[name]), names), strict=True))
    total, samples = float(residual @ residual), len(residual)
    bic = {
        name: samples * np.log(fit.squared_error / total) + fit.parameters * np.log(samples) for name, fit in fits.items()
    }
    return {
        "correlation": _ascending({name: -fit.correlation for name, fit in fits.items()}),
        "score": _ascending({name: -fit.promise for name, fit in fits.items()}),
        "in_sample": _ascending({name: fit.squared_error for name, fit in fits.items()} | {"": total}),
        "bic": _ascending(bic | {"": 0.0}),
        "random": tuple(map(str, rng.permutation(sorted(names)))),
    }


def _fit_effect(alone: ScatterFreeProblem, theta: Array, nuisance: Array, effect: Effect) -> BaselineScore:
    """Score an effect from its typical size, then refit the model with it from the size that removes most."""
    model = find_model(alone.model.id, effects=[effect.id])
    posed, _ = make_problem(model, alone.recordings, fixed={"coil_lag": 0.0})
    problem = _scatter_free(posed, alone.scatter)
    values = dict(zip(alone.model.names, theta, strict=True))
    neutral = np.array([values.get(parameter.name, parameter.default) for parameter in model.parameters])
    residual = problem.residuals(neutral)
    correlation, promise, begin = 0.0, 0.0, neutral
    size = effect.parameters[0]
    sizes = effect.starts(problem.force) if effect.starts else [effect.typical.get(size.name, size.default)]
    for value in filter(None, sizes):
        typical = {f"{effect.id}.{name}": number for name, number in {**effect.typical, size.name: value}.items()}
        start = np.array([typical.get(name, number) for name, number in zip(model.names, neutral, strict=True)])
        change = problem.residuals(start) - residual
        if not np.isfinite(change).all() or not change.any():
            continue
        correlation = max(
            correlation, abs(float(change @ residual)) / float(np.sqrt((change @ change) * (residual @ residual)))
        )
        remainder = change - nuisance @ (nuisance.T @ change)
        projection, energy = float(remainder @ residual), float(remainder @ remainder)
        least, most = sorted((size.lower / value, size.upper / value))
        factor = float(np.clip(-projection / energy, max(least, -LARGEST_SIZE), min(most, LARGEST_SIZE)))
        decrease = -factor * (2.0 * projection + factor * energy)
        if decrease > promise:
            promise, begin = decrease, start
            if not effect.starts:  # the change of an effect with a threshold is not in proportion to its size
                place = model.names.index(f"{effect.id}.{size.name}")
                begin[place] *= factor if abs(factor) > SMALLEST_SIZE else SMALLEST_SIZE
    fitted, best = _refit(replace(problem, base=begin), begin)
    squared_error = float(np.sum(fitted.residuals(best) ** 2))
    return BaselineScore(correlation, promise, squared_error, len(problem.free) - len(alone.free))


def _refit(problem: ScatterFreeProblem, theta: Array) -> tuple[ScatterFreeProblem, Array]:
    unit = problem.unit(theta)
    best, _ = levenberg_marquardt(problem, unit, np.arange(len(unit)), EVALUATIONS, TOLERANCE, renewal=3)
    return problem, problem.theta(best)


def _scatter_free(problem: Problem, scatter: tuple[Array, ...]) -> ScatterFreeProblem:
    return ScatterFreeProblem(problem.model, problem.recordings, problem.free, problem.base, scatter=scatter)


def _ascending(criterion: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(criterion, key=lambda name: criterion[name]))
