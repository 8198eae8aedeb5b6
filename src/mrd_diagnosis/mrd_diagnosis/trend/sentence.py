"""The trend in words."""

import numpy as np

from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.calendar import Calendar
from mrd_diagnosis.trend.trend_line import TrendLine
from mrd_diagnosis.wording.quantities import format_quantity

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

    # After a bend, the slope holds from the bend on.
    has_bend = line.change is not None and line.change.kind == "bend"
    ends = [line.change.before if line.change is not None and has_bend else 0, -1]
    first, last = (calendar.labels[end] for end in ends)
    slope = line.slope
    if slope.lower <= 0.0 <= slope.upper:
        mean = format_quantity(float(np.mean([value.value for value in values])), unit)
        sentences = [f"{name} shows no trend from {first} to {last}: its mean is {mean}, and it changes by {rate(slope)}"]
    else:
        verb = "grows" if slope.value > 0 else "falls"
        start, end = (format_quantity(float(value), unit) for value in line.predict(calendar.times[ends])[0])
        sentences = [f"{name} {verb} by {rate(slope, 'size')}, from {start} ({first}) to {end} ({last})"]
    if line.change is not None and line.change_size is not None:
        before, after = calendar.labels[line.change.before], calendar.labels[line.change.after]
        if has_bend:
            sentences.append(f"Its slope changes by {rate(line.change_size)} at {before}")
        else:
            sentences.append(f"It jumps by {format_quantity(line.change_size, unit)} between {before} and {after}")
    elif not np.isnan(line.p_change):
        sentences.append("There is no change point")
    if limit is not None:
        sentences.append(_describe_crossing(line.crossing(limit), format_quantity(limit, unit), calendar))
    return ". ".join(sentences) + "."


def _describe_crossing(crossing: Interval | None, limit: str, calendar: Calendar) -> str:
    if crossing is None:
        return f"When it reaches {limit} cannot be predicted"
    time, early, late = (calendar.label(t) for t in (crossing.value, crossing.lower, crossing.upper))
    return f"It reaches {limit} at about {time} (95 % interval: {early} to {late})"
