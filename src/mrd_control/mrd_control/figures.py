"""Figures of an evaluation."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots
from scipy.signal import welch

from mrd_base.figures import LAYOUT, MEASURED, MODELLED
from mrd_control.evaluation import Entry, Evaluation, GainFront, comfort
from mrd_control.loop import LoopResult

Array = NDArray[np.float64]

SECOND = {"contact": ("dynamic tyre load, N rms", 1.0), "drift": ("drift, mm rms", 1e3)}
"""Title and factor of the metric beside comfort."""
PALETTE = ("#d1495b", "#00798c", "#edae49", "#66a182", "#8d6a9f", "#2e4057", "#c97b84", "#3d5a80", "#a44a3f", "#5f7470")
SYMBOLS = ("circle", "diamond", "square", "cross", "triangle-up")
SHOWN_SECONDS = 3.0


def second_metric(evaluation: Evaluation) -> str:
    """Return which metric stands beside comfort: the contact force, or the drift where there is no contact."""
    return "contact" if evaluation.system.linear().contact_stiffness else "drift"


def trade_off(evaluation: Evaluation) -> go.Figure:
    """Draw comfort against tyre load (or drift) of every law, with constant currents as the line to beat."""
    excitations = list(dict.fromkeys(entry.excitation for entry in evaluation.entries))
    dampers = list(dict.fromkeys(entry.damper for entry in evaluation.entries))
    labels = list(dict.fromkeys(entry.candidate.label for entry in evaluation.entries))
    second = second_metric(evaluation)
    title, factor = SECOND[second]
    figure = make_subplots(cols=len(excitations), subplot_titles=excitations, horizontal_spacing=_spacing(len(excitations)))
    for column, excitation in enumerate(excitations, 1):
        for damper, symbol in zip(dampers, SYMBOLS * len(dampers), strict=False):
            passive = [e for e in evaluation.passive if (e.damper, e.excitation) == (damper, excitation) and e.ride]
            x, y = _points(passive, second, factor)
            name = "constant currents" + (f", {damper}" if len(dampers) > 1 else "")
            figure.add_scatter(
                x=x,
                y=y,
                mode="lines+markers",
                name=name,
                legendgroup=name,
                showlegend=column == 1,
                hovertext=[entry.candidate.label for entry in passive],
                hoverinfo="text+x+y",
                line={"color": MEASURED, "width": 2},
                marker={"color": MEASURED, "size": 6, "symbol": symbol},
                row=1,
                col=column,
            )
            for entry in (e for e in evaluation.entries if (e.damper, e.excitation) == (damper, excitation) and e.ride):
                label = entry.candidate.label
                name = label + (f", {damper}" if len(dampers) > 1 else "")
                x, y = _points([entry], second, factor)
                figure.add_scatter(
                    x=x,
                    y=y,
                    mode="markers",
                    name=name,
                    legendgroup=name,
                    showlegend=column == 1,
                    marker={
                        "color": PALETTE[labels.index(label) % len(PALETTE)],
                        "size": 13,
                        "symbol": symbol,
                        "line": {"width": 1, "color": "white"},
                    },
                    row=1,
                    col=column,
                )
        figure.update_xaxes(title_text="a W_k, m/s² rms", row=1, col=column)
    figure.update_yaxes(title_text=title, row=1, col=1)
    figure.update_layout(**LAYOUT, height=480)
    figure.update_layout(legend={"orientation": "v", "x": 1.02, "xanchor": "left", "y": 1, "yanchor": "top"})
    return figure


def _points(entries: Sequence[Entry], second: str, factor: float) -> tuple[list[float], list[float]]:
    rides = [entry.ride for entry in entries if entry.ride]
    return [round(r.weighted, 5) for r in rides], [round(factor * getattr(r, second), 5) for r in rides]


def compared(evaluation: Evaluation) -> tuple[str, list[tuple[str, LoopResult]]]:
    """Return the first excitation, and with the first damper its best constant current and its most comfortable law."""
    first = evaluation.entries[0]
    laws = [e for e in evaluation.entries if (e.damper, e.excitation) == (first.damper, first.excitation)]
    active = [e for e in laws if e.candidate.law != "constant_current"] or laws
    best = min(active, key=comfort).candidate.label
    passive = evaluation.best_passive(first.damper, first.excitation).candidate.label
    results = evaluation.results
    return first.excitation, [
        (f"constant {passive}", results["passive", first.excitation]),
        (best, results[best, first.excitation]),
    ]


def over_time(evaluation: Evaluation) -> go.Figure:
    """Draw acceleration, travel and current over a few seconds, of the best constant current and the best law."""
    excitation, shown = compared(evaluation)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for (label, result), colour in zip(shown, (MEASURED, MODELLED), strict=True):
        part = _window(shown[0][1])
        part = part[part < len(result.time)]
        time = np.round(result.time[part], 4)
        for row, series in enumerate((result.acceleration, 1e3 * result.travel, result.current), 1):
            figure.add_scatter(
                x=time,
                y=np.round(series[part], 4),
                name=label,
                legendgroup=label,
                showlegend=row == 1,
                line={"color": colour, "width": 2.5 if colour == MEASURED else 1.4},
                row=row,
                col=1,
            )
    for row, title in enumerate(("acceleration, m/s²", "travel, mm", "current, A"), 1):
        figure.update_yaxes(title_text=title, row=row, col=1)
    figure.update_xaxes(title_text="time, s", row=3, col=1)
    figure.update_layout(**LAYOUT, height=520, title_text=excitation, title_x=0.01)
    return figure


def _window(result: LoopResult) -> NDArray[np.intp]:
    """Return the indices of the seconds around the largest acceleration."""
    rate = 1.0 / (result.time[1] - result.time[0])
    half = int(0.5 * SHOWN_SECONDS * rate)
    peak = int(np.argmax(np.abs(result.acceleration)))
    start = max(min(peak - half, len(result.time) - 2 * half), 0)
    return np.arange(start, min(start + 2 * half, len(result.time)))


def spectra(evaluation: Evaluation) -> go.Figure:
    """Draw the power spectral density of the acceleration of the same two."""
    _, shown = compared(evaluation)
    figure = go.Figure()
    for (label, result), colour in zip(shown, (MEASURED, MODELLED), strict=True):
        rate = 1.0 / (result.time[1] - result.time[0])
        frequency, density = welch(result.acceleration, rate, nperseg=min(len(result.time), int(8 * rate)))
        kept = (frequency >= 0.3) & (frequency <= 30.0)
        figure.add_scatter(
            x=np.round(frequency[kept], 3),
            y=np.array([float(f"{value:.4g}") for value in density[kept]]),
            name=label,
            line={"color": colour, "width": 2.5 if colour == MEASURED else 1.4},
        )
    figure.update_xaxes(title_text="frequency, Hz", type="log")
    figure.update_yaxes(title_text="acceleration, (m/s²)²/Hz", type="log", exponentformat="power")
    figure.update_layout(**LAYOUT, height=420)
    return figure


def loops(evaluation: Evaluation) -> go.Figure:
    """Draw the force over the speed of the same two, over the same seconds."""
    _, shown = compared(evaluation)
    figure = go.Figure()
    for (label, result), colour in zip(shown, (MEASURED, MODELLED), strict=True):
        part = _window(shown[0][1])
        part = part[part < len(result.time)]
        figure.add_scatter(
            x=np.round(1e3 * result.speed[part], 2),
            y=np.round(result.force[part], 2),
            name=label,
            line={"color": colour, "width": 2.0 if colour == MEASURED else 1.0},
        )
    figure.update_xaxes(title_text="speed, mm/s")
    figure.update_yaxes(title_text="force, N")
    figure.update_layout(**LAYOUT, height=420)
    return figure


def gain_fronts(evaluation: Evaluation, fronts: Sequence[GainFront]) -> go.Figure:
    """Draw the Pareto fronts over the gains of laws by excitation and damper, with constant currents as the line to beat."""
    title, factor = SECOND[fronts[0].second]
    excitations, dampers, laws = (list(dict.fromkeys(names)) for names in zip(*map(_labels, fronts), strict=True))
    places = [(damper, excitation) for damper in dampers for excitation in excitations]
    figure = make_subplots(
        rows=len(dampers),
        cols=len(excitations),
        subplot_titles=[excitation + (f", {damper}" if len(dampers) > 1 else "") for damper, excitation in places],
        horizontal_spacing=_spacing(len(excitations)),
        vertical_spacing=2 * _spacing(len(dampers)),
    )
    for index, place in enumerate(places):
        row, column = divmod(index, len(excitations))
        cell = {"row": row + 1, "col": column + 1}
        passive = [entry for entry in evaluation.passive if (entry.damper, entry.excitation) == place]
        x, y = _points(passive, fronts[0].second, factor)
        shown = {"name": "constant currents", "legendgroup": "", "showlegend": index == 0}
        figure.add_scatter(x=x, y=y, line={"color": MEASURED, "width": 2}, **shown, **cell)
        for front in (front for front in fronts if (front.damper, front.excitation) == place):
            figure.add_scatter(
                x=np.round(front.objectives[:, 0], 5),
                y=np.round(factor * front.objectives[:, 1], 5),
                mode="lines+markers",
                name=front.law,
                legendgroup=front.law,
                showlegend=index == 0,
                line={"color": PALETTE[laws.index(front.law) % len(PALETTE)], "width": 1},
                marker={"size": [14 if i == front.knee else 7 for i in range(len(front.gains))]},
                hovertext=[
                    ", ".join(f"{name} {value:.4g}" for name, value in zip(front.names, gains, strict=True))
                    for gains in front.gains
                ],
                **cell,
            )
        figure.update_xaxes(title_text="a W_k, m/s² rms", **cell)
    figure.update_yaxes(title_text=title, col=1)
    figure.update_layout(**LAYOUT, height=60 + 380 * len(dampers), title_text="knees are larger", title_x=0.01)
    return figure


def _labels(front: GainFront) -> tuple[str, str, str]:
    return front.excitation, front.damper, front.law


def _spacing(count: int) -> float:
    """Return the part of a figure between two of several diagrams side by side."""
    return min(0.08, 0.4 / count)
