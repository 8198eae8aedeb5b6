"""One parameter of a damper over dated runs: wear, gas loss, thickening."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from mrd_base import InputError
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.report.sentences import human, share
from mrd_diagnosis.trend.change_point import FEWEST_DATES, FEWEST_FOR_CHANGE, Growth, growth
from mrd_identification.identify import search_and_fit
from mrd_identification.least_squares import BOUND_TOLERANCE, levenberg_marquardt
from mrd_identification.method import Method
from mrd_identification.problem import Problem, make_problem
from mrd_identification.recording import Recording, prepare_recording
from mrd_identification.residual_correlation import correlation_length, independent_segments
from mrd_identification.uncertainty import FEWEST_SPARE_BLOCKS, normal_inverse
from mrd_runs import Run
from mrd_sim.dual import STEP
from mrd_sim.models import DamperModel, Parameter, SeriesSolutions, find_model

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

MOST_DERIVATIVES = 2e7
"""Samples times parameters; where there were more, only every so many-th sample counts. Neighbours say much the same."""

LIKELIER = 0.1
"""Share of the error left by the followed parameter that another one must remove to be told."""

LONG = 60.0
"""Days from which on a pace is told by the year."""


def no_progress(_stage: str, _fraction: float) -> None:
    """Nobody wants to know."""


@dataclass(frozen=True)
class Calendar:
    """When runs were recorded.

    Attributes
    ----------
    basis : {"given", "recorded", "order"}
        Where the dates are from; ``order`` counts the runs.
    place : tuple of int
        Of each run, among the dates.
    times : ndarray (dates,)
        Days since the first, or the runs' numbers; increasing.
    labels : tuple of str
        The dates in words.
    start : datetime or None
        Time 0; None where runs are counted.
    """

    basis: str
    place: tuple[int, ...]
    times: Array
    labels: tuple[str, ...]
    start: datetime | None

    @property
    def unit(self) -> str:
        """Of the times."""
        return "day" if self.start else "run"

    def label(self, at: float) -> str:
        """A time in words."""
        if self.start is None:
            return f"run {at:.0f}"
        try:
            return f"{self.start + timedelta(days=at):%Y-%m-%d}"
        except OverflowError:
            return "never" if at > 0 else "long ago"


@dataclass(frozen=True)
class Trend:
    """A parameter over dated runs.

    Attributes
    ----------
    model : DamperModel
        With the effects around it.
    parameter : Parameter
        What was followed.
    calendar : Calendar
    runs : tuple of Run
    values : tuple of Interval
        Of each date; the intervals hold the errors within its runs. Where a date would have the parameter beyond its bound,
        the value is what the slope there promises, so that a trend does not bend at the bound.
    growth : Growth
    limit : float or None
    reached : Interval or None
        Time at which the trend reaches the limit.
    common : mapping
        All other parameters, by name, the same at every date.
    offsets : bool
        Whether each run had a force offset of its own.
    nrmse : float
        Of the fit to all runs.
    sentence : str
    notes : tuple of str
        What limits the answer.
    seed : int
    elapsed : float
        s.
    """

    model: DamperModel
    parameter: Parameter
    calendar: Calendar
    runs: tuple[Run, ...]
    values: tuple[Interval, ...]
    growth: Growth
    limit: float | None
    reached: Interval | None
    common: Mapping[str, float]
    offsets: bool
    nrmse: float
    sentence: str
    notes: tuple[str, ...]
    seed: int
    elapsed: float


@dataclass(frozen=True)
class DatedProblem(Problem):
    """A problem of which one parameter has a value at each date: these follow the parameters of the model in ``theta``.

    Every run begins with a damper at rest, unloaded and cool.

    Attributes
    ----------
    followed : int
        Index of that parameter.
    place : tuple of int
        Date of each recording.
    """

    followed: int = 0
    place: tuple[int, ...] = ()

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The free parameters, the followed one at each date last."""
        dates = len(self.base) - len(self.model.parameters)
        every = (*self.model.parameters, *[self.model.parameters[self.followed]] * dates)
        return tuple(every[index] for index in self.free)

    def modelled(self, theta: Array, index: int) -> Array:
        """Modelled force in N at the counted samples of one recording."""
        return self._modelled(theta, index, None)

    def _modelled(self, theta: Array, index: int, solutions: SeriesSolutions | None) -> Array:
        own = theta[: len(self.model.parameters)].copy()
        own[self.followed] = theta[len(own) + self.place[index]]
        recording = self.recordings[index]
        return self.model.force(own, recording.path, solutions=solutions)[recording.counted]

    def forces(self, theta: Array, solutions: SeriesSolutions | None = None) -> Array:
        """Modelled force in N over all counted samples; ``solutions`` is as in `mrd_sim.models.DamperModel.force`."""
        return np.concatenate([self._modelled(theta, index, solutions) for index in range(len(self.recordings))])

    def jacobian(self, unit: Array, indices: Sequence[int] | NDArray[np.intp] | None = None) -> Array:
        """Exact derivatives (samples, indices) of the residuals to the unit coordinates, all or those of ``indices``."""
        dates = len(self.base) - len(self.model.parameters)
        common = super().jacobian(unit, range(len(self.free) - dates))
        theta = self.theta(unit)
        moved = theta.astype(complex)
        moved[-dates:] += 1j * STEP * self.scale(theta)[-dates:]
        # A run knows its own date only, so one pass has the derivatives of all dates.
        slope = self.forces(moved).imag / STEP
        place = np.repeat(self.place, [len(r.force) for r in self.recordings])
        dated = [self.counted(np.where(place == date, slope, 0.0)) for date in range(dates)]
        found = np.column_stack([common, *dated])
        return found if indices is None else found[:, indices]


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
    progress: Progress = no_progress,
) -> Trend:
    """Follow a parameter of a model, or of an effect around it, over dated runs.

    All runs are fitted together: the parameter has a value at each date, all others are common. Force offsets of single runs
    do not count, unless the parameter is an offset.

    Parameters
    ----------
    runs : sequence of Run
    model : str
    follow : str
        Name of the parameter, ``EFFECT.PARAMETER`` for one of an effect, which then acts around the model.
    effects : sequence of str
        What else does.
    laws : str or mapping, optional
        Current laws, see `DamperModel.with_laws`.
    parameters : mapping, optional
        Where to start; without, a search finds that.
    calendar : Calendar, optional
        As from `calendar_of`, which is the default.
    limit : float, optional
        SI; when will the parameter reach it?
    seed : int
    progress : callable
        Called with stage and fraction; what it raises ends the work.

    Raises
    ------
    InputError
        For unknown names, fewer than three dates, a limit that is no number, or a parameter of which the runs say nothing.
    """
    began = time.monotonic()
    if limit is not None and not np.isfinite(limit):
        raise InputError(f"limit is {limit:g}, expected a finite number")
    own = find_model(model, laws)
    around = _around(own, follow, effects)
    followed = around.names.index(follow)
    calendar = calendar or calendar_of(runs)
    if len(calendar.times) < FEWEST_DATES:
        raise InputError(f"{len(calendar.times)} dates, expected at least {FEWEST_DATES} to tell growth from scatter")
    offsets = not follow.endswith("offset")
    progress("reading the runs", 0.0)
    recordings = _thinned([prepare_recording(run) for run in runs], len(around.names) + len(calendar.times))
    # The effect takes the place of the model's own lag.
    fixed = {"coil_lag": 0.0} if "coil_lag" in (effect.id for effect in around.effects) else {}
    problem, notes = make_problem(around, recordings, fixed=fixed, freed=[follow], offsets=offsets)
    if followed not in problem.free:
        raise InputError(f"{follow}: these runs say nothing of it ({'; '.join(notes)})")
    progress("fitting all runs alike", 0.05)
    theta = _common(problem, own, laws, parameters, runs, seed, lambda share: progress("searching", 0.05 + 0.4 * share))
    progress("fitting each date", 0.5)
    notes = [*notes, *_likelier(problem, theta, followed, calendar.place)]
    dated = _dated(problem, followed, calendar.place)
    start = np.concatenate([theta, np.full(len(calendar.times), theta[followed])])
    unit, _ = levenberg_marquardt(dated, dated.unit(start), np.arange(len(dated.free)), 60, 1e-8)
    progress("judging", 0.9)
    values, covariance, more = _estimates(dated, unit, len(calendar.times))
    deviations = np.sqrt(np.diag(covariance))
    grown = growth(calendar.times, values, covariance, seed)
    if len(calendar.times) < FEWEST_FOR_CHANGE:
        more = [*more, f"no change point was looked for: that takes {FEWEST_FOR_CHANGE} dates"]
    theta = dated.theta(unit)
    errors = dated.residuals(theta)
    found = Trend(
        model=around,
        parameter=around.parameters[followed],
        calendar=calendar,
        runs=tuple(runs),
        values=tuple(
            Interval(float(value), *((float(value - half), float(value + half)) if half > 0 else ()))
            for value, half in zip(values, 1.96 * deviations, strict=True)
        ),
        growth=grown,
        limit=limit,
        reached=None if limit is None else grown.reaches(limit),
        common={n: float(theta[i]) for i, n in enumerate(around.names) if i != followed},
        offsets=offsets,
        nrmse=float(np.sqrt(np.mean(errors**2)) / np.std(dated.force)),
        sentence="",
        notes=(*notes, *more),
        seed=seed,
        elapsed=time.monotonic() - began,
    )
    progress("done", 1.0)
    return replace(found, sentence=sentence(found))


def calendar_of(runs: Sequence[Run], given: Sequence[str] = ()) -> Calendar:
    """When runs were recorded: as given, or as they say themselves, or in their order.

    Runs of one day share a date, unless there are too few days.

    Parameters
    ----------
    runs : sequence of Run
    given : sequence of str
        A date, or date and time, in ISO 8601, for each run.

    Raises
    ------
    InputError
        For dates that are none, or not as many as there are runs.
    """
    if given and len(given) != len(runs):
        raise InputError(f"--dates: {len(given)} dates for {len(runs)} runs, expected one for each")
    moments = [_moment(text) for text in given] if given else [_recorded(run) for run in runs]
    known = [moment for moment in moments if moment is not None]
    if len(known) < len(runs):
        numbers = np.arange(1.0, len(runs) + 1.0)
        labels = tuple(f"run {number:.0f}" for number in numbers)
        return Calendar("order", tuple(range(len(runs))), numbers, labels, None)
    keys = [moment.replace(hour=0, minute=0, second=0, microsecond=0) for moment in known]
    by_day = len(set(keys)) >= FEWEST_DATES
    if not by_day:
        keys = known
    distinct = sorted(set(keys))
    times = np.array([(moment - distinct[0]) / timedelta(days=1) for moment in distinct])
    labels = tuple(f"{moment:%Y-%m-%d}" if by_day else f"{moment:%Y-%m-%d %H:%M:%S}" for moment in distinct)
    place = tuple(distinct.index(key) for key in keys)
    return Calendar("given" if given else "recorded", place, times, labels, distinct[0])


def sentence(found: Trend) -> str:
    """The trend in one sentence."""
    grown, name, unit, calendar = found.growth, found.parameter.name, found.parameter.unit, found.calendar
    # A slope after a bend holds from there on.
    begins = grown.change.before if grown.change is not None and grown.change.kind == "bend" else 0
    ends = calendar.times[[begins, -1]]
    first, last = (calendar.label(float(end)) for end in ends)
    long = calendar.start is not None and calendar.times[-1] > LONG
    factor, per = (365.25, "year") if long else (1.0, calendar.unit)

    def pace(of: Interval, style: str = "") -> str:
        return f"{human(Interval(factor * of.value, factor * of.lower, factor * of.upper), unit, style)} a {per}"

    if grown.slope.lower <= 0.0 <= grown.slope.upper:
        middle = human(float(np.mean([value.value for value in found.values])), unit)
        text = f"{name} shows no trend from {first} to {last}: {middle}, changing by {pace(grown.slope)}"
    else:
        goes = "grows" if grown.slope.value > 0 else "falls"
        here, there = (human(float(end), unit) for end in grown.line(ends)[0])
        text = f"{name} {goes} by {pace(grown.slope, 'size')}, from {here} ({first}) to {there} ({last})"
    if grown.change is not None:
        before, after = (calendar.labels[place] for place in (grown.change.before, grown.change.after))
        if grown.change.kind == "step":
            text += f"; it jumps by {human(grown.change.size, unit)} between {before} and {after}"
        else:
            text += f"; its slope changes by {pace(grown.change.size)} there, at {before}"
    elif grown.p_change == grown.p_change:
        text += "; no change point"
    if found.limit is not None:
        bound = human(found.limit, unit)
        if found.reached is None:
            text += f"; when it reaches {bound} cannot be told"
        else:
            at, early, late = (calendar.label(t) for t in (found.reached.value, found.reached.lower, found.reached.upper))
            text += f"; it reaches {bound} about {at} ({early} to {late})"
    return f"{text}."


def _moment(text: str) -> datetime:
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        raise InputError(f"--dates: {text!r} is no date, expected one as 2024-05-31 or 2024-05-31T14:00") from None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _recorded(run: Run) -> datetime | None:
    """When a run was recorded, by its bag; None where it does not say."""
    try:
        return _moment(str(run.info.get("started", "")))
    except InputError:
        return None


def _around(own: DamperModel, follow: str, effects: Sequence[str]) -> DamperModel:
    """The model with effects, among them the one whose parameter is followed."""
    effect = follow.partition(".")[0]
    if "." in follow and effect not in effects:
        effects = (*effects, effect)
    around = find_model(own.id, own.laws, effects)
    if follow not in around.names:
        raise InputError(f"model {own.id}: unknown parameter {follow} (known: {', '.join(around.names)})")
    return around


def _thinned(recordings: Sequence[Recording], columns: int) -> list[Recording]:
    samples = sum(len(recording.force) for recording in recordings)
    step = int(np.ceil(samples * columns / MOST_DERIVATIVES))
    return [replace(r, counted=slice(r.counted.start, r.counted.stop, step)) for r in recordings]


def _common(
    problem: Problem,
    own: DamperModel,
    laws: str | Mapping[str, str] | None,
    parameters: Mapping[str, float] | None,
    runs: Sequence[Run],
    seed: int,
    progress: Callable[[float], None],
) -> Array:
    """Parameters (parameters,) of one fit to all runs."""
    around = problem.model
    if parameters is None:
        method = Method(laws=laws or {}, offsets=problem.offsets)
        found = search_and_fit(runs, own.id, method, seed, lambda generation, _: progress(generation / method.generations))
        parameters = dict(zip(own.names, map(float, found.theta), strict=True))
    neutral = problem.base.copy()
    free = list(problem.free)
    known = around.vector(parameters)
    neutral[free] = known[free]
    there = neutral.copy()
    for effect in around.effects:
        for name, value in effect.typical.items():
            index = around.names.index(f"{effect.id}.{name}")
            if f"{effect.id}.{name}" not in parameters and index in free:
                there[index] = value
    starts = [neutral] if (there == neutral).all() else [neutral, there]
    found_from = [levenberg_marquardt(problem, problem.unit(start), np.arange(len(free)), 40, 1e-6) for start in starts]
    return problem.theta(min(found_from, key=lambda of: of[1])[0])


def _likelier(problem: Problem, theta: Array, followed: int, place: tuple[int, ...]) -> list[str]:
    """A note where the change of another parameter would explain the dates better, to first order."""
    unit = problem.unit(theta)
    residuals, jacobian = problem.residuals(theta), problem.jacobian(unit)
    date = np.repeat(place, [len(recording.force) for recording in problem.recordings])
    dates, count = max(place) + 1, len(unit)
    grams = np.stack([jacobian[date == d].T @ jacobian[date == d] for d in range(dates)])
    slopes = np.stack([jacobian[date == d].T @ residuals[date == d] for d in range(dates)])

    def gain(index: int) -> float:
        """Share of the squared error that a value of one parameter at each date takes away."""
        others = np.delete(np.arange(count), index)
        gram = np.diag(np.concatenate([np.zeros(count - 1), grams[:, index, index]]))
        gram[: count - 1, : count - 1] = grams.sum(axis=0)[np.ix_(others, others)]
        gram[count - 1 :, : count - 1] = grams[:, index, others]
        gram[: count - 1, count - 1 :] = grams[:, index, others].T
        slope = np.concatenate([slopes.sum(axis=0)[others], slopes[:, index]])
        size = np.sqrt(np.maximum(np.diag(gram), 1e-12 * np.diag(gram).max()))
        return float(slope / size @ normal_inverse(gram / np.outer(size, size)) @ (slope / size) / (residuals @ residuals))

    gains = [gain(index) for index in range(count)]
    best, own = int(np.argmax(gains)), gains[problem.free.index(followed)]
    if gains[best] < own + LIKELIER * (1.0 - own):
        return []
    return [
        f"what changes from date to date looks more like {problem.parameters[best].name}, whose change would remove "
        f"{share(gains[best])} of the squared error, than like {problem.model.names[followed]} with {share(own)}"
    ]


def _dated(problem: Problem, followed: int, place: tuple[int, ...]) -> DatedProblem:
    count, dates = len(problem.base), max(place) + 1
    free = (*(index for index in problem.free if index != followed), *range(count, count + dates))
    base = np.concatenate([problem.base, np.full(dates, problem.base[followed])])
    return DatedProblem(problem.model, problem.recordings, free, base, problem.offsets, followed=followed, place=place)


def _estimates(problem: DatedProblem, unit: Array, dates: int) -> tuple[Array, Array, list[str]]:
    """Value (dates,) of the followed parameter at each date, and covariance of their errors.

    The sandwich of `mrd_identification.uncertainty`, over stretches of the runs: what differs from date to date is left to
    the trend. A date on a bound goes on to where the parabola of the objective is least.
    """
    theta = problem.theta(unit)
    residuals, jacobian = problem.residuals(theta), problem.jacobian(unit)
    norm = np.linalg.norm(jacobian, axis=0)
    dated = np.arange(len(unit)) >= len(unit) - dates
    if (norm[dated] == 0).any():
        name = problem.model.names[problem.followed]
        raise InputError(f"{name}: the force of some date does not depend on it; follow another, or leave that date out")
    on_bound = (unit < BOUND_TOLERANCE) | (unit > 1 - BOUND_TOLERANCE)
    seen = (norm > 0) & (dated | ~on_bound)
    scaled = jacobian[:, seen] / norm[seen]
    inverse = normal_inverse(scaled.T @ scaled)
    step = -(inverse @ (scaled.T @ residuals)) / norm[seen]
    scale = problem.scale(theta)
    last = slice(-dates, None)
    values = theta[last] + np.where(on_bound.any(), step[last], 0.0) * scale[last]
    parts = independent_segments(problem.blocks, correlation_length(residuals))
    notes: list[str] = []
    spare = len(parts) - int(seen.sum()) - problem.run_offsets
    if spare < FEWEST_SPARE_BLOCKS:
        few = f"no intervals of single dates: the runs have {len(parts)} independent stretches; record longer runs"
        return values, np.zeros((dates, dates)), [few]
    scores = np.stack([scaled[part].T @ residuals[part] for part in parts])
    root = (inverse @ scores.T)[last] * (scale[last] / norm[last])[:, None]
    # Wider by Student's t over the normal, for few stretches.
    wider = float(stdtrit(spare, 0.975)) / 1.96
    if at := int(on_bound[dated].sum()):
        notes.append(f"{at} of {dates} dates have the parameter on its bound; their values are drawn on beyond it")
    return values, wider**2 * len(parts) / spare * (root @ root.T), notes
