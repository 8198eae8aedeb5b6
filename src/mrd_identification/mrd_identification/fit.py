"""The result of an identification: parameters with intervals, and the model's error on every run."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrd_base.notebook import html_table
from mrd_base.quantities import per_cent, quantity
from mrd_identification.effect_selection import Selection
from mrd_identification.method import Method
from mrd_identification.metrics import Metrics, metrics
from mrd_identification.nsga2 import Front
from mrd_identification.recording import Recording, consecutive_modelled_forces
from mrd_runs import Run
from mrd_runs.signals.motion import Motion
from mrd_sim.models import DamperModel, Parameter

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """One identified parameter.

    Attributes
    ----------
    parameter : Parameter
    value : float
    lower, upper : float
        95 % interval from the covariance; nan where there is none (fixed, on a bound, or not identifiable).
    profile_lower, profile_upper : float
        95 % interval from the profile of the objective. An end on the parameter's bound is open. nan where there is none.
    by_seed : tuple of float
        Value that the search from each seed ended at.
    fixed : bool
        Kept at ``value``, not searched.
    on_bound : bool
    """

    parameter: Parameter
    value: float
    lower: float
    upper: float
    profile_lower: float
    profile_upper: float
    by_seed: tuple[float, ...]
    fixed: bool
    on_bound: bool


@dataclass(frozen=True)
class RunResult:
    """Measured and modelled force of one run.

    Attributes
    ----------
    run : Run
    motion : Motion
        Smoothed motion of the run.
    modelled : ndarray (n,)
        Force in N at every sample.
    counted : slice
        Samples that the metrics count.
    metrics : Metrics
    """

    run: Run
    motion: Motion
    modelled: Array
    counted: slice
    metrics: Metrics

    @property
    def measured_counted(self) -> Array:
        """Measured force in N at the counted samples."""
        return self.run.force[self.counted]

    @property
    def modelled_counted(self) -> Array:
        """Modelled force in N at the counted samples."""
        return self.modelled[self.counted]


def evaluate_model(model: DamperModel, theta: Array, recordings: Sequence[Recording]) -> tuple[RunResult, ...]:
    """Compare a model with runs that were recorded one after the other."""
    modelled = consecutive_modelled_forces(model, theta, recordings)
    return tuple(
        RunResult(
            recording.run, recording.motion, force, recording.counted, metrics(recording.force, force[recording.counted])
        )
        for recording, force in zip(recordings, modelled, strict=True)
    )


def pooled_metrics(results: Sequence[RunResult]) -> Metrics:
    """Return the metrics over all counted samples of several runs."""
    measured = np.concatenate([result.measured_counted for result in results])
    return metrics(measured, np.concatenate([result.modelled_counted for result in results]))


@dataclass(frozen=True, repr=False)
class Fit:
    """An identified model.

    Attributes
    ----------
    model : DamperModel
    method : Method
    theta : ndarray (parameters,)
    estimates : tuple of Estimate
    front : Front
        Pareto front, before least squares, of the search that led to the result.
    seed_errors : tuple of float
        NRMSE on the fitted runs of the result of each seed.
    fitted, held_out : tuple of RunResult
        Results on the fitted and on the held-out runs. Without held-out runs, ``held_out`` has each fitted run as predicted
        by a fit to the other runs; with a single run it is empty.
    held_out_by : str
        "runs", "leave-one-run-out" or "none".
    pooled_fitted, pooled_held_out : Metrics or None
        Metrics over all samples of these runs.
    run_offsets : tuple of float
        Force offset in N of each fitted run where offsets are free, zeros otherwise.
    correlation : ndarray (free, free)
        Correlation of the estimates that are not fixed, in their order.
    condition : float
        Condition number of the scaled sensitivities.
    elapsed : float
        Computing time in s.
    warnings : tuple of str
        Sentences about what limits the trust in this fit.
    selection : Selection or None
        How the effects were selected, where that was asked for.
    """

    model: DamperModel
    method: Method
    theta: Array
    estimates: tuple[Estimate, ...]
    front: Front
    seed_errors: tuple[float, ...]
    fitted: tuple[RunResult, ...]
    held_out: tuple[RunResult, ...]
    held_out_by: str
    pooled_fitted: Metrics
    pooled_held_out: Metrics | None
    run_offsets: tuple[float, ...]
    correlation: Array
    condition: float
    elapsed: float
    warnings: tuple[str, ...]
    selection: Selection | None = None

    @property
    def current(self) -> float:
        """Mean coil current in A of the fitted runs."""
        return float(np.mean([result.run.current.mean() for result in self.fitted]))

    @property
    def observables(self) -> dict[str, tuple[float, str]]:
        """Value and unit, by name, of the quantities that the recordings determine at `current`."""
        if self.model.observables is None:
            return {}
        return self.model.observables(self.model.at_current(self.theta, self.current))

    @property
    def values(self) -> dict[str, float]:
        """Parameters by name, in SI units."""
        return dict(zip(self.model.names, map(float, self.theta), strict=True))

    @property
    def pooled(self) -> Metrics:
        """Metrics over all held-out runs, or over the fitted runs where none was held out."""
        return self.pooled_held_out or self.pooled_fitted

    @property
    def sentence(self) -> str:
        """The error of the fit in one sentence."""
        fitted = "on the run that it was fitted to" if len(self.fitted) == 1 else "on the runs that it was fitted to"
        where = "on runs that it was not fitted to" if self.pooled_held_out else fitted
        return (
            f"The model explains {per_cent(0.01 * self.pooled.vaf)} of the variance of the force {where}; its rms error is "
            f"{self.pooled.rmse:.3g} N, {per_cent(self.pooled.nrmse)} of the standard deviation of the force."
        )

    def __repr__(self) -> str:
        return f"<Fit of {self.model!r} to {len(self.fitted)} runs: NRMSE {per_cent(self.pooled.nrmse)}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(self.sentence)}</p>{html_table(self._rows())}"

    def validate(self, runs: "Sequence[Run]", **options: Any) -> Any:
        """Predict runs to which the model was not fitted; see `mrd_diagnosis.validate`, which takes the ``options``."""
        # The diagnosis uses this package, and is asked only here.
        validation = import_module("mrd_diagnosis")
        return validation.validate(self, runs, **options)

    def summary(self) -> str:
        """Return the error, the parameters with their 95 % intervals, and what limits the trust in them, as text."""
        rows = self._rows()
        first, second = (max(len(row[column]) for row in rows) for column in range(2))
        table = (f"{row[0]:{first}}  {row[1]:>{second}}  {row[2]}" for row in rows)
        return "\n".join([self.sentence, *table, *(f"note: {warning}" for warning in self.warnings)])

    def _rows(self) -> list[tuple[str, str, str]]:
        """Return the parameters with their values and intervals, below a head."""
        rows = [("parameter", "value", "95 % interval")]
        for estimate in self.estimates:
            value, lower, upper = (
                quantity(number, estimate.parameter.unit) for number in (estimate.value, estimate.lower, estimate.upper)
            )
            interval = f"{lower} to {upper}" if np.isfinite(estimate.lower) else "none"
            if estimate.fixed or estimate.on_bound:
                interval = "fixed" if estimate.fixed else "on bound"
            rows.append((estimate.parameter.name, value, interval))
        return rows

    def plot(self) -> "go.Figure":
        """Return the figure of measured and modelled force over velocity and position, which a notebook shows."""
        # Plotly is slow to import, and only few fits are drawn.
        from mrd_identification.figures import loops

        return loops(self.held_out or self.fitted)
