"""Trend of one parameter of a damper over dated runs: wear, loss of gas, thickening of the fluid."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mrd_base import InputError
from mrd_base.progress import ignore
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.calendar import Calendar, make_calendar
from mrd_diagnosis.trend.dated_fit import DatedFit, Progress, fit_dates
from mrd_diagnosis.trend.sentence import describe_trend
from mrd_diagnosis.trend.trend_line import FEWEST_DATES_FOR_CHANGE, TrendLine, fit_trend_line
from mrd_runs import Run
from mrd_runs.scales import scales_of
from mrd_runs.text import named_run
from mrd_sim.models import DamperModel, find_model


@dataclass(frozen=True)
class Trend:
    """Trend of a parameter over dated runs.

    Attributes
    ----------
    runs : tuple of Run
    calendar : Calendar
    fit : DatedFit
    values : tuple of Interval
        Value of the parameter at each date. The intervals hold the errors within the runs of the date; their ends are nan
        where they are unknown.
    line : TrendLine
    limit : float or None
        Value whose crossing is predicted.
    sentence : str
    notes : tuple of str
        What limits the result.
    seed : int
    elapsed : float
        Computing time in s.
    """

    runs: tuple[Run, ...]
    calendar: Calendar
    fit: DatedFit
    values: tuple[Interval, ...]
    line: TrendLine
    limit: float | None
    sentence: str
    notes: tuple[str, ...]
    seed: int
    elapsed: float

    @property
    def crossing(self) -> Interval | None:
        """Time at which the line reaches the limit, or has passed it; None without a limit, or where that is not known."""
        return None if self.limit is None else self.line.crossing(self.limit)


def trend(
    runs: Sequence[Run],
    model: str,
    follow: str,
    *,
    effects: Sequence[str] = (),
    laws: str | Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    calendar: Calendar | None = None,
    limit: float | None = None,
    seed: int = 0,
    progress: Progress = ignore,
) -> Trend:
    """Follow a parameter of a model, or of one of its effects, over dated runs.

    All runs are fitted together: the parameter has a value at each date, and all other parameters are common to the dates.
    Each run has a free force offset, unless the parameter is an offset itself.

    Parameters
    ----------
    runs : sequence of Run
    model : str
        Id of the damper model.
    follow : str
        Name of the parameter; ``EFFECT.PARAMETER`` for a parameter of an effect, which is then added to the model.
    effects : sequence of str
        Further effects to add to the model.
    laws : str or mapping, optional
        Current laws; see `DamperModel.with_laws`.
    parameters : mapping, optional
        Parameters to start from; without them, the model is identified first.
    calendar : Calendar, optional
        Dates of the runs; default: `make_calendar`.
    limit : float, optional
        Value in SI units; the time at which the parameter reaches it is predicted.
    seed : int
    progress : callable
        Called with the stage and the fraction done. An exception that it raises ends the work.

    Raises
    ------
    InputError
        For unknown names, too few dates, a limit that is not finite, or a parameter that does not affect the force.
    """
    began = time.monotonic()
    if limit is not None and not np.isfinite(limit):
        raise InputError(f"limit is {limit:g}, expected a finite number")
    with_effects = _add_effects(find_model(model, laws, scales=scales_of(runs)), follow, effects)
    calendar = calendar or make_calendar(runs)
    calendar.check()
    progress("reading the runs", 0.0)
    fit = fit_dates(runs, calendar.date_index, with_effects, follow, parameters=parameters, seed=seed, progress=progress)
    line = fit_trend_line(calendar.times, fit.values, fit.covariance, seed)
    notes = fit.notes
    if calendar.undated:
        notes += (f"{named_run(calendar.undated)} has no date, so all runs are counted in the given order",)
    if len(calendar.times) < FEWEST_DATES_FOR_CHANGE:
        notes += (f"no change point was looked for: this needs at least {FEWEST_DATES_FOR_CHANGE} dates",)
    values = _intervals(fit)
    sentence = describe_trend(follow, fit.parameter.unit, calendar, values, line, limit)
    progress("done", 1.0)
    return Trend(tuple(runs), calendar, fit, values, line, limit, sentence, notes, seed, time.monotonic() - began)


def _intervals(fit: DatedFit) -> tuple[Interval, ...]:
    """Return the value at each date with its 95 % interval, where its error is known."""
    half_widths = 1.96 * np.sqrt(np.diag(fit.covariance))
    return tuple(
        Interval(float(value), float(value - half), float(value + half)) if half > 0 else Interval(float(value))
        for value, half in zip(fit.values, half_widths, strict=True)
    )


def _add_effects(model: DamperModel, follow: str, effects: Sequence[str]) -> DamperModel:
    """Add effects to a model, among them the one whose parameter is followed."""
    effect = follow.partition(".")[0]
    if "." in follow and effect not in effects:
        effects = (*effects, effect)
    with_effects = find_model(model.id, model.laws, effects, model.scales)
    if follow not in with_effects.names:
        raise InputError(f"model {model.id}: unknown parameter {follow} (known: {', '.join(with_effects.names)})")
    return with_effects
