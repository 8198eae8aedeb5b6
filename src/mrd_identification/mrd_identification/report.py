"""The page fit.html, and pages about runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mrd_base import page
from mrd_base.figures import HALF, MOST_POINTS, to_html
from mrd_base.quantities import per_cent
from mrd_base.tool import command
from mrd_identification import figures
from mrd_identification.effect_selection import LEAST_IMPROVEMENT
from mrd_identification.fit import Fit
from mrd_identification.low_pass import force_filter_arguments
from mrd_identification.run_panels import closer_look
from mrd_runs import Run
from mrd_runs.read import run_arguments
from mrd_sim.own import model_arguments

MOST_RUNS = 16
"""Runs that fit.html draws over time, those with the largest error; more would make the page too large."""
POINTS = 6000
"""Points of all these drawings together; the lines of more runs are coarser."""

_EVALUATED_ON = {"runs": "held-out runs", "leave-one-run-out": "each run held out in turn", "none": "fitted runs"}


def write_report(fit: Fit, folder: str | Path) -> Path:
    """Write fit.html, a page that needs no network, into ``folder`` and return its path."""
    results, metrics = fit.held_out or fit.fitted, fit.pooled
    evaluated, used_as = _EVALUATED_ON[fit.held_out_by], "held out" if fit.held_out else "fitted"
    has_intervals = figures.has_intervals(fit)
    by_error = sorted(results, key=lambda result: -result.metrics.nrmse)
    points = min(POINTS // min(len(results), MOST_RUNS), MOST_POINTS)
    return render(
        "fit",
        folder,
        runs=[result.run for result in (*fit.fitted, *fit.held_out)],
        title=f"{fit.model.title} model of {len(fit.fitted)} run{'s' if len(fit.fitted) > 1 else ''}",
        sentence=fit.sentence,
        loops=to_html(figures.loops(results)),
        over_time=[
            (
                f"{result.run.name}, {used_as}, NRMSE {per_cent(result.metrics.nrmse)}",
                to_html(figures.force_over_time(result, points)),
            )
            for result in by_error[:MOST_RUNS]
        ],
        omitted=len(by_error[MOST_RUNS:]),
        closer=closer_look(by_error[0].run, {fit.model.id: by_error[0].modelled}),
        command=diagnose_command(fit),
        residuals=to_html(figures.residuals(results)),
        front=to_html(figures.pareto_front(fit), HALF),
        intervals=to_html(figures.parameters(fit), HALF) if has_intervals else "",
        correlation=to_html(figures.correlation(fit), HALF) if has_intervals and len(fit.correlation) > 1 else "",
        headline=[
            (f"NRMSE, {evaluated}", per_cent(metrics.nrmse)),
            ("NRMSE, fitted runs", per_cent(fit.pooled_fitted.nrmse)),
            (f"rms error, {evaluated}", f"{metrics.rmse:.2f} N"),
            (f"variance accounted for, {evaluated}", per_cent(0.01 * metrics.vaf)),
            (f"e2, {evaluated}", f"{metrics.e2:.4f} N"),
            (f"einf, {evaluated}", f"{metrics.einf:.4f} N"),
            (f"samples, {evaluated}", f"{metrics.samples}"),
        ],
        fit=fit,
        steps=fit.selection.steps if fit.selection else [],
        least_improvement=LEAST_IMPROVEMENT,
        rows=[("fitted", r) for r in fit.fitted] + [("held out", r) for r in fit.held_out],
    )


def diagnose_command(fit: Fit) -> str:
    """Return the command that looks for the cause of the errors of a fit."""
    runs = _all_run_arguments(fit)
    model = model_arguments(fit.model.id, fit.model.laws)
    return f"{command('mrd_diagnosis', 'diagnose')} {runs} {model} --output DIR"


def next_command(fit: Fit) -> str:
    """Return the command that leads on: to other models where parameters are on bounds, else to what is still missing."""
    if not any(estimate.on_bound for estimate in fit.estimates):
        return diagnose_command(fit)
    return f"{command('mrd_identification', 'compare')} {_all_run_arguments(fit)} --output DIR"


def _all_run_arguments(fit: Fit) -> str:
    """Return the fitted and the held-out runs of a fit as arguments, with the filters that their force has passed."""
    fitted = [result.run for result in fit.fitted]
    held_out = [result.run for result in fit.held_out] if fit.held_out_by == "runs" else []
    unseen = f" --held-out {run_arguments(held_out)}" if held_out else ""
    return f"{run_arguments(fitted)}{unseen}{force_filter_arguments([*fitted, *held_out])}"


def render(
    name: str,
    folder: str | Path,
    package: str = "mrd_identification",
    /,
    *,
    runs: Sequence[Run] = (),
    files: Sequence[str] = (),
    **content: Any,
) -> Path:
    """Write ``name``.html, a page about ``runs`` and other ``files``, into ``folder``; see `mrd_base.page.render`."""
    sources = [str(run.info["source"]) for run in runs if run.info.get("source")]
    return page.render(name, Path(folder) / f"{name}.html", package, files=[*sources, *files], **content)
