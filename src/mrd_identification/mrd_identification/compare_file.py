"""A comparison as files: compare.json, compare.md and compare.html, and the fit.json of each model."""

from pathlib import Path
from typing import Any

import plotly.graph_objects as go

from mrd_identification import figures
from mrd_identification.compare import Comparison
from mrd_identification.fit_file import write_fit
from mrd_identification.json_file import finite, write_json
from mrd_identification.report import render

SCHEMA = "mrd-comparison/1"


def to_json(comparison: Comparison) -> dict[str, Any]:
    """Content of compare.json."""
    first = comparison.entries[0].fit
    return {
        "schema": SCHEMA,
        "runs": {
            "fit": [result.run.name for result in first.fitted],
            "held_out": [result.run.name for result in first.held_out],
            "held_out_by": comparison.judged_by,
        },
        "intervals": {"resampled": comparison.resampled, "units": comparison.units},
        "simplest_on_par": comparison.simplest.name,
        "models": [
            {
                "name": entry.name,
                "model": entry.fit.model.id,
                "laws": entry.fit.model.laws,
                "free_parameters": entry.free,
                "nrmse": {"value": entry.nrmse, "ci95": [finite(entry.lower), finite(entry.upper)]},
                "behind_best": {"value": entry.behind, "ci95": [finite(entry.behind_lower), finite(entry.behind_upper)]},
                "on_par": entry.on_par,
                "nrmse_fit": entry.fit.pooled_fitted.nrmse,
                "rmse_N": entry.fit.pooled_held_out.rmse if entry.fit.pooled_held_out else 0.0,
                "elapsed_s": round(entry.fit.elapsed, 3),
                "fit": f"{folder_of(entry.name)}/fit.json",
                "warnings": list(entry.fit.warnings),
            }
            for entry in comparison.entries
        ],
    }


def folder_of(name: str) -> str:
    """Name of the folder of a model's fit."""
    return name.replace(":", "_")


def sentence(comparison: Comparison) -> str:
    """The comparison in one sentence."""
    best, simplest = comparison.entries[0], comparison.simplest
    text = (
        f"{best.fit.model.title} ({best.name}) predicts unseen force best: NRMSE {best.nrmse:.4f} "
        f"[{best.lower:.4f}, {best.upper:.4f}]"
    )
    if best.lower != best.lower:
        return (
            f"{best.fit.model.title} ({best.name}) predicts unseen force best: NRMSE {best.nrmse:.4f}. "
            f"No intervals: {comparison.units} independent stretches are too few; judge by more or longer runs."
        )
    if simplest is best:
        return f"{text} with {best.free} parameters; no simpler model is on par with it."
    return (
        f"{text} with {best.free} parameters; {simplest.name} with {simplest.free} is on par, at {simplest.nrmse:.4f} "
        f"[{simplest.lower:.4f}, {simplest.upper:.4f}]."
    )


def ladder(comparison: Comparison) -> go.Figure:
    """Held-out error of each model with its interval, best on top, and the fitted error beside it."""
    entries = comparison.entries[::-1]
    names = [entry.name for entry in entries]
    held = [entry.nrmse for entry in entries]
    figure = go.Figure(
        go.Scatter(
            x=[entry.fit.pooled_fitted.nrmse for entry in entries],
            y=names,
            mode="markers",
            name="fitted runs",
            marker={"symbol": "circle-open", "color": figures.MEASURED, "size": 10, "line": {"width": 2}},
        )
    )
    figure.add_trace(
        go.Scatter(
            x=held,
            y=names,
            mode="markers",
            name="held-out runs, 95 % interval",
            marker={"color": [figures.ACCENT if entry.on_par else figures.MODELLED for entry in entries], "size": 10},
            error_x={
                "type": "data",
                "symmetric": False,
                "color": figures.MEASURED,
                "thickness": 2,
                "width": 5,
                "array": [entry.upper - entry.nrmse for entry in entries],
                "arrayminus": [entry.nrmse - entry.lower for entry in entries],
            },
        )
    )
    figure.update_xaxes(title_text="NRMSE: rms error / standard deviation of the force", rangemode="tozero")
    figure.update_yaxes(automargin=True)
    figure.update_layout(**figures.LAYOUT, height=160 + 34 * len(entries))
    return figure


def write_comparison(comparison: Comparison, folder: str | Path) -> Path:
    """Write compare.json, compare.md, compare.html and each model's fit.json into ``folder``; returns the page's path."""
    folder = Path(folder)
    for entry in comparison.entries:
        (folder / folder_of(entry.name)).mkdir(exist_ok=True)
        write_fit(entry.fit, folder / folder_of(entry.name))
    write_json(to_json(comparison), "mrd_identification", "compare", folder)
    (folder / "compare.md").write_text(markdown(comparison), encoding="utf-8")
    best = comparison.entries[0].fit
    return render(
        "compare",
        folder,
        title=f"{len(comparison.entries)} damper models on {len(best.held_out)} unseen runs",
        sentence=sentence(comparison),
        comparison=comparison,
        ladder=figures.html(ladder(comparison)),
        loops=figures.html(figures.loops(best.held_out)),
    )


def markdown(comparison: Comparison) -> str:
    """The ranking as a table for a page of text."""
    lines = [
        "| model | free parameters | NRMSE, unseen | 95 % interval | behind the best | NRMSE, fitted | time, s |",
        "|---|---|---|---|---|---|---|",
    ]
    for entry in comparison.entries:
        behind = "on par" if entry.on_par else f"{entry.behind_lower:.4f} … {entry.behind_upper:.4f}"
        cells = (
            f"`{entry.name}`",
            entry.free,
            f"{entry.nrmse:.4f}",
            f"{entry.lower:.4f} … {entry.upper:.4f}",
            "the best" if entry is comparison.entries[0] else behind,
            f"{entry.fit.pooled_fitted.nrmse:.4f}",
            f"{entry.fit.elapsed:.0f}",
        )
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"
