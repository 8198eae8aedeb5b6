"""The trend in words."""

from collections.abc import Sequence

import numpy as np

from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.calendar import Calendar
from mrd_diagnosis.trend.trend_line import LONGEST_PREDICTION, TrendLine
from mrd_diagnosis.wording.quantities import format_apart, format_quantity

LONG_SERIES = 60.0
"""Days from which a slope is given per year: per day, it would be a tiny number."""

SHORT_SERIES = 1.0
"""Days below which a slope is given per hour: within a day, a rate per day is extrapolated."""


def describe_trend(
    name: str, unit: str, calendar: Calendar, values: tuple[Interval, ...], line: TrendLine, limit: float | None
) -> str:
    """Describe the trend of a parameter in a few short sentences.

    Parameters
    ----------
    name, unit : str
        Name and unit of the parameter.
    calendar : Calendar
    values : tuple of Interval
        Value of the parameter at each date.
    line : TrendLine
    limit : float or None
        Value whose crossing is predicted.
    """
    factor, period = 1.0, calendar.unit
    if calendar.start is not None and calendar.times[-1] > LONG_SERIES:
        factor, period = 365.25, "year"
    elif calendar.start is not None and calendar.times[-1] < SHORT_SERIES:
        factor, period = 1.0 / 24.0, "hour"

    def rate(slope: Interval, style: str = "") -> str:
        scaled = Interval(factor * slope.value, factor * slope.lower, factor * slope.upper)
        return f"{format_quantity(scaled, unit, style)} per {period}"

    def levels(dates: Sequence[int]) -> list[str]:
        return format_apart([float(value) for value in line.predict(calendar.times[dates])[0]], unit)

    has_bend = line.change is not None and line.change.kind == "bend"
    has_step = line.change is not None and not has_bend
    # After a bend, the slope holds from the bend on.
    begin = line.change.before if line.change is not None and has_bend else 0
    first, last = calendar.labels[begin], calendar.labels[-1]
    slope = line.slope
    if not _is_certain(slope):
        mean = format_quantity(float(np.mean([value.value for value in values[begin:]])), unit)
        that = "beside a jump, it" if has_step else f"its mean is {mean}, and it"
        sentences = [f"{name} shows no trend from {first} to {last}: {that} changes by {rate(slope)}"]
    else:
        verb = "grows" if slope.value > 0 else "falls"
        start, end = levels([begin, -1])
        beside = " beside a jump" if has_step else ""
        sentences = [f"{name} {verb} by {rate(slope, 'size')}{beside}, from {start} ({first}) to {end} ({last})"]
    if line.change is not None and line.change_size is not None:
        before, after = calendar.labels[line.change.before], calendar.labels[line.change.after]
        if has_bend:
            sentences.append(f"Its slope changes by {rate(line.change_size)} at {before}")
        else:
            low, high = levels([line.change.before, line.change.after])
            size = format_quantity(line.change_size, unit)
            sentences.append(f"It jumps by {size} between {before} and {after}, from {low} to {high}")
    elif not np.isnan(line.p_change):
        sentences.append("No step or bend is clear")
    if limit is not None:
        sentences.append(_describe_crossing(line, limit, format_quantity(limit, unit), calendar))
    return ". ".join(sentences) + "."


def _is_certain(slope: Interval) -> bool:
    """Whether the sign of a slope is certain."""
    return not slope.lower <= 0.0 <= slope.upper


def _describe_crossing(line: TrendLine, limit: float, named: str, calendar: Calendar) -> str:
    """Return when a line reaches a limit, ``named`` in words, or why that is not known."""
    last = calendar.times[-1:]
    if crossing := line.crossing(limit):
        time, early, late = (calendar.label(t) for t in (crossing.value, crossing.lower, crossing.upper))
        verb = "reaches" if crossing.value >= last[0] else "passed"
        return f"It {verb} {named} at about {time} (95 % interval: {early} to {late})"
    if not _is_certain(line.slope):
        return f"When it reaches {named} cannot be predicted"
    if (limit - line.predict(last)[0][0]) * line.slope.value <= 0.0:
        return f"It moves away from {named}"
    return f"It does not reach {named} within {LONGEST_PREDICTION:g} times the time of these dates"
