"""Figure of a trend."""

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from mrd_base import figures
from mrd_diagnosis.trend.trend import Trend

Array = NDArray[np.float64]

LONGEST_EXTRAPOLATION = 2.0
"""Time that the figure goes on after the last date, over the time between the dates: with more, the dates would be hardly
visible."""
SHOWN_AFTER_END = 0.03
"""Share of the time between the dates that is shown after the end of the line."""
LIMIT_COLOUR, INTERVAL_COLOUR = "#edae49", "rgba(209,73,91,0.15)"


def trend_figure(trend: Trend) -> go.Figure:
    """Draw the value at each date with its interval, the trend line with its interval, change point and limit."""
    calendar, parameter = trend.calendar, trend.fit.parameter
    figure = go.Figure([*_line_with_interval(trend), _values(trend)])
    if trend.limit is not None:
        figure.add_hline(y=trend.limit, line={"color": LIMIT_COLOUR, "dash": "dash"}, annotation_text="limit")
    if (change := trend.line.change) is not None:
        (place,) = _axis(trend, np.array([0.5 * (calendar.times[change.before] + calendar.times[change.after])]))
        figure.add_vline(x=place, line={"color": figures.MEASURED, "dash": "dot"})
        figure.add_annotation(x=place, yref="paper", y=1.0, text=change.kind, showarrow=False, xanchor="left")
    figure.update_xaxes(title_text=None if calendar.start else "run")
    unit = f", {parameter.unit}" if parameter.unit else ""
    figure.update_yaxes(title_text=f"{parameter.name}{unit}", automargin=True)
    figure.update_layout(**figures.LAYOUT, height=460)
    return figure


def _line_with_interval(trend: Trend) -> tuple[go.Scatter, go.Scatter]:
    start, end = (float(time) for time in trend.calendar.times[[0, -1]])
    span = end - start
    if (crossing := trend.crossing) is not None:
        end = min(max(end, crossing.value), end + LONGEST_EXTRAPOLATION * span)
    times = np.linspace(start, end + SHOWN_AFTER_END * span, 200)
    value, lower, upper = trend.line.predict(times)
    interval = go.Scatter(
        x=_axis(trend, np.concatenate([times, times[::-1]])),
        y=np.concatenate([upper, lower[::-1]]),
        fill="toself",
        fillcolor=INTERVAL_COLOUR,
        line={"width": 0},
        hoverinfo="skip",
        name="95 % interval of the trend",
    )
    return interval, go.Scatter(x=_axis(trend, times), y=value, mode="lines", name="trend", line={"color": figures.MODELLED})


def _values(trend: Trend) -> go.Scatter:
    half_widths = np.nan_to_num([value.upper - value.value for value in trend.values])
    return go.Scatter(
        x=_axis(trend, trend.calendar.times),
        y=[value.value for value in trend.values],
        mode="markers",
        name="value at each date",
        marker={"color": figures.ACCENT, "size": 9},
        text=trend.calendar.labels,
        error_y={"type": "data", "array": half_widths, "color": figures.MEASURED, "thickness": 2, "width": 5},
    )


def _axis(trend: Trend, times: Array) -> list[Any]:
    """Convert times to what the axis of the figure shows: dates, or numbers of runs."""
    start = trend.calendar.start
    if start is None:
        return [float(time) for time in times]
    days = np.datetime64(start.replace(tzinfo=None)) + (times * 86400e6).astype("timedelta64[us]")
    return [str(day) for day in days]
