"""A trend as files: trend.json and trend.html."""

from pathlib import Path
from typing import Any

from mrd_base.figures import to_html
from mrd_base.json_file import finite_or_none, write_json
from mrd_base.tool import command
from mrd_diagnosis.diagnosis import Interval
from mrd_diagnosis.trend.figure import trend_figure
from mrd_diagnosis.trend.trend import Trend
from mrd_diagnosis.trend.trend_line import CHANGE_ALPHA
from mrd_identification.report import render
from mrd_identification.versions import versions
from mrd_runs.read import run_arguments
from mrd_runs.summary import run_json
from mrd_sim.own import model_arguments

SCHEMA = "mrd-trend/2"


def to_json(trend: Trend) -> dict[str, Any]:
    """Return the content of trend.json; numbers that are not finite become null."""
    calendar, fit, line = trend.calendar, trend.fit, trend.line
    model, parameter = fit.model, fit.parameter
    slope_unit = f"{parameter.unit or '1'}/{calendar.unit}"
    change = None
    if line.change is not None and line.change_size is not None:
        change = {
            "kind": line.change.kind,
            "between": [calendar.labels[line.change.before], calendar.labels[line.change.after]],
            "size": {**_interval(line.change_size), "unit": parameter.unit if line.change.kind == "step" else slope_unit},
        }
    limit = None
    if trend.limit is not None:
        crossing = trend.crossing
        limit = {
            "value": trend.limit,
            "crossing": crossing and {**_interval(crossing), "label": calendar.label(crossing.value)},
        }
    units = _units(trend)
    return {
        "schema": SCHEMA,
        "sentence": trend.sentence,
        "model": model.id,
        "laws": model.laws,
        "effects": [effect.id for effect in model.effects],
        "parameter": {"name": parameter.name, "unit": parameter.unit, "meaning": parameter.meaning},
        "date_source": calendar.source,
        "time_unit": calendar.unit,
        "dates": [
            {"label": label, "time": float(time), "runs": [run_json(run) for run in runs], **_interval(value)}
            for label, time, runs, value in zip(
                calendar.labels, calendar.times, calendar.by_date(trend.runs), trend.values, strict=True
            )
        ],
        "slope": {**_interval(line.slope), "unit": slope_unit},
        "scatter": line.scatter,
        "change_point": {"p_value": finite_or_none(line.p_change), "detected": change},
        "limit": limit,
        "common_parameters": {name: {"value": value, "unit": units[name]} for name, value in fit.common_parameters.items()},
        "run_offsets": fit.run_offsets,
        "nrmse": fit.nrmse,
        "seed": trend.seed,
        "elapsed_s": round(trend.elapsed, 3),
        "notes": list(trend.notes),
        "versions": versions(),
    }


def write_trend(trend: Trend, folder: str | Path) -> Path:
    """Write trend.json and trend.html, which needs no network, into ``folder``; return the path of the page."""
    write_json(to_json(trend), "mrd_diagnosis", "trend", folder)
    return render(
        "trend",
        folder,
        "mrd_diagnosis",
        runs=trend.runs,
        title=f"{trend.fit.parameter.name} over {len(trend.calendar.times)} dates",
        sentence=trend.sentence,
        figure=to_html(trend_figure(trend)),
        trend=trend,
        units=_units(trend),
        change_alpha=CHANGE_ALPHA,
        command=change_command(trend),
        runs_by_date=[", ".join(run.name for run in runs) for runs in trend.calendar.by_date(trend.runs)],
    )


def change_command(trend: Trend) -> str:
    """Return the command that explains what has changed from the first dates to the last ones; empty where either has a
    single run, which does not show how runs scatter.
    """
    before, after = trend.calendar.before_and_after(trend.runs)
    if min(len(before), len(after)) < 2:
        return ""
    runs = f"{run_arguments(after)} --reference {run_arguments(before)}"
    model = model_arguments(trend.fit.model.id, trend.fit.model.laws)
    return f"{command('mrd_diagnosis', 'diagnose')} {runs} {model} --output DIR"


def _units(trend: Trend) -> dict[str, str]:
    """Return the unit of every parameter by its name."""
    return {parameter.name: parameter.unit for parameter in trend.fit.model.parameters}


def _interval(interval: Interval) -> dict[str, Any]:
    return {"value": interval.value, "ci95": [finite_or_none(interval.lower), finite_or_none(interval.upper)]}
