"""The optimisation problem of a fit: a model, recordings, and the free parameters scaled to the unit box."""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from mrd_base import InputError
from mrd_identification.metrics import error_norms
from mrd_identification.parallel import in_threads
from mrd_identification.recording import Recording, consecutive_forces, current_levels
from mrd_sim.dual_type import LANES, as_duals
from mrd_sim.lanes import CANDIDATES
from mrd_sim.models import DamperModel, Parameter

Array = NDArray[np.float64]
Loss = Literal["linear", "soft_l1", "huber"]

CONSTANT = 1e-12
"""Relative. A current that varies by less is constant but for rounding."""

DIFFERENCE = 1e-5
"""Share of its range by which a parameter is moved for a difference."""

LARGEST_DERIVATIVE = 1e6
"""Times the largest measured force. By a larger one, a millionth of a range of a parameter would change all of the force: it
has diverged."""


@dataclass(frozen=True)
class Problem:
    """A fit of a model to recordings: the residuals and the objective over the free parameters, scaled to the unit box.

    Attributes
    ----------
    model : DamperModel
    recordings : sequence of Recording
    free : tuple of int
        Indices of the parameters that are searched.
    base : ndarray (parameters,)
        Values of all parameters; those of the free ones are where the search starts.
    offsets : bool
        Whether each run may have its own force offset. The offsets have mean zero over all samples: the deviation of a
        run's mean residual from the mean of all residuals then does not enter the objective.
    loss : {"linear", "soft_l1", "huber"}
        Loss function of the residuals in least squares.
    loss_scale : float
        Residual in N above which a robust loss grows more slowly than the square.
    left_out : ndarray of int or None
        Places of samples that do not count.
    """

    model: DamperModel
    recordings: Sequence[Recording]
    free: tuple[int, ...]
    base: Array
    offsets: bool = False
    loss: Loss = "linear"
    loss_scale: float = 1.0
    left_out: NDArray[np.intp] | None = None

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
        """Whether each free parameter has a logarithmic scale."""
        return np.array([p.log for p in self.parameters], dtype=bool)

    @cached_property
    def linear(self) -> NDArray[np.bool_]:
        """Whether the force depends linearly on each free parameter."""
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
        """Number of run offsets that the fit determines: one less than runs, because their mean is zero."""
        return len(self.recordings) - 1 if self.offsets else 0

    @cached_property
    def blocks(self) -> list[slice]:
        """Slice of each recording within the counted samples of all recordings."""
        edges = np.cumsum([0, *(len(r.force) for r in self.recordings)])
        return [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]

    def theta(self, unit: Array) -> Array:
        """Return the parameter vectors (..., parameters) of points (..., free) of the unit box."""
        unit = np.asarray(unit)
        theta = np.broadcast_to(self.base, (*unit.shape[:-1], len(self.base))).copy()
        low, high = self.lower, self.upper
        ratio = np.where(self.log, high / np.where(self.log, low, 1.0), 1.0)
        theta[..., self.free] = np.where(self.log, low * ratio**unit, low + (high - low) * unit)
        return theta

    def unit(self, theta: Array) -> Array:
        """Return the point of the unit box of a parameter vector; values outside the bounds are clipped to them."""
        value, low, high = theta[..., self.free], self.lower, self.upper
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithmic = np.log(value / low) / np.log(high / low)
        return np.asarray(np.clip(np.where(self.log, logarithmic, (value - low) / (high - low)), 0.0, 1.0))

    def scale(self, theta: Array) -> Array:
        """Return the derivative of each free parameter with respect to its unit coordinate."""
        with np.errstate(invalid="ignore", divide="ignore"):
            logarithmic = theta[list(self.free)] * np.log(self.upper / self.lower)
        return np.where(self.log, logarithmic, self.upper - self.lower)

    def forces(self, theta: Array) -> Array:
        """Return the modelled force (samples,) in N over all counted samples, see `consecutive_forces`."""
        return np.concatenate(consecutive_forces(self.model, theta, self.recordings))

    def modelled(self, theta: Array, index: int) -> Array:
        """Return the modelled force in N at the counted samples of one recording."""
        if any(effect.outlasts_run for effect in self.model.effects):
            return consecutive_forces(self.model, theta, self.recordings[: index + 1])[-1]
        return self.recordings[index].modelled(self.model, theta)

    def errors(self, theta: Array) -> Array:
        """Return the modelled minus the measured force in N over all counted samples."""
        return self.forces(theta) - self.force

    def residuals(self, theta: Array) -> Array:
        """Return the weighted errors in N, without the run offsets where these are free: what least squares minimises."""
        return self.counted(self.errors(theta))

    def cost(self, theta: Array) -> float:
        """Return half the sum of the loss in N², the objective as `scipy.optimize.least_squares` defines it."""
        residuals = self.residuals(theta)
        ratio = (residuals / self.loss_scale) ** 2
        if self.loss == "linear":
            return float(0.5 * residuals @ residuals)
        if self.loss == "soft_l1":
            loss = 2 * (np.sqrt(1 + ratio) - 1)
        else:
            loss = np.where(ratio <= 1, ratio, 2 * np.sqrt(ratio) - 1)
        return float(0.5 * self.loss_scale**2 * np.sum(loss))

    def robust_weights(self, residuals: Array) -> Array:
        """Return the square root of the weight that the loss gives each residual."""
        ratio = (residuals / self.loss_scale) ** 2
        if self.loss == "linear":
            return np.ones_like(residuals)
        if self.loss == "soft_l1":
            return np.asarray((1 + ratio) ** -0.25)
        return np.asarray(np.maximum(ratio, 1.0) ** -0.25)

    def relative_curvature(self, residuals: Array) -> Array:
        """Return the second derivative of the loss of each residual over its weight, the square of `robust_weights`."""
        ratio = (residuals / self.loss_scale) ** 2
        if self.loss == "linear":
            return np.ones_like(residuals)
        return np.asarray(1 / (1 + ratio) if self.loss == "soft_l1" else (ratio <= 1).astype(float))

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        """Return the exact derivatives (samples, indices) of the residuals with respect to unit coordinates.

        All free parameters, or those at the places ``indices`` among them. A derivative that has diverged, as may be at the
        sharpest yield, is a difference of forces.
        """
        theta = self.theta(unit)
        scale = self.scale(theta)

        def derivatives(places: Sequence[int]) -> Array:
            """Return derivatives of the force (samples, places) by as many parameters as one pass takes."""
            moved = as_duals(theta)
            for lane, place in enumerate(places):
                moved.derivatives[self.free[place], lane] = scale[place]
            return self.forces(moved)[:, 1 : 1 + len(places)]

        asked = list(range(len(self.free)) if indices is None else indices)
        slopes = {slope: value for slope, value in self._values_of_slopes.items() if slope in asked and value in asked}
        computed = [index for index in asked if index not in slopes]
        passes = [computed[first : first + LANES] for first in range(0, len(computed), LANES)]
        of_force = {
            place: column
            for places, columns in zip(passes, in_threads(derivatives, passes), strict=True)
            for place, column in zip(places, columns.T, strict=True)
        }
        largest = LARGEST_DERIVATIVE * np.abs(self.force).max(initial=0.0)
        for place, column in of_force.items():
            if not np.abs(column).max(initial=0.0) <= largest:  # holds for NaN as well
                of_force[place] = self._difference(unit, place)
        for slope, value in slopes.items():
            of_force[slope] = of_force[value] * self._constant_current * (scale[slope] / scale[value])
        columns = [self.counted(of_force[index]) for index in asked]
        return np.stack(columns, axis=1) if columns else np.empty((len(self.force), 0))

    def _difference(self, unit: Array, place: int) -> Array:
        """Return the difference of the force (samples,) over a small step of one unit coordinate into the box."""
        moved = unit.copy()
        moved[place] += DIFFERENCE if unit[place] < 0.5 else -DIFFERENCE
        change = (self.forces(self.theta(moved)) - self.forces(self.theta(unit))) / (moved[place] - unit[place])
        return np.asarray(np.nan_to_num(change, nan=0.0, posinf=0.0, neginf=0.0))

    @cached_property
    def _constant_current(self) -> Array:
        """Coil current in A at every counted sample, where each run has a constant one; otherwise empty."""
        currents = [recording.path.recorded.current for recording in self.recordings]
        if any(np.ptp(current) > CONSTANT * np.abs(current).max() for current in currents):
            return np.empty(0)
        return np.concatenate([np.full(len(r.force), r.path.recorded.current[0]) for r in self.recordings])

    @cached_property
    def _values_of_slopes(self) -> dict[int, int]:
        """Place of a coefficient's value for that of its slope over current, where one derivative gives the other.

        Where each run has a constant current, both change the coefficient throughout the run, in the ratio of the current.
        This needs an effective current that is the measured one, and runs that do not depend on each other.
        """
        changed = any(effect.stage == "magnetics" or effect.outlasts_run for effect in self.model.effects)
        if changed or not self._constant_current.size:
            return {}
        places = {self.model.names[index]: place for place, index in enumerate(self.free)}
        pairs = [
            [parameter.name for parameter in coefficient.parameters()[:2]]
            for coefficient in self.model.coefficients
            if coefficient.per_ampere and coefficient.law in ("affine", "quadratic")
        ]
        return {places[slope]: places[value] for value, slope in pairs if {value, slope} <= places.keys()}

    def offset_of_runs(self, theta: Array) -> Array:
        """Return the force offset in N of each run relative to the model where offsets are free, zeros otherwise."""
        if not self.offsets:
            return np.zeros(len(self.recordings))
        errors = self.errors(theta)
        return -np.array([errors[block].mean() - errors.mean() for block in self.blocks])

    def norms(self, thetas: Array) -> Array:
        """Return e2 and einf in N (candidates, 2) of a population; inf for a candidate whose force is not finite."""
        return np.array(in_threads(lambda theta: _finite_norms(self.residuals(theta)), thetas))

    def project(self, thetas: Array) -> tuple[Array, Array]:
        """Give every candidate the optimal linear parameters for its other parameters (variable projection).

        Golub & Pereyra (1973): for given nonlinear parameters the linear ones follow from linear least squares, here within
        their bounds, so that only the nonlinear ones need to be searched.

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
        size = CANDIDATES if self.model.runs_in_lanes else 1
        groups = [thetas[first : first + size] for first in range(0, len(thetas), size)]
        projected = [candidate for group in in_threads(self._project_all, groups) for candidate in group]
        return np.array([theta for theta, _ in projected]), np.array([norms for _, norms in projected])

    def _project_all(self, thetas: Array) -> list[tuple[Array, tuple[float, float]]]:
        by_recording = [recording.regressors(self.model, thetas) for recording in self.recordings]
        return [self._project(theta, regressors) for theta, *regressors in zip(thetas, *by_recording, strict=True)]

    def _project(self, theta: Array, regressors: Sequence[tuple[Array, Array]]) -> tuple[Array, tuple[float, float]]:
        free = np.array(self.free)[self.linear]
        is_free = np.isin(self.model.linear, free)
        fixed = self.model.linear[~is_free]
        lower, upper = self.lower[self.linear], self.upper[self.linear]
        # In units of the distance between their bounds all parameters are of similar size.
        span = upper - lower
        columns = np.empty((len(self.force), len(free)), order="F")
        remainder = np.empty(len(self.force))
        for (linear_part, rest), block in zip(regressors, self.blocks, strict=True):
            np.multiply(linear_part[:, is_free], span, out=columns[block])
            remainder[block] = rest
            if fixed.size:
                remainder[block] += linear_part[:, ~is_free] @ theta[fixed]
        remainder = self.counted(remainder - self.force)
        for column in columns.T:
            weighted = self.counted(column)
            if weighted is not column:
                column[:] = weighted
        gram, right = columns.T @ columns, -(columns.T @ remainder)
        if not (np.isfinite(gram).all() and np.isfinite(right).all()):
            return theta, (np.inf, np.inf)
        solution = _solve_normal_equations(gram, right, lower / span, upper / span)
        theta = theta.copy()
        theta[free] = np.clip(solution * span, lower, upper)
        return theta, _finite_norms(columns @ solution + remainder)

    @cached_property
    def _equal_weights(self) -> bool:
        """Whether every sample has the weight 1."""
        return all(recording.weight == 1.0 for recording in self.recordings)

    def counted(self, errors: Array) -> Array:
        """Return errors (samples,) in N weighted and without run offsets; the argument itself where nothing changes."""
        if self.offsets:
            mean = errors.mean()
            errors = errors.copy()
            for block in self.blocks:
                errors[block] -= errors[block].mean() - mean
        errors = errors if self._equal_weights else errors * self.root_weight
        if self.left_out is not None:
            errors = errors.copy()
            errors[self.left_out] = 0.0
        return errors


def _finite_norms(residuals: Array) -> tuple[float, float]:
    norms = error_norms(residuals)
    return norms if np.isfinite(norms[0]) else (np.inf, np.inf)


def _solve_normal_equations(gram: Array, right: Array, lower: Array, upper: Array) -> Array:
    """Solve the normal equations ``gram @ x = right`` of a linear least squares problem within bounds."""
    size = np.sqrt(np.diag(gram)) + 1e-300
    # The floor of the eigenvalues keeps the solution small in directions that the columns do not determine.
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    root = np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    scaled_right = vectors.T @ (right / size) / root
    solution = vectors @ (scaled_right / root) / size
    if ((solution >= lower) & (solution <= upper)).all():
        return np.asarray(solution)
    return np.asarray(lsq_linear((vectors * root).T * size, scaled_right, bounds=(lower, upper), method="bvls").x)


def make_problem(
    model: DamperModel,
    recordings: Sequence[Recording],
    *,
    fixed: Mapping[str, float] | None = None,
    freed: Collection[str] = (),
    offsets: bool = False,
) -> tuple[Problem, list[str]]:
    """Set up the fit of a model to recordings; parameters that these recordings cannot determine are fixed.

    Parameters
    ----------
    model : DamperModel
    recordings : sequence of Recording
    fixed : mapping, optional
        Values of parameters that are not searched.
    freed : collection of str
        Names of parameters that are searched although they keep their default otherwise.
    offsets : bool
        See `Problem`.

    Returns
    -------
    problem : Problem
    notes : list of str
        A sentence about each group of parameters that was fixed because the recordings cannot determine it.

    Raises
    ------
    InputError
        For a name that the model does not have, or a value outside its bounds.
    """
    fixed = fixed or {}
    base = model.vector(fixed)
    for name in freed:
        if name not in model.names:
            raise InputError(f"model {model.id}: unknown parameter {name} (known: {', '.join(model.names)})")
    undetermined, notes = _undetermined(model, recordings, fixed)
    if (place := model.scales.mid_stroke) and "mid_stroke" not in fixed:
        notes.append(
            f"Mid-stroke is taken at a position of {1e3 * place:.4g} mm (mid_stroke), the middle of what was recorded: a "
            "position of zero is far from it"
        )
    for index, value in undetermined.items():
        base[index] = value
    free = tuple(
        index
        for index, parameter in enumerate(model.parameters)
        if index not in undetermined and parameter.name not in fixed and (parameter.free or parameter.name in freed)
    )
    if not free:
        raise InputError(f"model {model.id}: every parameter is fixed, nothing to identify; fix fewer")
    return Problem(model, recordings, free, base, offsets), notes


def _undetermined(
    model: DamperModel, recordings: Sequence[Recording], fixed: Mapping[str, float]
) -> tuple[dict[int, float], list[str]]:
    """Return neutral values, by index, of the parameters that the currents of the recordings cannot determine, and notes."""
    levels, varies = current_levels([recording.run for recording in recordings])
    slopes = {i: max(0.0, p.lower) for i, p in enumerate(model.parameters) if p.name.endswith("_per_A")}
    curvatures = {
        i: p.upper if p.name.endswith("_saturation") else 0.0
        for i, p in enumerate(model.parameters)
        if p.name.endswith(("_per_A2", "_saturation"))
    }
    neutral: dict[int, float] = {}
    notes: list[str] = []
    if not varies:
        neutral[model.names.index("coil_lag")] = 0.0
        if "coil_lag" not in fixed:
            notes.append("coil_lag is fixed at 0: the current never changes within a run, so its lag cannot be seen")
    if levels == 1:
        neutral |= slopes | curvatures
        if any(model.names[index] not in fixed for index in slopes):
            notes.append(
                "The slopes over current are fixed at 0: all runs have the same current. Each coefficient holds for "
                f"{recordings[0].run.current.mean():.3g} A only"
            )
    elif levels == 2 and curvatures:
        neutral |= curvatures
        notes.append(
            "The current laws are fixed at straight lines: the runs have two currents, which cannot determine a curvature; "
            "record a third current"
        )
    return {index: value for index, value in neutral.items() if model.names[index] not in fixed}, notes
