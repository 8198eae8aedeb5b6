"""Figures of pages: their look, and how they get into a page."""

import html
import re
from collections.abc import Sequence

import plotly.graph_objects as go

from mrd_base.drawing import draw

MEASURED = "#aab4c0"
MODELLED = "#d1495b"
ACCENT = "#00798c"
MOST_POINTS = 1500
"""Points of a line; more would not be visible, and would make the page slow."""

LAYOUT = {
    "template": "plotly_white",
    "font": {"family": "system-ui, sans-serif", "size": 13},
    "margin": {"l": 60, "r": 20, "t": 40, "b": 50},
    "legend": {"orientation": "h", "x": 1, "xanchor": "right", "y": 1.02, "yanchor": "bottom"},
}

FULL, HALF, NARROW = 1130, 550, 360
"""Widths in pixels: of a page, of a column of two, and of a telephone, where every figure takes the page."""

LEAST_COLUMN = 190
"""Width in pixels that a diagram needs at least beside others, with its labels."""


def share_bars(rows: Sequence[tuple[str, float]], title: str) -> go.Figure:
    """Return shares as bars, the first row at the top."""
    names, shares = [name for name, _ in rows][::-1], [share for _, share in rows][::-1]
    figure = go.Figure(go.Bar(x=shares, y=names, orientation="h", marker_color=ACCENT), LAYOUT)
    return figure.update_layout(xaxis={"title": title, "tickformat": ".0%"}, height=100 + 28 * len(rows))


def to_html(figure: go.Figure, width: int = FULL) -> str:
    """Return a figure, with its description for those who cannot see it, as a part of a page that is drawn without script.

    A figure that would be too small to read on a telephone is drawn for it as well; the page shows one of the two.
    """
    if width <= NARROW:
        return _in_page(figure, draw(figure, width))
    columns = {axis.domain for axis in figure.select_xaxes() if axis.domain}
    narrow = max(NARROW, len(columns) * LEAST_COLUMN)  # then the page shows it smaller
    return _in_page(figure, f'<div class="wide">{draw(figure, width)}</div><div class="narrow">{draw(figure, narrow)}</div>')


def interactive_html(figure: go.Figure) -> str:
    """Return a figure, with its description, as a part of a page that includes Plotly (see `render`)."""
    return _in_page(
        figure, figure.to_html(full_html=False, include_plotlyjs=False, config={"displayModeBar": False, "responsive": True})
    )


def _in_page(figure: go.Figure, drawing: str) -> str:
    return f'<figure class="plot" role="img" aria-label="{html.escape(describe(figure), quote=True)}">{drawing}</figure>'


def describe(figure: go.Figure) -> str:
    """Describe a figure in words: what is drawn over what; of bars, their lengths."""
    drawn = figure.to_plotly_json()
    titles = {
        axis: [
            text
            for name, settings in drawn["layout"].items()
            if name.startswith(axis) and (text := (settings.get("title") or {}).get("text"))
        ]
        for axis in ("xaxis", "yaxis")
    }
    over = " over ".join(filter(None, (" and ".join(dict.fromkeys(titles[axis])) for axis in ("yaxis", "xaxis"))))
    names = dict.fromkeys(name for trace in figure.data if (name := trace.name))
    lengths = [
        f"{label} {length:.3g}"
        for trace in figure.data
        if trace.type == "bar" and trace.orientation == "h"
        for label, length in zip(trace.y, trace.x, strict=True)
        if length is not None
    ]
    kind = "Map" if any(trace.type == "heatmap" for trace in figure.data) else "Chart"
    return re.sub(r"<[^>]*>", " ", ": ".join(filter(None, (f"{kind} of {over}", ", ".join([*names, *reversed(lengths)])))))
