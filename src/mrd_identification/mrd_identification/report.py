"""fit.html: a fit for a person to look at."""

from pathlib import Path
from typing import Any

import jinja2
from plotly.offline import get_plotlyjs

from mrd_identification import figures
from mrd_identification.identify import Fit

_HOW = {"runs": "held-out runs", "leave-one-run-out": "each run held out in turn", "none": "the fitted run itself"}


def sentence(fit: Fit) -> str:
    """The fit in one sentence."""
    judge = fit.pooled_held_out or fit.pooled_fitted
    fitted = "on the run it was fitted to" if len(fit.fitted) == 1 else "on the runs it was fitted to"
    where = "on runs it has not seen" if fit.pooled_held_out else fitted
    return (
        f"The model explains {judge.vaf:.1f} % of the force's variance {where}; "
        f"its error is {judge.rmse:.1f} N rms, {100 * judge.nrmse:.1f} % of the force's standard deviation."
    )


def write_report(fit: Fit, folder: str | Path) -> Path:
    """Write fit.html, which needs no network, into ``folder`` and return its path."""
    judged = fit.held_out or fit.fitted
    metrics = fit.pooled_held_out or fit.pooled_fitted
    worst = max(judged, key=lambda result: result.metrics.nrmse)
    return render(
        "fit",
        folder,
        title=f"{fit.model.title} model of {len(fit.fitted)} run{'s' if len(fit.fitted) > 1 else ''}",
        sentence=sentence(fit),
        loops=figures.html(figures.loops(judged)),
        over_time=figures.html(figures.force_over_time(worst)),
        front=figures.html(figures.pareto_front(fit)),
        intervals=figures.html(figures.parameters(fit)),
        correlation=figures.html(figures.correlation(fit)) if len(fit.correlation) > 1 else "",
        headline=[
            (f"NRMSE, {_HOW[fit.held_out_by]}", f"{metrics.nrmse:.4f}"),
            ("NRMSE, fitted", f"{fit.pooled_fitted.nrmse:.4f}"),
            ("rmse", f"{metrics.rmse:.2f} N"),
            ("variance accounted for", f"{metrics.vaf:.2f} %"),
            ("e2", f"{metrics.e2:.4f} N"),
            ("einf", f"{metrics.einf:.4f} N"),
            ("samples", f"{metrics.samples}"),
        ],
        fit=fit,
        rows=[("fitted", r) for r in fit.fitted] + [("held out", r) for r in fit.held_out],
    )


def render(name: str, folder: str | Path, package: str = "mrd_identification", /, **content: Any) -> Path:
    """Write ``name``.html from the template of a package into ``folder``; the file is whole or not there."""
    loaders = [jinja2.PackageLoader(each) for each in dict.fromkeys((package, "mrd_identification"))]
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(loaders), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True
    )
    environment.filters["figures"] = four_figures
    page = environment.get_template(f"{name}.html.j2").render(plotly=get_plotlyjs(), **content)
    path = Path(folder) / f"{name}.html"
    partial = path.with_suffix(".part")
    partial.write_text(page, encoding="utf-8")
    return partial.replace(path)


def four_figures(value: float) -> str:
    """Number with four significant figures, as a table wants it."""
    return f"{value:.4g}"
