"""What is fitted: a model, the recordings, the free parameters on their scales."""

import itertools
import os
import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from mrd_base import InputError
from mrd_identification.metrics import error_norms
from mrd_runs import Run
from mrd_runs.signals.motion import Motion
from mrd_runs.signals.smoothed_run import SmoothedRun, smooth_run
from mrd_sim.dual import STEP
from mrd_sim.models import DamperModel, Parameter, SeriesSolutions
from mrd_sim.path import Path, path_of

Array = NDArray[np.float64]
Loss = Literal["linear", "soft_l1", "huber"]
Weights = Literal["samples", "runs", "force"]
T = TypeVar("T")
R = TypeVar("R")

FORGETTING_STROKE = 1e-3
"""m; the hysteretic state at the start of a recording is not known. Once the rod moved this far, several usual yield
travels, little of it is left."""

_THREAD_NAME = "analysis"


def in_threads(function: Callable[[T], R], items: Iterable[T]) -> list[R]:
    """Apply ``function`` to every item on all cores, and return the results in the order of the items.

    The compiled models release the interpreter, so threads use all cores and share the data without a copy. A call from one
    of these threads does its work on the core that it has.
    """
    if threading.current_thread().name.startswith(_THREAD_NAME):
        return [function(item) for item in items]
    with ThreadPoolExecutor(os.cpu_count(), thread_name_prefix=_THREAD_NAME) as workers:
        return list(workers.map(function, items))


@dataclass(frozen=True)
class Recording:
    """A run as identification sees it.

    Attributes
    ----------
    smoothed : SmoothedRun
        The run, its smoothed motion and its current without sensor noise.
    path : Path
        The smoothed signals with the vertices at reversals, along which models are integrated.
    counted : slice
        Samples whose residual counts.
    weight : float
        Factor of its squared residuals.
    """

    smoothed: SmoothedRun
    path: Path
    counted: slice
    weight: float = 1.0

    @property
    def run(self) -> Run:
        """The run itself."""
        return self.smoothed.run

    @property
    def motion(self) -> Motion:
        """Smoothed motion of the run."""
        return self.smoothed.motion

    @property
    def force(self) -> Array:
        """Measured force in N at the counted samples."""
        return self.run.force[self.counted]

    def modelled(self, model: DamperModel, theta: Array) -> Array:
        """Model's force in N at the counted samples, the damper at rest and unloaded at first."""
        return model.force(theta, self.path)[self.counted]


def prepare_recording(run: Run, weight: float = 1.0) -> Recording:
    """Smooth the motion of a run and lay out the path of integration."""
    smoothed = smooth_run(run)
    position = smoothed.motion.position
    reached = np.maximum.accumulate(position) - np.minimum.accumulate(position)
    start = int(np.argmax(reached >= min(FORGETTING_STROKE, 0.25 * reached[-1])))
    return Recording(smoothed, path_of(smoothed), slice(start, len(run)), weight)


def consecutive_modelled_forces(
    model: DamperModel, theta: Array, recordings: Sequence[Recording], solutions: SeriesSolutions | None = None
) -> list[Array]:
    """Modelled force in N of runs recorded one after the other: a state that outlasts a run, such as heat, is carried over.

    ``solutions`` is as in `mrd_sim.models.DamperModel.force`.
    """
    forces: list[Array] = []
    state: Array | None = None
    for recording in recordings:
        initial = model.initial_state(recording.path) if state is None else model.next_state(state, recording.path)
        state = initial.astype(theta.dtype)
        forces.append(model.force(theta, recording.path, state, solutions))
    return forces


def consecutive_forces(
    model: DamperModel, theta: Array, recordings: Sequence[Recording], solutions: SeriesSolutions | None = None
) -> list[Array]:
    """The forces of `consecutive_modelled_forces` at the counted samples."""
    forces = consecutive_modelled_forces(model, theta, recordings, solutions)
    return [force[recording.counted] for force, recording in zip(forces, recordings, strict=True)]


def run_weights(runs: Sequence[Run], weights: Weights | Sequence[float]) -> list[float]:
    """Factor of each run's squared residuals, 1 on average over the samples.

    Parameters
    ----------
    runs : sequence of Run
    weights : {"samples", "runs", "force"} or sequence of float
        Every sample alike; every run alike, however long; every run relative to the spread of its own force; or one positive
        number for each run.

    Raises
    ------
    InputError
        For numbers that are not positive or not as many as there are runs.
    """
    samples = np.array([len(run) for run in runs])
    if weights == "samples":
        found = np.ones(len(runs))
    elif weights == "runs":
        found = 1.0 / samples
    elif weights == "force":
        found = np.array([1.0 / np.var(run.force) for run in runs])
    else:
        try:
            found = np.asarray(weights, dtype=float)
        except ValueError:
            raise InputError(f"weights {weights!r}: expected samples, runs, force, or a number for each run") from None
        if found.shape != samples.shape or not (np.isfinite(found) & (found > 0)).all():
            raise InputError(f"weights {weights!r}: expected {len(runs)} positive numbers, one for each fitted run")
    return list(map(float, found * samples.sum() / (found @ samples)))


@dataclass(frozen=True)
class Problem:
    """Free parameters of a model over recordings, scaled to the unit box.

    Attributes
    ----------
    model : DamperModel
    recordings : sequence of Recording
    free : tuple of int
        Indices of the parameters that are searched.
    base : ndarray (parameters,)
        Values of all others.
    offsets : bool
        Whether each run may have a force offset of its own, of mean zero over all samples: the deviation of a run's mean
        residual from the common one then does not count.
    loss : {"linear", "soft_l1", "huber"}
        What residuals count in least squares.
    loss_scale : float
        Residual in N from which on a robust loss counts it less than its square.
    """

    model: DamperModel
    recordings: Sequence[Recording]
    free: tuple[int, ...]
    base: Array
    offsets: bool = False
    loss: Loss = "linear"
    loss_scale: float = 1.0

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters."""
        return tuple(self.model.parameters[index] for index in self.free)

    @cached_property
    def lower(self) -> Array:
        """Lower bounds of the free parameters."""
        return np.array([p.lower for p in self.parameters])

    @cached_property
    def upper(self) -> Array:
        """Upper bounds of the free parameters."""
        return np.array([p.upper for p in self.parameters])

    @cached_property
    def log(self) -> NDArray[np.bool_]:
        """Which free parameters have a logarithmic scale."""
        return np.array([p.log for p in self.parameters], dtype=bool)

    @cached_property
    def linear(self) -> NDArray[np.bool_]:
        """Which free parameters the force is linear in."""
        return np.isin(self.free, self.model.linear)

    @cached_property
    def force(self) -> Array:
        """Measured force in N over all counted samples."""
        return np.concatenate([r.force for r in self.recordings])

    @cached_property
    def root_weight(self) -> Array:
        """Square root of the weight of every counted sample."""
        return np.concatenate([np.full(len(r.force), np.sqrt(r.weight)) for r in self.recordings])

    @property
    def run_offsets(self) -> int:
        """Number of offsets of single runs that the fit is free to choose."""
        return len(self.recordings) - 1 if self.offsets else 0

    @cached_property
    def blocks(self) -> list[slice]:
        """Where each recording's samples are among the counted ones."""
        edges = np.cumsum([0, *(len(r.force) for r in self.recordings)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]

    def theta(self, unit: Array) -> Array:
        """Parameter vectors (..., parameters) of points (..., free) of the unit box."""
        unit = np.asarray(unit)
        theta = np.broadcast_to(self.base, (*unit.shape[:-1], len(self.base))).copy()
        low, high = self.lower, self.upper
        ratio = np.where(self.log, high / np.where(self.log, low, 1.0), 1.0)
        theta[..., self.free] = np.where(self.log, low * ratio**unit, low + (high - low) * unit)
        return theta

    def unit(self, theta: Array) -> Array:
        """Point of the unit box of a parameter vector; outside values come to the border."""
        value, low, high = theta[..., self.free], self.lower, self.upper
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithmic = np.log(value / low) / np.log(high / low)
        return np.asarray(np.clip(np.where(self.log, logarithmic, (value - low) / (high - low)), 0.0, 1.0))

    def scale(self, theta: Array) -> Array:
        """Derivative of each free parameter to its unit coordinate."""
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithmic = theta[list(self.free)] * np.log(self.upper / self.lower)
        return np.where(self.log, logarithmic, self.upper - self.lower)

    def forces(self, theta: Array, solutions: SeriesSolutions | None = None) -> Array:
        """Modelled force in N over all counted samples; ``solutions`` is as in `mrd_sim.models.DamperModel.force`."""
        return np.concatenate(consecutive_forces(self.model, theta, self.recordings, solutions))

    def modelled(self, theta: Array, index: int) -> Array:
        """Modelled force in N at the counted samples of one recording."""
        if any(effect.carries for effect in self.model.effects):
            return consecutive_forces(self.model, theta, self.recordings[: index + 1])[-1]
        return self.recordings[index].modelled(self.model, theta)

    def errors(self, theta: Array) -> Array:
        """Modelled minus measured force in N over all counted samples."""
        return self.forces(theta) - self.force

    def residuals(self, theta: Array) -> Array:
        """What least squares counts: errors, without offsets of single runs where these are free, times root weights."""
        return self.counted(self.errors(theta))

    def cost(self, theta: Array) -> float:
        """Half the sum of the loss in N², as `scipy.optimize.least_squares` counts it."""
        residuals = self.residuals(theta)
        ratio = (residuals / self.loss_scale) ** 2
        if self.loss == "linear":
            return float(0.5 * residuals @ residuals)
        if self.loss == "soft_l1":
            counted = 2 * (np.sqrt(1 + ratio) - 1)
        else:
            counted = np.where(ratio <= 1, ratio, 2 * np.sqrt(ratio) - 1)
        return float(0.5 * self.loss_scale**2 * np.sum(counted))

    def robust_weights(self, residuals: Array) -> Array:
        """Root of the weight that the loss gives each residual."""
        ratio = (residuals / self.loss_scale) ** 2
        if self.loss == "linear":
            return np.ones_like(residuals)
        if self.loss == "soft_l1":
            return np.asarray((1 + ratio) ** -0.25)
        return np.asarray(np.maximum(ratio, 1.0) ** -0.25)

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        """Exact derivatives (samples, indices) of the residuals to the unit coordinates, all or those of ``indices``."""
        theta = self.theta(unit)
        scale = self.scale(theta)
        solutions: SeriesSolutions = {}
        if self.model.has_series_elements:
            self.forces(theta, solutions)

        def column(index: int) -> Array:
            moved = theta.astype(complex)
            moved[self.free[index]] += 1j * STEP * scale[index]
            return self.counted(self.forces(moved, solutions).imag / STEP)

        columns = in_threads(column, range(len(self.free)) if indices is None else indices)
        return np.stack(columns, axis=1) if columns else np.empty((len(self.force), 0))

    def offset_of_runs(self, theta: Array) -> Array:
        """Offset in N of each run from the model, where offsets are free; else zeros."""
        if not self.offsets:
            return np.zeros(len(self.recordings))
        errors = self.errors(theta)
        return -np.array([errors[block].mean() - errors.mean() for block in self.blocks])

    def norms(self, thetas: Array) -> Array:
        """The two norms e2 and einf in N, (candidates, 2), of a whole population; inf for a force that is not finite."""
        return np.array(in_threads(lambda theta: _norms(self.residuals(theta)), thetas))

    def project(self, thetas: Array) -> tuple[Array, Array]:
        """Give every candidate the linear parameters that suit the others best (variable projection).

        Golub & Pereyra (1973): for given other parameters the linear ones follow from linear least squares, here within
        their bounds, so that only the others need to be searched.

        Parameters
        ----------
        thetas : ndarray (candidates, parameters)

        Returns
        -------
        thetas : ndarray (candidates, parameters)
        norms : ndarray (candidates, 2)
            e2 and einf in N.
        """
        if not self.linear.any():
            return thetas, self.norms(thetas)
        found = in_threads(self._project, thetas)
        return np.array([theta for theta, _ in found]), np.array([norms for _, norms in found])

    def _project(self, theta: Array) -> tuple[Array, tuple[float, float]]:
        free = np.array(self.free)[self.linear]
        is_free = np.isin(self.model.linear, free)
        fixed = self.model.linear[~is_free]
        lower, upper = self.lower[self.linear], self.upper[self.linear]
        # In units of the bounds' span all parameters are of like size.
        span = upper - lower
        columns = np.empty((len(self.force), len(free)), order="F")
        rest = np.empty(len(self.force))
        for recording, block in zip(self.recordings, self.blocks, strict=True):
            of_run, rest_of_run = self.model.regressors(theta, recording.path)
            np.multiply(of_run[recording.counted][:, is_free], span, out=columns[block])
            rest[block] = rest_of_run[recording.counted]
            if fixed.size:
                rest[block] += of_run[recording.counted][:, ~is_free] @ theta[fixed]
        rest = self.counted(rest - self.force)
        if self.offsets or not self._alike:
            for column in columns.T:
                column[:] = self.counted(column)
        gram, right = columns.T @ columns, -(columns.T @ rest)
        if not (np.isfinite(gram).all() and np.isfinite(right).all()):
            return theta, (np.inf, np.inf)
        solution = _bounded(gram, right, lower / span, upper / span)
        theta = theta.copy()
        theta[free] = np.clip(solution * span, lower, upper)
        return theta, _norms(columns @ solution + rest)

    @cached_property
    def _alike(self) -> bool:
        """Whether every sample weighs one."""
        return all(recording.weight == 1.0 for recording in self.recordings)

    def counted(self, errors: Array) -> Array:
        """What of errors (samples,) in N least squares counts."""
        if self.offsets:
            mean = errors.mean()
            errors = errors.copy()
            for block in self.blocks:
                errors[block] -= errors[block].mean() - mean
        return errors if self._alike else errors * self.root_weight


def _norms(residuals: Array) -> tuple[float, float]:
    found = error_norms(residuals)
    return found if np.isfinite(found[0]) else (np.inf, np.inf)


def _bounded(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Least squares solution of the normal equations ``gram @ x = right`` within bounds."""
    size = np.sqrt(np.diag(gram)) + 1e-300
    # A column that the others already span gets as little as it can.
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    shortened = vectors.T @ (right / size) / root
    solution = vectors @ (shortened / root) / size
    if ((solution >= lower) & (solution <= upper)).all():
        return np.asarray(solution)
    return np.asarray(lsq_linear((vectors * root).T * size, shortened, bounds=(lower, upper), method="bvls").x)


def make_problem(
    model: DamperModel,
    recordings: Sequence[Recording],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: Collection[str] = (),
    offsets: bool = False,
) -> tuple[Problem, list[str]]:
    """Set up what these recordings can tell about a model.

    Parameters
    ----------
    model : DamperModel
    recordings : sequence of Recording
    fixed : mapping, optional
        Values of parameters that are not to be searched.
    freed : collection of str
        Names of parameters to be searched that usually keep their default.
    offsets : bool
        See `Problem`.

    Returns
    -------
    problem : Problem
        Parameters of which the recordings say nothing are neutral in it.
    notes : list of str
        A sentence for each group of them.

    Raises
    ------
    InputError
        For a name that the model does not have, or a value out of its bounds.
    """
    fixed = fixed or {}
    base = model.vector(fixed)
    for name in freed:
        if name not in model.names:
            raise InputError(f"model {model.id}: unknown parameter {name} (known: {', '.join(model.names)})")
    slopes = [i for i, name in enumerate(model.names) if name.endswith("_per_A")]
    bends = [i for i, name in enumerate(model.names) if name.endswith(("_per_A2", "_saturation"))]
    levels, varies = current_levels([r.run for r in recordings])
    notes: list[str] = []
    silent: set[int] = set()
    if not varies:
        silent.add(model.names.index("coil_lag"))
        base[model.names.index("coil_lag")] = fixed.get("coil_lag", 0.0)
        if "coil_lag" not in fixed:
            notes.append("coil_lag is fixed: the current never changes within a run, so its lag cannot be seen")
    if levels == 1:
        silent |= {*slopes, *bends}
        if any(model.names[index] not in fixed for index in slopes):
            notes.append(
                "slopes over current are fixed at 0: all runs have the same current, so each coefficient is the one at "
                f"{recordings[0].run.current.mean():.3g} A"
            )
    elif levels == 2 and bends:
        silent |= set(bends)
        notes.append("current laws are fixed at straight lines: the runs have two currents, and two points bend no law")
    for index in silent:
        parameter = model.parameters[index]
        if parameter.name in fixed:
            continue
        if index in slopes:
            base[index] = max(0.0, parameter.lower)
        elif index in bends:
            base[index] = parameter.upper if parameter.name.endswith("_saturation") else 0.0
    free = tuple(
        index
        for index, parameter in enumerate(model.parameters)
        if index not in silent and parameter.name not in fixed and (parameter.free or parameter.name in freed)
    )
    if not free:
        raise InputError(f"model {model.id}: every parameter is fixed, nothing to identify; fix fewer")
    return Problem(model, recordings, free, base, offsets), notes


def current_levels(runs: Sequence[Run]) -> tuple[int, bool]:
    """How many coil currents the runs have (3 for more), and whether it changes within any of them."""
    if any(_current_varies(run) for run in runs):
        return 3, True
    means = np.sort([float(run.current.mean()) for run in runs])
    blur = max(float(np.std(run.current)) / np.sqrt(len(run)) for run in runs)
    return min(3, 1 + int(np.sum(np.diff(means) > max(1e-3, 10 * blur)))), False


def _current_varies(run: Run) -> bool:
    """Whether the current of a run changes by more than its sensor's noise."""
    # No sensor of a bench is noisier than this; an unfiltered ACS714-05B has 19 mA.
    if np.std(run.current) > 0.025:
        return True
    window = max(5, int(0.05 * run.rate))
    noise = float(np.quantile(np.abs(np.diff(run.current)), 0.25)) / 0.45  # of white noise: 0.32 sqrt(2) sigma
    smooth = np.convolve(run.current, np.full(window, 1 / window), "valid")
    return bool(np.ptp(smooth) > max(1e-3, 12 * noise / np.sqrt(window)))
