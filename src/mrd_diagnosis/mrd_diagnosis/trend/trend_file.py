"""A trend as files: trend.json and trend.html."""

from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.trend import Trend
from mrd_identification import figures
from mrd_identification.json_file import finite, run_json, versions, write_json
from mrd_identification.report import render

SCHEMA = "mrd-trend/1"


def to_json(found: Trend) -> dict[str, Any]:
    """Content of trend.json; floats that are not finite become null."""
    calendar, grown, model = found.calendar, found.growth, found.model
    change, parameter = grown.change, found.parameter
    per = f"{parameter.unit or '1'}/{calendar.unit}"
    return {
        "schema": SCHEMA,
        "sentence": found.sentence,
        "model": model.id,
        "laws": model.laws,
        "effects": [effect.id for effect in model.effects],
        "parameter": {"name": parameter.name, "unit": parameter.unit, "meaning": parameter.meaning},
        "dated_by": calendar.basis,
        "time_unit": calendar.unit,
        "dates": [
            {
                "label": label,
                "time": float(calendar.times[date]),
                "runs": [run_json(run) for run, place in zip(found.runs, calendar.place, strict=True) if place == date],
                **_interval(found.values[date]),
            }
            for date, label in enumerate(calendar.labels)
        ],
        "slope": {**_interval(grown.slope), "unit": per},
        "scatter": grown.scatter,
        "change_point": {
            "p_value": finite(grown.p_change),
            "found": change
            and {
                "kind": change.kind,
                "between": [calendar.labels[change.before], calendar.labels[change.after]],
                "size": {**_interval(change.size), "unit": parameter.unit if change.kind == "step" else per},
            },
        },
        "limit": None
        if found.limit is None
        else {
            "value": found.limit,
            "reached": found.reached and {**_interval(found.reached), "label": calendar.label(found.reached.value)},
        },
        "common": {name: {"value": value, "unit": _unit(found, name)} for name, value in found.common.items()},
        "run_offsets": found.offsets,
        "nrmse": found.nrmse,
        "seed": found.seed,
        "elapsed_s": round(found.elapsed, 3),
        "notes": list(found.notes),
        "versions": versions(),
    }


def write_trend(found: Trend, folder: str | Path) -> Path:
    """Write trend.json and trend.html, which needs no network, into ``folder``; returns the page's path."""
    write_json(to_json(found), "mrd_diagnosis", "trend", folder)
    return render(
        "trend",
        folder,
        "mrd_diagnosis",
        title=f"{found.parameter.name} over {len(found.calendar.times)} dates",
        sentence=found.sentence,
        picture=figures.html(picture(found)),
        trend=found,
        unit_of={name: _unit(found, name) for name in found.common},
        runs_of=[
            ", ".join(run.name for run, place in zip(found.runs, found.calendar.place, strict=True) if place == date)
            for date in range(len(found.calendar.times))
        ],
    )


def picture(found: Trend) -> go.Figure:
    """Value at each date with its interval, the line with its own, change point and limit."""
    calendar, grown = found.calendar, found.growth
    end = float(calendar.times[-1])
    span = end - float(calendar.times[0])
    if found.reached is not None:  # but not so far that nothing else is seen
        end = min(max(end, found.reached.value), end + 2 * span)
    fine = np.linspace(float(calendar.times[0]), end + 0.03 * span, 200)
    middle, lower, upper = grown.line(fine)
    figure = go.Figure(
        go.Scatter(
            x=_axis(found, np.concatenate([fine, fine[::-1]])),
            y=np.concatenate([upper, lower[::-1]]),
            fill="toself",
            fillcolor="rgba(209,73,91,0.15)",
            line={"width": 0},
            hoverinfo="skip",
            name="95 % of the trend",
        )
    )
    figure.add_trace(
        go.Scatter(x=_axis(found, fine), y=middle, mode="lines", name="trend", line={"color": figures.MODELLED})
    )
    half = [value.upper - value.value if value.upper == value.upper else 0.0 for value in found.values]
    figure.add_trace(
        go.Scatter(
            x=_axis(found, calendar.times),
            y=[value.value for value in found.values],
            mode="markers",
            name="each date",
            marker={"color": figures.ACCENT, "size": 9},
            text=calendar.labels,
            error_y={"type": "data", "array": half, "color": figures.MEASURED, "thickness": 2, "width": 5},
        )
    )
    if found.limit is not None:
        figure.add_hline(y=found.limit, line={"color": "#edae49", "dash": "dash"}, annotation_text="limit")
    if grown.change is not None:
        at = 0.5 * (calendar.times[grown.change.before] + calendar.times[grown.change.after])
        (place,) = _axis(found, np.array([at]))
        figure.add_vline(x=place, line={"color": figures.MEASURED, "dash": "dot"})
        figure.add_annotation(x=place, yref="paper", y=1.0, text=grown.change.kind, showarrow=False, xanchor="left")
    unit = f", {found.parameter.unit}" if found.parameter.unit else ""
    figure.update_xaxes(title_text=None if calendar.start else "run")
    figure.update_yaxes(title_text=f"{found.parameter.name}{unit}", automargin=True)
    figure.update_layout(**figures.LAYOUT, height=460)
    return figure


def _axis(found: Trend, times: np.ndarray[Any, Any]) -> list[Any]:
    """Times as the picture's axis has them."""
    start = found.calendar.start
    if start is None:
        return [float(time) for time in times]
    days = np.datetime64(start.replace(tzinfo=None)) + (times * 86400e6).astype("timedelta64[us]")
    return [str(day) for day in days]


def _unit(found: Trend, name: str) -> str:
    return found.model.parameters[found.model.names.index(name)].unit


def _interval(interval: Interval) -> dict[str, Any]:
    return {"value": interval.value, "ci95": [finite(interval.lower), finite(interval.upper)]}
