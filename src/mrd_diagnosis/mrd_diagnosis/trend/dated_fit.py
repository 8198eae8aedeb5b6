"""Fit of all runs together, in which one parameter has a value at each date and all others are common to the dates."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from mrd_base import InputError
from mrd_diagnosis.wording.quantities import format_share
from mrd_identification.identify import search_and_fit
from mrd_identification.least_squares import BOUND_TOLERANCE, levenberg_marquardt
from mrd_identification.method import Method
from mrd_identification.metrics import nrmse
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, prepare_recording
from mrd_identification.residual_correlation import correlation_length, independent_segments
from mrd_identification.uncertainty import LEAST_DEGREES_OF_FREEDOM, normal_inverse
from mrd_runs import Run
from mrd_sim.dual_type import along, columns_of
from mrd_sim.models import DamperModel, Parameter, find_model

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

LARGEST_JACOBIAN = 2e7
"""Entries of the Jacobian, samples times parameters (160 MB). With more, only every n-th sample is fitted: neighbouring
samples hold much the same information."""
NOTABLE_GAIN = 0.1
"""Share of the squared error left by the followed parameter that another parameter must remove to be mentioned."""


@dataclass(frozen=True)
class DatedProblem(Problem):
    """A problem in which one parameter has a value at each date.

    The values at the dates follow the parameters of the model in ``theta``. Every run starts with a damper at rest, unloaded
    and cool.

    Attributes
    ----------
    followed : int
        Index of the parameter that has a value at each date.
    date_index : tuple of int
        Index of the date of each recording.
    """

    followed: int = 0
    date_index: tuple[int, ...] = ()

    @property
    def dates(self) -> int:
        """Number of dates."""
        return len(self.base) - len(self.model.parameters)

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Free parameters; the followed one stands at the end, once for each date."""
        parameters = (*self.model.parameters, *[self.model.parameters[self.followed]] * self.dates)
        return tuple(parameters[index] for index in self.free)

    def modelled(self, theta: Array, index: int) -> Array:
        """Return the modelled force in N at the counted samples of one recording."""
        theta_of_run = theta[: len(self.model.parameters)].copy()
        theta_of_run[self.followed] = theta[len(theta_of_run) + self.date_index[index]]
        recording = self.recordings[index]
        force = self.model.force(theta_of_run, recording.path)
        return recording.as_recorded(columns_of(force))[recording.counted]

    def forces(self, theta: Array) -> Array:
        """Return the modelled force in N over all counted samples."""
        return np.concatenate([self.modelled(theta, index) for index in range(len(self.recordings))])

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        """Return exact derivatives (samples, indices) of the residuals by the unit coordinates, all or some of them."""
        common = super().jacobian(unit, range(len(self.free) - self.dates))
        theta = self.theta(unit)
        # A run depends on the value at its own date only, so one evaluation gives the derivatives by all dates.
        direction = np.zeros(len(theta))
        direction[-self.dates :] = self.scale(theta)[-self.dates :]
        derivative = self.forces(along(theta, direction))[:, 1]
        date = np.repeat(self.date_index, [len(recording.force) for recording in self.recordings])
        dated = [self.counted(np.where(date == d, derivative, 0.0)) for d in range(self.dates)]
        jacobian = np.column_stack([common, *dated])
        return jacobian if indices is None else jacobian[:, indices]


@dataclass(frozen=True)
class DatedFit:
    """Result of a fit with a value of one parameter at each date.

    Attributes
    ----------
    model : DamperModel
        Model with its effects.
    parameter : Parameter
        The parameter that was followed.
    values : ndarray (dates,)
        Value of the parameter at each date. A value on a bound is extrapolated beyond it by the slope of the objective, so
        that a trend does not bend there.
    covariance : ndarray (dates, dates)
        Covariance of the errors of the values within the runs; zero where it is unknown.
    common_parameters : mapping
        All other parameters by name.
    run_offsets : bool
        Whether each run had a free force offset.
    nrmse : float
    notes : tuple of str
        What limits the result.
    """

    model: DamperModel
    parameter: Parameter
    values: Array
    covariance: Array
    common_parameters: Mapping[str, float]
    run_offsets: bool
    nrmse: float
    notes: tuple[str, ...]


def fit_dates(
    runs: Sequence[Run],
    date_index: tuple[int, ...],
    model: DamperModel,
    follow: str,
    *,
    parameters: Mapping[str, float] | None,
    seed: int,
    progress: Progress,
) -> DatedFit:
    """Fit all runs with one value of a parameter at each date, and all other parameters in common.

    Parameters
    ----------
    runs : sequence of Run
    date_index : tuple of int
        Index of the date of each run.
    model : DamperModel
        Model with its effects.
    follow : str
        Name of the parameter.
    parameters, seed, progress
        As in `mrd_diagnosis.trend.trend.trend`.

    Raises
    ------
    InputError
        If the force does not depend on the parameter.
    """
    followed, dates = model.names.index(follow), max(date_index) + 1
    recordings = _thin([prepare_recording(run) for run in runs], len(model.names) + dates)
    # The effect coil_lag takes the place of the lag in the model.
    fixed = {"coil_lag": 0.0} if "coil_lag" in (effect.id for effect in model.effects) else {}
    # An offset of each run would take up a followed offset.
    run_offsets = not follow.endswith("offset")
    problem, notes = make_problem(model, recordings, fixed=fixed, freed=[follow], offsets=run_offsets)
    if followed not in problem.free:
        raise InputError(f"{follow}: the force of these runs does not depend on it ({'; '.join(notes)}); follow another")
    progress("fitting one value for all dates", 0.05)
    if parameters is None:
        parameters = _search(problem, runs, seed, lambda fraction: progress("searching", 0.05 + 0.4 * fraction))
    theta = _fit_common_parameters(problem, parameters)
    progress("fitting a value for each date", 0.5)
    notes += _note_on_better_parameter(problem, theta, followed, date_index)
    dated = make_dated_problem(problem, followed, date_index)
    start = np.concatenate([theta, np.full(dates, theta[followed])])
    unit, _ = levenberg_marquardt(dated, dated.unit(start), np.arange(len(dated.free)), 60, 1e-8)
    progress("estimating intervals", 0.9)
    values, covariance, notes_on_intervals = _estimate_values(dated, unit)
    theta = dated.theta(unit)
    return DatedFit(
        model=model,
        parameter=model.parameters[followed],
        values=values,
        covariance=covariance,
        common_parameters={name: float(theta[i]) for i, name in enumerate(model.names) if i != followed},
        run_offsets=run_offsets,
        nrmse=nrmse(dated.residuals(theta), dated.force),
        notes=(*notes, *notes_on_intervals),
    )


def make_dated_problem(problem: Problem, followed: int, date_index: tuple[int, ...]) -> DatedProblem:
    """Turn a problem into one in which a parameter has a value at each date."""
    count, dates = len(problem.base), max(date_index) + 1
    free = (*(index for index in problem.free if index != followed), *range(count, count + dates))
    base = np.concatenate([problem.base, np.full(dates, problem.base[followed])])
    return DatedProblem(
        problem.model, problem.recordings, free, base, problem.offsets, followed=followed, date_index=date_index
    )


def _thin(recordings: Sequence[Recording], columns: int) -> list[Recording]:
    """Count only every n-th sample, so that the Jacobian does not become too large."""
    samples = sum(len(recording.force) for recording in recordings)
    step = int(np.ceil(samples * columns / LARGEST_JACOBIAN))
    return [replace(r, counted=slice(r.counted.start, r.counted.stop, step)) for r in recordings]


def _search(problem: Problem, runs: Sequence[Run], seed: int, progress: Callable[[float], None]) -> dict[str, float]:
    """Identify the model without effects, and return its parameters by name."""
    model = find_model(problem.model.id, problem.model.laws, scales=problem.model.scales)
    method = Method(laws=model.laws, offsets=problem.offsets)
    result = search_and_fit(runs, model.id, method, seed, lambda generation, _: progress(generation / method.generations))
    return dict(zip(model.names, map(float, result.theta), strict=True))


def _fit_common_parameters(problem: Problem, parameters: Mapping[str, float]) -> Array:
    """Fit all parameters in common to all dates, starting from ``parameters``; return them (parameters,).

    A second fit starts with the typical size of the effects that ``parameters`` do not hold, and the better one is returned:
    at size zero, some effects have no gradient.
    """
    model, free = problem.model, list(problem.free)
    without_effects = problem.base.copy()
    without_effects[free] = model.vector(parameters)[free]
    with_effects = without_effects.copy()
    for effect in model.effects:
        for name, value in effect.typical.items():
            index = model.names.index(f"{effect.id}.{name}")
            if f"{effect.id}.{name}" not in parameters and index in free:
                with_effects[index] = value
    starts = [without_effects]
    if (with_effects != without_effects).any():
        starts.append(with_effects)
    fits = [levenberg_marquardt(problem, problem.unit(start), np.arange(len(free)), 40, 1e-6) for start in starts]
    best, _ = min(fits, key=lambda fit: fit[1])
    return problem.theta(best)


def _note_on_better_parameter(problem: Problem, theta: Array, followed: int, date_index: tuple[int, ...]) -> list[str]:
    """Return a note if the change of another parameter would explain the dates better, to first order."""
    unit = problem.unit(theta)
    residuals, jacobian = problem.residuals(theta), problem.jacobian(unit)
    date = np.repeat(date_index, [len(recording.force) for recording in problem.recordings])
    dates, count = max(date_index) + 1, len(unit)
    normal_matrices = np.stack([jacobian[date == d].T @ jacobian[date == d] for d in range(dates)])
    gradients = np.stack([jacobian[date == d].T @ residuals[date == d] for d in range(dates)])

    def gain(index: int) -> float:
        """Return the share of the squared error that a value of one parameter at each date removes."""
        others = np.delete(np.arange(count), index)
        normal_matrix = np.diag(np.concatenate([np.zeros(count - 1), normal_matrices[:, index, index]]))
        normal_matrix[: count - 1, : count - 1] = normal_matrices.sum(axis=0)[np.ix_(others, others)]
        normal_matrix[count - 1 :, : count - 1] = normal_matrices[:, index, others]
        normal_matrix[: count - 1, count - 1 :] = normal_matrices[:, index, others].T
        gradient = np.concatenate([gradients.sum(axis=0)[others], gradients[:, index]])
        size = np.sqrt(np.maximum(np.diag(normal_matrix), 1e-12 * np.diag(normal_matrix).max()))
        inverse = normal_inverse(normal_matrix / np.outer(size, size))
        return float(gradient / size @ inverse @ (gradient / size) / (residuals @ residuals))

    gains = [gain(index) for index in range(count)]
    best, gain_of_followed = int(np.argmax(gains)), gains[problem.free.index(followed)]
    if gains[best] < gain_of_followed + NOTABLE_GAIN * (1.0 - gain_of_followed):
        return []
    better = problem.parameters[best].name
    return [
        f"{better} explains the change from date to date better than {problem.model.names[followed]}: a value of {better} "
        f"at each date would remove {format_share(gains[best])} of the squared error, and a value of "
        f"{problem.model.names[followed]} removes {format_share(gain_of_followed)}"
    ]


def _estimate_values(problem: DatedProblem, unit: Array) -> tuple[Array, Array, list[str]]:
    """Return the values (dates,) of the followed parameter, the covariance of their errors, and notes.

    The covariance is the sandwich of `mrd_identification.uncertainty` over independent segments within the runs; scatter
    from date to date is left to the trend line. If a value is on a bound, all values are moved to the minimum of the
    parabola that approximates the objective, beyond the bound if it lies there.
    """
    theta, dates = problem.theta(unit), problem.dates
    residuals, jacobian = problem.residuals(theta), problem.jacobian(unit)
    norm = np.linalg.norm(jacobian, axis=0)
    is_dated = np.arange(len(unit)) >= len(unit) - dates
    if len(unaffected := np.flatnonzero(norm[is_dated] == 0)):
        name, date = problem.model.names[problem.followed], unaffected[0] + 1
        raise InputError(f"{name}: the force at date {date} does not depend on it; follow another, or leave that date out")
    on_bound = (unit < BOUND_TOLERANCE) | (unit > 1 - BOUND_TOLERANCE)
    estimated = (norm > 0) & (is_dated | ~on_bound)
    scaled = jacobian[:, estimated] / norm[estimated]
    inverse = normal_inverse(scaled.T @ scaled)
    step = -(inverse @ (scaled.T @ residuals)) / norm[estimated]
    scale = problem.scale(theta)
    at_dates = slice(-dates, None)
    values = theta[at_dates] + np.where(on_bound.any(), step[at_dates], 0.0) * scale[at_dates]
    segments = independent_segments(problem.blocks, correlation_length(residuals))
    degrees_of_freedom = len(segments) - int(estimated.sum()) - problem.run_offsets
    if degrees_of_freedom < LEAST_DEGREES_OF_FREEDOM:
        few = f"single dates have no intervals: the runs have {len(segments)} independent segments only; record longer runs"
        return values, np.zeros((dates, dates)), [few]
    scores = np.stack([scaled[segment].T @ residuals[segment] for segment in segments])
    root = (inverse @ scores.T)[at_dates] * (scale[at_dates] / norm[at_dates])[:, None]
    # With few segments, intervals are wider by the ratio of Student's t to the normal quantile.
    widening = float(stdtrit(degrees_of_freedom, 0.975)) / 1.96
    notes = []
    if count := int(on_bound[is_dated].sum()):
        notes.append(f"{count} of {dates} dates have the parameter on its bound; their values are extrapolated beyond it")
    return values, widening**2 * len(segments) / degrees_of_freedom * (root @ root.T), notes
