"""Fit several models to the same runs and rank them by their error on runs that were not fitted."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_base.notebook import html_table, text_table
from mrd_base.progress import ignore
from mrd_base.quantities import per_cent
from mrd_identification.effect_selection import selects
from mrd_identification.fit import Fit
from mrd_identification.identify import IdentificationTask, identify_all
from mrd_identification.method import Method
from mrd_identification.resampling import bootstrap_interval
from mrd_identification.residual_correlation import correlation_length, independent_segments
from mrd_runs import Run
from mrd_runs.run import checked_runs
from mrd_sim.models import MODELS, find_model

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = NDArray[np.float64]

RESAMPLES = 4000
"""Resamples of the bootstrap; the ends of a 95 % interval are then accurate to a few hundredths of its width."""

FEWEST_SEGMENTS = 10
"""Independent segments; a bootstrap over fewer of them gives intervals that are far too narrow."""

FEWEST_RUNS = 5
"""Held-out runs; fewer are no sample of the differences between runs, and segments within them are resampled instead."""


@dataclass(frozen=True)
class RankedModel:
    """One model of a comparison.

    Attributes
    ----------
    name : str
        Id of the model, with the current law and the effects where they were given.
    fit : Fit
    nrmse : float
        Over all held-out samples; inf where the model diverges on one.
    lower, upper : float
        95 % bootstrap interval of ``nrmse``; nan where there is too little held-out data.
    difference : float
        Difference of ``nrmse`` to that of the best model.
    difference_lower, difference_upper : float
        95 % interval of the difference, from the same resamples.
    """

    name: str
    fit: Fit
    nrmse: float
    lower: float
    upper: float
    difference: float
    difference_lower: float
    difference_upper: float

    @property
    def error(self) -> str:
        """`nrmse` as text."""
        return per_cent(self.nrmse) if np.isfinite(self.nrmse) else "diverges"

    @property
    def free(self) -> int:
        """Number of parameters that were searched."""
        return sum(not estimate.fixed for estimate in self.fit.estimates)

    @property
    def on_par(self) -> bool:
        """Whether the held-out runs do not show that the model is worse than the best one; False without an interval."""
        return self.difference == 0.0 or self.difference_lower <= 0.0


_COLUMNS = ("model", "held-out error (NRMSE)", "95 % interval", "parameters", "remark")


@dataclass(frozen=True, repr=False)
class Comparison:
    """Models in the order of rising held-out error.

    Attributes
    ----------
    entries : tuple of RankedModel
    held_out_by : str
        "runs" or "leave-one-run-out".
    resampled : str
        What the bootstrap draws: "runs" or "segments".
    units : int
        Number of these runs or segments.
    """

    entries: tuple[RankedModel, ...]
    held_out_by: str
    resampled: str
    units: int

    def __repr__(self) -> str:
        return f"<Comparison of {len(self.entries)} models: {self.best.name} is best, NRMSE {per_cent(self.best.nrmse)}>"

    def _repr_html_(self) -> str:
        return html_table([_COLUMNS, *self._rows()])

    def summary(self) -> str:
        """Return the models with their errors, 95 % intervals and numbers of parameters, as text."""
        return "\n".join(text_table([_COLUMNS, *self._rows()]))

    def plot(self) -> "go.Figure":
        """Return the figure of the models' errors with their intervals, which a notebook shows."""
        # Plotly is slow to import, and only few comparisons are drawn.
        from mrd_identification.compare_file import error_chart

        return error_chart(self)

    def _rows(self) -> list[tuple[str, ...]]:
        return [
            (
                entry.name,
                entry.error,
                f"{100 * entry.lower:.3g} to {100 * entry.upper:.3g} %" if np.isfinite(entry.lower) else "not known",
                str(entry.free),
                "on par with the best" if entry.on_par else "",
            )
            for entry in self.entries
        ]

    @property
    def best(self) -> RankedModel:
        """The model with the least held-out error."""
        return self.entries[0]

    @property
    def simplest(self) -> RankedModel:
        """The model with the fewest free parameters among those on par with the best."""
        return min((entry for entry in self.entries if entry.on_par), key=lambda entry: entry.free)


def compare(
    runs: Sequence[Run],
    models: Sequence[str] | None = None,
    *,
    held_out: Sequence[Run] = (),
    method: Method | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] = ignore,
    **options: Any,
) -> Comparison:
    """Identify several models from the same runs and rank them by held-out error.

    Parameters
    ----------
    runs : sequence of Run
        Runs that are fitted.
    models : sequence of str, optional
        Ids of models, each optionally with a current law and effects, such as ``"bouc_wen:quadratic+joint_play"`` or
        ``"bouc_wen+auto"`` (see `Method.effects`); all models of the catalogue otherwise.
    held_out : sequence of Run
        Runs that are not fitted; without them each run is predicted by a fit to the other runs.
    method, scheduler, **options
        See `mrd_identification.identify.identify`. Without a ``method`` no profiles are computed.
    progress : callable, optional
        Called with the finished share of the searches.

    Raises
    ------
    InputError
        As `identify`; also for a single run without held-out runs, for effects that are to be selected without them, for a
        model that is given twice, and where every model diverges on a held-out run.
    """
    runs, held_out = checked_runs(runs, least=0), checked_runs(held_out, "held_out", least=0)
    names = list(models or MODELS)
    common = replace(method or Method(profile=False), **options)
    if len(set(names)) < len(names):
        raise InputError(f"models {', '.join(names)}: expected each of them once")
    if not held_out and not common.least_squares:
        raise InputError("without least squares no run is left out in turn: give held-out runs")
    if len(runs) < 2 and not held_out:
        raise InputError("one run and no held-out run: give at least two runs, or held-out ones")
    rows = [parse_row(name, common) for name in names]
    check_selection(rows, held_out)
    tasks = [IdentificationTask(tuple(runs), model, tuple(held_out), of_row) for model, of_row in rows]
    total = sum(task.method.total_generations for task in tasks)
    fits = identify_all(tasks, scheduler=scheduler, progress=lambda generation, _: progress(generation / total))
    return rank(names, fits)


def check_selection(rows: Sequence[tuple[str, Method]], held_out: Sequence[Run]) -> None:
    """Raise `InputError` where effects are to be selected by the very runs by whose errors the models are ranked."""
    if not held_out and any(selects(method.effects) for _, method in rows):
        raise InputError(
            "auto selects effects by all fitted runs, so none of these can judge them by being left out: give held-out "
            "runs, with --held-out RUN..."
        )


def rank(names: Sequence[str], fits: Sequence[Fit]) -> Comparison:
    """Order fits to the same runs by held-out NRMSE, with bootstrap intervals from common resamples."""
    results = [fit.held_out for fit in fits]
    force = np.concatenate([result.measured_counted for result in results[0]])
    errors = [np.concatenate([r.modelled_counted - r.measured_counted for r in fit_results]) for fit_results in results]
    edges = np.cumsum([0, *(len(result.measured_counted) for result in results[0])])
    blocks = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    with np.errstate(over="ignore", invalid="ignore"):  # the force of a model may diverge on runs that it was not fitted to
        finite = np.array([np.isfinite(error @ error) for error in errors])
    if not finite.any():
        raise InputError(
            f"the force of {' and of '.join(names)} diverges on held-out runs, expected a model that predicts them"
        )
    errors = [error for error, is_finite in zip(errors, finite, strict=True) if is_finite]
    resample_runs = len(blocks) >= FEWEST_RUNS
    units = blocks if resample_runs else independent_segments(blocks, _correlation_within_runs(errors, blocks))
    nrmse, drawn = np.full(len(fits), np.inf), np.full((len(fits), RESAMPLES), np.nan)
    nrmse[finite], drawn[finite] = _bootstrap(force, errors, units)
    if not resample_runs and len(units) < FEWEST_SEGMENTS:
        drawn[:] = np.nan
    best = int(np.argmin(nrmse))
    entries = []
    for index in np.argsort(nrmse, kind="stable"):
        error, difference = float(nrmse[index]), float(nrmse[index] - nrmse[best])
        lower, upper = bootstrap_interval(error, drawn[index], len(units))
        between = bootstrap_interval(difference, drawn[index] - drawn[best], len(units))
        entries.append(RankedModel(names[index], fits[index], error, max(lower, 0.0), upper, difference, *between))
    return Comparison(tuple(entries), fits[0].held_out_by, "runs" if resample_runs else "segments", len(units))


def _correlation_within_runs(errors: Sequence[Array], blocks: Sequence[slice]) -> int:
    """Return the longest correlation length of errors within a run, without their mean over the run."""
    return max(correlation_length(error[block] - error[block].mean()) for error in errors for block in blocks)


def _bootstrap(force: Array, errors: Sequence[Array], units: Sequence[slice]) -> tuple[Array, Array]:
    """Return the NRMSE (models,) over all samples, and the NRMSE (models, resamples) of each bootstrap resample of units.

    All models have the same resamples, so that the intervals of their differences are narrow.
    """
    random = np.random.default_rng(0)
    draws = random.multinomial(len(units), np.full(len(units), 1 / len(units)), RESAMPLES).astype(float)
    count = np.array([len(force[unit]) for unit in units])
    total = np.array([np.sum(force[unit]) for unit in units])
    square = np.array([force[unit] @ force[unit] for unit in units])
    squared_errors = np.array([[error[unit] @ error[unit] for unit in units] for error in errors])

    def nrmse(times_drawn: Array) -> Array:
        samples = times_drawn @ count
        variance = times_drawn @ square / samples - (times_drawn @ total / samples) ** 2
        return np.asarray(np.sqrt(squared_errors @ times_drawn.T / samples / np.maximum(variance, 1e-300)))

    return nrmse(np.ones(len(units))), nrmse(draws)


def parse_row(name: str, method: Method) -> tuple[str, Method]:
    """Return the id of the model and the method that ``ID[:LAW][+EFFECT...]`` names.

    Raises
    ------
    InputError
        For what is not in the catalogues.
    """
    model, *effects = name.split("+")
    model, _, law = model.partition(":")
    method = replace(method, laws=law or method.laws, effects=(*method.effects, *effects))
    find_model(model, law, method.given_effects)
    return model, method
