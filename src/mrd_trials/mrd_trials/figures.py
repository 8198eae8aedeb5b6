"""Pictures of a score."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from mrd_identification.figures import ACCENT, LAYOUT, MEASURED, MODELLED
from mrd_trials.rates import Calibration, Rate, Spread
from mrd_trials.score import Baseline, Counts, Ranks

_WELL_SAID = {"null": "no_gap", "absent": "unknown_effect"}
_HEAT = [[0.0, "#f5f7fa"], [0.001, "#f7dfb0"], [0.5, "#edae49"], [1.0, MODELLED]]
_RIGHT = [[0.0, "#f5f7fa"], [0.001, "#d3e9e6"], [1.0, ACCENT]]


def which(ranks: Sequence[Ranks]) -> go.Figure:
    """How often a cause's group is named, with intervals, and how often the cause is first of the ranking."""
    shown = [one for one in ranks if one.named.of][::-1]
    names = [f"{one.value} <i>({one.named.of})</i>" for one in shown]
    figure = go.Figure(
        [
            go.Scatter(
                x=[one.ranked.value for one in shown],
                y=names,
                mode="markers",
                name="first of the ranking",
                marker={"symbol": "line-ns", "size": 13, "line": {"width": 2.5, "color": MEASURED}},
            ),
            _points([one.named_group for one in shown], names, "one of the group named", ACCENT),
        ]
    )
    return _shares(figure, len(shown))


def baselines(rows: Sequence[Baseline]) -> go.Figure:
    """Each method's group top-1, and its alarms where there is no effect."""
    shown = rows[::-1]
    names = [row.name for row in shown]
    figure = go.Figure(
        [
            _points([row.group for row in shown], names, "group top-1", ACCENT),
            _points([row.alarms for row in shown], names, "null alarms", MODELLED),
        ]
    )
    return _shares(figure, len(shown))


def coverage(rates: dict[str, Rate]) -> go.Figure:
    """Coverage of the sizes' intervals by effect; between the lines is wanted."""
    names = [f"{effect} <i>({rate.of})</i>" for effect, rate in rates.items()][::-1]
    figure = _shares(go.Figure(_points(list(rates.values())[::-1], names, "covered", ACCENT)), len(names))
    figure.add_vrect(x0=0.9, x1=0.99, fillcolor=ACCENT, opacity=0.12, line_width=0)
    figure.update_layout(showlegend=False)
    return figure


def reliability(named: Calibration, first: Calibration) -> go.Figure:
    """How often what was given a probability was so, against that probability."""
    figure = go.Figure(
        go.Scatter(x=[0, 1], y=[0, 1], mode="lines", line={"color": MEASURED, "dash": "dash"}, name="as it should be")
    )
    for of, name, colour in ((first, "with first candidates", MODELLED), (named, "causes named", ACCENT)):
        rates = [one.right for one in of.curve]
        figure.add_trace(
            go.Scatter(
                x=[one.mean for one in of.curve],
                y=[rate.value for rate in rates],
                mode="lines+markers",
                name=name,
                line={"color": colour, "width": 1},
                marker={"size": 8, "color": colour},
                error_y=_ends(rates, colour),
                text=[f"{rate.hits} of {rate.of}" for rate in rates],
                hovertemplate="%{x:.2f}: %{y:.2f}, %{text}",
            )
        )
    figure.update_xaxes(title_text="probability given", range=[-0.02, 1.02])
    figure.update_yaxes(title_text="share that was so", range=[-0.02, 1.05])
    figure.update_layout(**LAYOUT, height=420)
    figure.update_layout(margin_t=50)
    return figure


def spreads(named: dict[str, Spread]) -> go.Figure:
    """Figures over plants: median, quartiles, and every plant."""
    figure = go.Figure(
        [
            go.Box(
                x=np.clip(spread.values, -0.1, 1.5),
                name=f"{name}<br><i>({len(spread.values)})</i>",
                boxpoints="all",
                jitter=0.5,
                pointpos=0,
                marker={"color": ACCENT, "size": 4, "opacity": 0.5},
                fillcolor="rgba(0,0,0,0)",
                line={"color": "#52606d", "width": 1.4},
            )
            for name, spread in reversed(named.items())
        ]
    )
    figure.update_xaxes(range=[-0.12, 1.52])
    figure.update_yaxes(automargin=True)
    figure.update_layout(**LAYOUT, height=90 + 90 * len(named), showlegend=False)
    figure.update_layout(margin={"t": 10, "l": 10, "r": 14, "b": 40})
    return figure


def confusion(counts: Counts) -> go.Figure:
    """Truth by what was named; what was right in another colour."""
    table = np.array(counts.counts, dtype=float)
    truths = [row.partition(",")[0] for row in counts.rows]
    right = np.array([[_WELL_SAID.get(truth, truth) == column for column in counts.columns] for truth in truths])
    figure = go.Figure()
    for mask, scale in ((~right, _HEAT), (right, _RIGHT)):
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
        x=[rate.value if rate.of else None for rate in rates],
        y=list(names),
        mode="markers",
        name=name,
        marker={"size": 9, "color": colour},
        error_x=_ends(rates, colour),
        text=[f"{rate.hits} of {rate.of}" for rate in rates],
        hovertemplate="%{x:.0%}, %{text}",
    )


def _ends(rates: Sequence[Rate], colour: str) -> dict[str, object]:
    """Error bars over the 95 % intervals."""
    known = [rate if rate.of else None for rate in rates]
    return {
        "type": "data",
        "symmetric": False,
        "color": colour,
        "thickness": 1.4,
        "width": 4,
        "array": [rate.upper - rate.value if rate else None for rate in known],
        "arrayminus": [rate.value - rate.lower if rate else None for rate in known],
    }


def _shares(figure: go.Figure, rows: int) -> go.Figure:
    """Layout of a chart of shares by row."""
    figure.update_xaxes(tickformat=".0%", range=[-0.02, 1.04], nticks=6)
    figure.update_yaxes(automargin=True, ticksuffix=" ", type="category")
    figure.update_layout(**LAYOUT, height=100 + 25 * rows)
    figure.update_layout(margin={"t": 34, "l": 10, "r": 14, "b": 40})
    return figure
