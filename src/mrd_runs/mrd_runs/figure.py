"""The figure of a run for a notebook."""

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from mrd_base.figures import LAYOUT, MEASURED, MOST_POINTS
from mrd_runs.run import Run


def signals_over_time(run: Run) -> go.Figure:
    """Return force, position and current of a run over time."""
    figure = make_subplots(3, 1, shared_xaxes=True, vertical_spacing=0.06)
    step = max(1, len(run) // (4 * MOST_POINTS))
    signals = (("force, N", run.force), ("position, mm", 1e3 * run.position), ("current, A", run.current))
    for row, (title, series) in enumerate(signals, 1):
        line = go.Scatter(x=run.time[::step], y=series[::step], mode="lines", line={"color": MEASURED, "width": 1.5})
        figure.add_trace(line, row=row, col=1)
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=3, col=1)
    return figure.update_layout(LAYOUT, height=520, showlegend=False, title=run.name)
