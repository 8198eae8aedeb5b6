"""Fit a ladder of models to the same runs and rank them by what they make of runs that they have not seen."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrd_base import InputError
from mrd_identification.identify import Fit, IdentificationTask, Method, RunResult, identify_all
from mrd_identification.residual_correlation import correlation_length, independent_segments
from mrd_runs import Run
from mrd_sim.models import MODELS, find_model

Array = NDArray[np.float64]

RESAMPLES = 4000
FEWEST_STRETCHES = 10
"""Independent stretches below which intervals would be made up."""
FEWEST_RUNS = 5
"""Judged runs from which on runs are resampled; with fewer, stretches within them."""


@dataclass(frozen=True)
class Entry:
    """One model of a comparison.

    Attributes
    ----------
    name : str
        Id of the model, with the current law where one was asked for.
    fit : Fit
    nrmse : float
        Held-out, over all judged samples.
    lower, upper : float
        95 % bootstrap interval of it; nan where too little was judged.
    behind : float
        How far its NRMSE is above the best one's.
    behind_lower, behind_upper : float
        95 % interval of that, from the same resamples.
    """

    name: str
    fit: Fit
    nrmse: float
    lower: float
    upper: float
    behind: float
    behind_lower: float
    behind_upper: float

    @property
    def free(self) -> int:
        """Number of parameters that were searched."""
        return sum(not estimate.fixed for estimate in self.fit.estimates)

    @property
    def on_par(self) -> bool:
        """Whether the judged runs do not tell it from the best; unknown, and no, where there are no intervals."""
        return self.behind == 0.0 or self.behind_lower <= 0.0


@dataclass(frozen=True)
class Comparison:
    """Models by rising held-out error.

    Attributes
    ----------
    entries : tuple of Entry
    judged_by : str
        "runs" or "leave-one-run-out".
    resampled : str
        What the bootstrap drew: "runs" or "stretches".
    units : int
        How many of them there are.
    """

    entries: tuple[Entry, ...]
    judged_by: str
    resampled: str
    units: int

    @property
    def simplest(self) -> Entry:
        """The model with the fewest parameters among those on par with the best."""
        return min((entry for entry in self.entries if entry.on_par), key=lambda entry: entry.free)


def compare(
    runs: Sequence[Run],
    models: Sequence[str] | None = None,
    *,
    held_out: Sequence[Run] = (),
    method: Method | None = None,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda _share: None,
    **options: Any,
) -> Comparison:
    """Identify several models from the same runs and rank them by held-out error.

    Parameters
    ----------
    runs : sequence of Run
        What is fitted.
    models : sequence of str, optional
        Ids of models, each with a current law if wanted (``"bouc_wen:quadratic"``); all models of the catalogue otherwise.
    held_out : sequence of Run
        What judges; without it each run is judged by a fit to the others.
    method, scheduler, **options
        See `mrd_identification.identify.identify`. Without a method of its own, profiles are left out.
    progress : callable, optional
        Called with the share of the searches that is done.

    Raises
    ------
    InputError
        As `identify`; also for a single run and nothing to judge by, and for a model named twice.
    """
    names = list(models or MODELS)
    if len(set(names)) < len(names):
        raise InputError(f"models {', '.join(names)}: expected each one once")
    if not held_out and not replace(method or Method(), **options).least_squares:
        raise InputError("without least squares no run is left out in turn: give held-out runs")
    if len(runs) < 2 and not held_out:
        raise InputError("one run and nothing to judge by: give more runs or held-out ones")
    how = replace(method or Method(profile=False), **options)
    cases = [_case(name, tuple(runs), tuple(held_out), how) for name in names]
    searches = len(cases) * how.generations * how.seeds
    fits = identify_all(cases, scheduler=scheduler, progress=lambda generation, _: progress(generation / searches))
    return rank(names, fits)


def rank(names: Sequence[str], fits: Sequence[Fit]) -> Comparison:
    """Order fits to the same runs by held-out NRMSE, with bootstrap intervals from common resamples."""
    judged = [fit.held_out for fit in fits]
    force = np.concatenate([_force(result) for result in judged[0]])
    errors = [np.concatenate([result.modelled[result.counted] - _force(result) for result in of]) for of in judged]
    edges = np.cumsum([0, *(len(_force(result)) for result in judged[0])])
    blocks = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges)]
    by_runs = len(blocks) >= FEWEST_RUNS
    # Within a run, a level of its own left aside: too few runs are no sample of what differs between them.
    within = max(correlation_length(error[block] - error[block].mean()) for error in errors for block in blocks)
    units = blocks if by_runs else independent_segments(blocks, within)
    # How often each unit is drawn in each resample; the same draws for all models make their differences sharp.
    draws = np.random.default_rng(0).multinomial(len(units), np.full(len(units), 1 / len(units)), RESAMPLES).astype(float)
    count, total, square = (np.array([of(force[unit]) for unit in units]) for of in (len, np.sum, lambda part: part @ part))
    squared = np.array([[error[unit] @ error[unit] for unit in units] for error in errors])

    def nrmse(weights: Array) -> Array:
        samples = weights @ count
        variance = weights @ square / samples - (weights @ total / samples) ** 2
        return np.asarray(np.sqrt(squared @ weights.T / samples / np.maximum(variance, 1e-300)))

    found, drawn = nrmse(np.ones(len(units))), nrmse(draws)
    if not by_runs and len(units) < FEWEST_STRETCHES:
        drawn[:] = np.nan
    best = int(np.argmin(found))
    entries = []
    for index in np.argsort(found, kind="stable"):
        lower, upper = np.quantile(drawn[index], (0.025, 0.975))
        behind = np.quantile(drawn[index] - drawn[best], (0.025, 0.975))
        entries.append(
            Entry(
                names[index],
                fits[index],
                float(found[index]),
                float(lower),
                float(upper),
                float(found[index] - found[best]),
                float(behind[0]),
                float(behind[1]),
            )
        )
    return Comparison(tuple(entries), fits[0].held_out_by, "runs" if by_runs else "stretches", len(units))


def _force(result: RunResult) -> Array:
    return result.run.force[result.counted]


def _case(name: str, runs: tuple[Run, ...], held_out: tuple[Run, ...], method: Method) -> IdentificationTask:
    model, _, law = name.partition(":")
    find_model(model, law)
    return IdentificationTask(runs, model, held_out, replace(method, laws=law) if law else method)
