"""Plot of one number over the tests of a batch: run chart and histogram."""

import math
from typing import TYPE_CHECKING

import numpy as np

from mrd_base.drawing import COLORS
from mrd_base.figures import ACCENT, LAYOUT, MEASURED, MODELLED
from mrd_characterisation.batch import Statistic
from mrd_characterisation.characterisation import QUANTITIES
from mrd_characterisation.units import BENCH

if TYPE_CHECKING:
    import plotly.graph_objects as go

MOST_BINS = 25

_MARKERS = {"pass": COLORS[3], "fail": MODELLED, "not_decided": COLORS[2], "": ACCENT}


def run_chart(statistic: Statistic) -> "go.Figure":
    """Return the values over the tests in their order, coloured by the verdict on the damper, beside their histogram."""
    # Plotly is slow to import, and only pages need it.
    from plotly.subplots import make_subplots

    figure = make_subplots(cols=2, column_widths=[0.78, 0.22], shared_yaxes=True, horizontal_spacing=0.03)
    figure.update_layout(LAYOUT)
    unit = BENCH.unit(statistic.unit)
    values = np.array([unit.shown(float(value)) for value in statistic.values])
    places = np.arange(1, len(values) + 1)
    figure.add_scatter(x=places, y=values, mode="lines", line={"color": MEASURED, "width": 1}, showlegend=False)
    for verdict, color in _MARKERS.items():
        chosen = np.array([entry.verdict == verdict for entry in statistic.entries])
        if chosen.any():
            name = {"": "not judged", "not_decided": "not decided"}.get(verdict, f"{verdict}ed")
            marker = {"color": color, "size": 5}
            figure.add_scatter(x=places[chosen], y=values[chosen], mode="markers", name=name, marker=marker)
    for limit in (statistic.lower, statistic.upper):
        if math.isfinite(limit):
            line = {"color": MODELLED, "dash": "dash", "width": 1}
            level = unit.shown(limit)
            figure.add_scatter(x=[1, len(values)], y=[level, level], mode="lines", line=line, name="limit")
    counts, edges = np.histogram(values, bins=min(MOST_BINS, 1 + math.isqrt(len(values))))
    middles = 0.5 * (edges[1:] + edges[:-1])
    figure.add_bar(x=counts, y=middles, orientation="h", marker={"color": MEASURED}, showlegend=False, col=2, row=1)
    figure.update_xaxes(title="test", col=1)
    figure.update_xaxes(title="tests", col=2)
    figure.update_yaxes(title=f"{QUANTITIES[statistic.key.quantity].title}{', ' * bool(unit.symbol)}{unit.symbol}", col=1)
    return figure.update_layout(height=260, bargap=0.05)
