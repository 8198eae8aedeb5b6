"""Figures of a score."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from mrd_base.figures import ACCENT, LAYOUT, MEASURED, MODELLED
from mrd_trials.scoring.classes import Stratum
from mrd_trials.scoring.methods import MethodRates
from mrd_trials.scoring.rates import Calibration, Distribution, Rate
from mrd_trials.scoring.verdict_counts import Counts

_RIGHT_VERDICTS = {"null": "no_gap", "absent": "unknown_effect"}
_WRONG_SCALE = [[0.0, "#f5f7fa"], [0.001, "#f7dfb0"], [0.5, "#edae49"], [1.0, MODELLED]]
_RIGHT_SCALE = [[0.0, "#f5f7fa"], [0.001, "#d3e9e6"], [1.0, ACCENT]]


def naming(strata: Sequence[Stratum]) -> go.Figure:
    """Show how often the right class is named, with intervals."""
    shown = strata[::-1]
    names = [f"{stratum.name} <i>({stratum.right.total})</i>" for stratum in shown]
    figure = _share_layout(
        go.Figure(_points([stratum.right for stratum in shown], names, "class named", ACCENT)), len(shown)
    )
    figure.update_layout(showlegend=False)
    return figure


def methods(rows: Sequence[MethodRates]) -> go.Figure:
    """Show how often each method puts the cause first, and its false alarms on null plants."""
    shown = rows[::-1]
    names = [row.method for row in shown]
    figure = go.Figure(
        [
            _points([row.first for row in shown], names, "cause first", ACCENT),
            _points([row.false_alarms for row in shown], names, "false alarms", MODELLED),
        ]
    )
    return _share_layout(figure, len(shown))


def coverage(rates: Mapping[str, Rate]) -> go.Figure:
    """Show how often intervals hold the true sizes, by effect; the shaded range is the goal."""
    names = [f"{effect} <i>({rate.total})</i>" for effect, rate in rates.items()][::-1]
    figure = _share_layout(go.Figure(_points(list(rates.values())[::-1], names, "covered", ACCENT)), len(names))
    figure.add_vrect(x0=0.9, x1=0.99, fillcolor=ACCENT, opacity=0.12, line_width=0)
    figure.update_layout(showlegend=False)
    return figure


def reliability(calibration: Calibration) -> go.Figure:
    """Show how often claims were right, over the probability that they were given."""
    rates = [entry.right for entry in calibration.curve]
    figure = go.Figure(
        [
            go.Scatter(x=[0, 1], y=[0, 1], mode="lines", line={"color": MEASURED, "dash": "dash"}, name="ideal"),
            go.Scatter(
                x=[entry.mean for entry in calibration.curve],
                y=[rate.value for rate in rates],
                mode="lines+markers",
                name="named effects",
                line={"color": ACCENT, "width": 1},
                marker={"size": 8, "color": ACCENT},
                error_y=_error_bars(rates, ACCENT),
                text=[f"{rate.hits} of {rate.total}" for rate in rates],
                hovertemplate="%{x:.2f}: %{y:.2f}, %{text}",
            ),
        ]
    )
    figure.update_xaxes(title_text="probability of the claim", range=[-0.02, 1.02])
    figure.update_yaxes(title_text="share of right claims", range=[-0.02, 1.05])
    figure.update_layout(**LAYOUT, height=420)
    figure.update_layout(margin_t=50)
    return figure


def distributions(named: Mapping[str, Distribution]) -> go.Figure:
    """Show values over plants: median, quartiles, and every plant."""
    figure = go.Figure(
        [
            go.Box(
                x=np.clip(distribution.values, -0.1, 1.5),
                name=f"{name}<br><i>({len(distribution.values)})</i>",
                boxpoints="all",
                jitter=0.5,
                pointpos=0,
                marker={"color": ACCENT, "size": 4, "opacity": 0.5},
                fillcolor="rgba(0,0,0,0)",
                line={"color": "#52606d", "width": 1.4},
            )
            for name, distribution in reversed(list(named.items()))
        ]
    )
    figure.update_xaxes(range=[-0.12, 1.52])
    figure.update_yaxes(automargin=True)
    figure.update_layout(**LAYOUT, height=90 + 90 * len(named), showlegend=False)
    figure.update_layout(margin={"t": 10, "l": 10, "r": 14, "b": 40})
    return figure


def confusion(counts: Counts) -> go.Figure:
    """Show the ground truth over what was named; right names have a colour of their own."""
    table = np.array(counts.counts, dtype=float)
    truths = [row.partition(",")[0] for row in counts.rows]
    right = np.array([[_RIGHT_VERDICTS.get(truth, truth) == column for column in counts.columns] for truth in truths])
    figure = go.Figure()
    for mask, scale in ((~right, _WRONG_SCALE), (right, _RIGHT_SCALE)):
        cells = np.where(mask & (table > 0), table, np.nan)
        figure.add_trace(
            go.Heatmap(
                z=cells,
                x=counts.columns,
                y=counts.rows,
                colorscale=scale,
                zmin=0,
                zmax=max(float(table.max()), 1.0),
                showscale=False,
                xgap=1,
                ygap=1,
                hoverongaps=False,
                hovertemplate="%{y} named %{x}: %{z}<extra></extra>",
                text=np.where(np.isnan(cells), "", table.astype(int).astype(str)),
                texttemplate="%{text}",
            )
        )
    figure.update_xaxes(tickangle=-60, side="top", automargin=True, tickmode="array", tickvals=counts.columns)
    figure.update_yaxes(autorange="reversed", automargin=True, tickmode="array", tickvals=counts.rows)
    figure.update_layout(**LAYOUT, height=190 + 21 * len(counts.rows))
    figure.update_layout(margin={"t": 10, "l": 10, "r": 10, "b": 10})
    return figure


def _points(rates: Sequence[Rate], names: Sequence[str], name: str, colour: str) -> go.Scatter:
    return go.Scatter(
        x=[rate.value if rate.total else None for rate in rates],
        y=list(names),
        mode="markers",
        name=name,
        marker={"size": 9, "color": colour},
        error_x=_error_bars(rates, colour),
        text=[f"{rate.hits} of {rate.total}" for rate in rates],
        hovertemplate="%{x:.0%}, %{text}",
    )


def _error_bars(rates: Sequence[Rate], colour: str) -> dict[str, object]:
    """Return error bars over the 95 % intervals."""
    known = [rate if rate.total else None for rate in rates]
    return {
        "type": "data",
        "symmetric": False,
        "color": colour,
        "thickness": 1.4,
        "width": 4,
        "array": [rate.upper - rate.value if rate else None for rate in known],
        "arrayminus": [rate.value - rate.lower if rate else None for rate in known],
    }


def _share_layout(figure: go.Figure, rows: int) -> go.Figure:
    """Lay out a chart of shares by row."""
    figure.update_xaxes(tickformat=".0%", range=[-0.02, 1.04], nticks=6)
    figure.update_yaxes(automargin=True, ticksuffix=" ", type="category")
    figure.update_layout(**LAYOUT, height=100 + 25 * rows)
    figure.update_layout(margin={"t": 34, "l": 10, "r": 14, "b": 40})
    return figure
