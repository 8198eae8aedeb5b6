"""Files of a comparison: compare.json, compare.md and compare.html, and the fit.json of each model."""

import math
from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from mrd_base.figures import ACCENT, LAYOUT, MEASURED, MODELLED, to_html
from mrd_base.json_file import finite_or_none, write_json
from mrd_base.quantities import per_cent
from mrd_identification import figures
from mrd_identification.compare import Comparison
from mrd_identification.fit_file import write_fit
from mrd_identification.report import diagnose_command, render
from mrd_identification.run_panels import closer_look

SCHEMA = "mrd-comparison/3"
COLUMNS = (
    "model", "free parameters", "NRMSE, held-out", "95 % interval", "difference to the best", "NRMSE, fitted", "time, s"
)  # fmt: skip


def to_json(comparison: Comparison) -> dict[str, Any]:
    """Return the content of compare.json."""
    best = comparison.best.fit
    return {
        "schema": SCHEMA,
        "runs": {
            "fit": [result.run.name for result in best.fitted],
            "held_out": [result.run.name for result in best.held_out],
            "held_out_by": comparison.held_out_by,
        },
        "intervals": {"resampled": comparison.resampled, "units": comparison.units},
        "simplest_on_par": comparison.simplest.name,
        "models": [
            {
                "name": entry.name,
                "model": entry.fit.model.id,
                "laws": entry.fit.model.laws,
                "effects": [effect.id for effect in entry.fit.model.effects],
                "free_parameters": entry.free,
                "nrmse": {
                    "value": finite_or_none(entry.nrmse),
                    "ci95": [finite_or_none(entry.lower), finite_or_none(entry.upper)],
                },
                "difference_to_best": {
                    "value": finite_or_none(entry.difference),
                    "ci95": [finite_or_none(entry.difference_lower), finite_or_none(entry.difference_upper)],
                },
                "on_par": entry.on_par,
                "nrmse_fit": entry.fit.pooled_fitted.nrmse,
                "rmse_N": finite_or_none(entry.fit.pooled_held_out.rmse) if entry.fit.pooled_held_out else 0.0,
                "elapsed_s": round(entry.fit.elapsed, 3),
                "fit": f"{fit_folder(entry.name)}/fit.json",
                "warnings": list(entry.fit.warnings),
            }
            for entry in comparison.entries
        ],
    }


def fit_folder(name: str) -> str:
    """Return the name of the folder of a model's fit."""
    return name.replace(":", "_")


def sentence(comparison: Comparison) -> str:
    """Describe the comparison in one sentence."""
    best, simplest = comparison.best, comparison.simplest
    text = f"{best.fit.model.title} ({best.name}) predicts the held-out force best: NRMSE {per_cent(best.nrmse)}"
    if math.isnan(best.lower):
        return (
            f"{text}. There are no intervals, because the held-out runs have only {comparison.units} independent segments; "
            "hold out more or longer runs."
        )
    text += f" ({_interval(best.lower, best.upper)})"
    if simplest is best:
        return f"{text} with {best.free} parameters; every simpler model is significantly worse."
    return (
        f"{text} with {best.free} parameters; {simplest.name} with {simplest.free} is not significantly "
        f"worse: {per_cent(simplest.nrmse)} ({_interval(simplest.lower, simplest.upper)})."
    )


def selections(comparison: Comparison) -> list[str]:
    """Return a sentence about the effects of each model for which they were selected."""
    return [
        f"{entry.name}: the selected effects are {', '.join(entry.fit.selection.effects) or 'none'}"
        for entry in comparison.entries
        if entry.fit.selection
    ]


def error_chart(comparison: Comparison) -> go.Figure:
    """Draw the held-out error of each model with its interval, and its error on the fitted runs; the best is on top."""
    entries = comparison.entries[::-1]
    names = [entry.name for entry in entries]
    figure = go.Figure(
        go.Scatter(
            x=[100.0 * entry.fit.pooled_fitted.nrmse for entry in entries],
            y=names,
            mode="markers",
            name="fitted runs",
            marker={"symbol": "circle-open", "color": MEASURED, "size": 10, "line": {"width": 2}},
        )
    )
    figure.add_scatter(
        x=[100.0 * entry.nrmse for entry in entries],
        y=names,
        mode="markers",
        name="held-out runs" if math.isnan(entries[0].lower) else "held-out runs, 95 % interval",
        marker={"color": [ACCENT if entry.on_par else MODELLED for entry in entries], "size": 10},
        error_x=figures.error_bars(
            *zip(*((100.0 * (e.nrmse - e.lower), 100.0 * (e.upper - e.nrmse)) for e in entries), strict=True)
        ),
    )
    figure.update_xaxes(title_text="NRMSE of the force, %", rangemode="tozero")
    figure.update_yaxes(automargin=True)
    figure.update_layout(**LAYOUT, height=160 + 34 * len(entries))
    return figure


MOST_SHOWN = 4
"""Models whose force is shown over time, the best ones."""


def write_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write compare.json, compare.md, compare.html and the fit.json of each model; return the path of the page."""
    folder = Path(folder)
    for entry in comparison.entries:
        (folder / fit_folder(entry.name)).mkdir(exist_ok=True)
        write_fit(entry.fit, folder / fit_folder(entry.name))
    write_json(to_json(comparison), "mrd_identification", "compare", folder)
    (folder / "compare.md").write_text(markdown(comparison), encoding="utf-8")
    best = comparison.best.fit
    return render(
        "compare",
        folder,
        runs=[result.run for result in (*best.fitted, *best.held_out)],
        command=diagnose_command(comparison.simplest.fit),
        title=f"{len(comparison.entries)} damper models on {len(best.held_out)} held-out runs",
        sentence=sentence(comparison),
        comparison=comparison,
        columns=COLUMNS,
        selections=selections(comparison),
        rows=list(zip(comparison.entries, ranking(comparison), strict=True)),
        error_chart=to_html(error_chart(comparison)),
        loops=to_html(figures.loops(best.held_out)),
        closer=closer_look(
            best.held_out[0].run,
            {
                entry.name: entry.fit.held_out[0].modelled
                for entry in comparison.entries[:MOST_SHOWN]
                if math.isfinite(entry.nrmse)
            },
        ),
    )


def ranking(comparison: Comparison) -> list[tuple[str, ...]]:
    """Return the cells of the ranking as text, a row for each model with the columns `COLUMNS`."""
    rows: list[tuple[str, ...]] = []
    for entry in comparison.entries:
        difference = "on par" if entry.on_par else _interval(entry.difference_lower, entry.difference_upper)
        rows.append(
            (
                entry.name,
                str(entry.free),
                entry.error,
                _interval(entry.lower, entry.upper),
                "the best" if entry is comparison.best else difference,
                per_cent(entry.fit.pooled_fitted.nrmse),
                f"{entry.fit.elapsed:.0f}",
            )
        )
    return rows


def _interval(lower: float, upper: float) -> str:
    """Return an interval as text; "none" where the runs tell of none."""
    return "none" if math.isnan(lower) else f"{per_cent(lower).removesuffix(' %')} to {per_cent(upper)}"


def markdown(comparison: Comparison) -> str:
    """Return the ranking as a table in Markdown."""
    rows = [(f"`{name}`", *cells) for name, *cells in ranking(comparison)]
    table = "".join(f"| {' | '.join(row)} |\n" for row in (COLUMNS, ["---"] * len(COLUMNS), *rows))
    return table + "".join(f"\n{text}.\n" for text in selections(comparison))
