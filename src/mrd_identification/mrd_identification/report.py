"""The page fit.html, and the rendering of pages from templates."""

import datetime
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
from plotly.offline import get_plotlyjs

from mrd_base.tool import command
from mrd_base.version import VERSION
from mrd_identification import figures
from mrd_identification.effect_selection import LEAST_IMPROVEMENT
from mrd_identification.fit import Fit
from mrd_runs import Run

MOST_RUNS = 4
"""Runs that fit.html draws over time, those with the largest error; more would make the page too large."""

_PREFIXED_UNITS = ("m", "s", "N", "A", "V", "J", "W", "Pa")
_EVALUATED_ON = {"runs": "held-out runs", "leave-one-run-out": "each run held out in turn", "none": "fitted runs"}


def write_report(fit: Fit, folder: str | Path) -> Path:
    """Write fit.html, a page that needs no network, into ``folder`` and return its path."""
    results, metrics = fit.held_out or fit.fitted, fit.pooled
    by_error = sorted(results, key=lambda result: -result.metrics.nrmse)
    return render(
        "fit",
        folder,
        runs=[result.run for result in (*fit.fitted, *fit.held_out)],
        title=f"{fit.model.title} model of {len(fit.fitted)} run{'s' if len(fit.fitted) > 1 else ''}",
        sentence=fit.sentence,
        loops=figures.to_html(figures.loops(results)),
        over_time=[
            (f"{result.run.name}, NRMSE {result.metrics.nrmse:.4f}", figures.to_html(figures.force_over_time(result)))
            for result in by_error[:MOST_RUNS]
        ],
        omitted=len(by_error[MOST_RUNS:]),
        command=f"{command('mrd_diagnosis', 'diagnose')} {_sources(fit)} --model {fit.model.id} --output DIR",
        residuals=figures.to_html(figures.residuals(results)),
        front=figures.to_html(figures.pareto_front(fit), figures.HALF),
        intervals=figures.to_html(figures.parameters(fit), figures.HALF),
        correlation=figures.to_html(figures.correlation(fit), figures.HALF) if len(fit.correlation) > 1 else "",
        headline=[
            (f"NRMSE, {_EVALUATED_ON[fit.held_out_by]}", f"{metrics.nrmse:.4f}"),
            ("NRMSE, fitted", f"{fit.pooled_fitted.nrmse:.4f}"),
            ("rms error", f"{metrics.rmse:.2f} N"),
            ("variance accounted for", f"{metrics.vaf:.2f} %"),
            ("e2", f"{metrics.e2:.4f} N"),
            ("einf", f"{metrics.einf:.4f} N"),
            ("samples", f"{metrics.samples}"),
        ],
        fit=fit,
        steps=fit.selection.steps if fit.selection else [],
        least_improvement=LEAST_IMPROVEMENT,
        rows=[("fitted", r) for r in fit.fitted] + [("held out", r) for r in fit.held_out],
    )


def _sources(fit: Fit) -> str:
    """Return the fitted runs as arguments of a tool."""
    files = [str(result.run.info.get("source", "")) for result in fit.fitted]
    return shlex.join(files) if all(files) else "RUN..."


def render(
    name: str,
    folder: str | Path,
    package: str = "mrd_identification",
    /,
    *,
    runs: Sequence[Run] = (),
    interactive: bool = False,
    **content: Any,
) -> Path:
    """Write ``name``.html from the template of a package into ``folder`` and return its path.

    The page ends with the version of the program, the date, and the files of the ``runs`` that it is about. An
    ``interactive`` page includes Plotly, which takes 4.7 MB. The file is complete or absent, even when the process is
    interrupted.
    """
    loaders = [jinja2.PackageLoader(name) for name in dict.fromkeys((package, "mrd_identification"))]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters["figures"] = four_figures
    environment.filters["quantity"] = quantity
    page = environment.get_template(f"{name}.html.j2").render(
        plotly=get_plotlyjs() if interactive else "",
        version=VERSION,
        written=f"{datetime.datetime.now():%Y-%m-%d %H:%M}",
        sources=list(dict.fromkeys(str(run.info["source"]) for run in runs if run.info.get("source"))),
        **content,
    )
    path = Path(folder) / f"{name}.html"
    partial = path.with_suffix(".part")
    partial.write_text(page, encoding="utf-8")
    return partial.replace(path)


def four_figures(value: float) -> str:
    """Format a number with four significant figures."""
    return f"{value:.4g}"


def quantity(value: float, unit: str) -> str:
    """Format a quantity in SI with four significant figures, and with a prefix where it is small or large: 125 µm."""
    first = unit.partition("/")[0].partition(" ")[0]
    if first not in _PREFIXED_UNITS or value == 0.0 or 0.1 <= abs(value) < 1e4:
        return f"{four_figures(value)} {unit}".rstrip()
    # Matplotlib is slow to import, and only pages need it.
    from matplotlib.ticker import EngFormatter

    return str(EngFormatter(unit=unit)(float(four_figures(value))))
