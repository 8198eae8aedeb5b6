"""Figures of a fit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from mrd_base.figures import ACCENT, LAYOUT, MEASURED, MODELLED, MOST_POINTS
from mrd_base.quantities import per_cent
from mrd_identification.fit import Estimate, Fit, RunResult

Array = NDArray[np.float64]


def loops(results: Sequence[RunResult], most: int = 3) -> go.Figure:
    """Draw measured and modelled force over velocity and over position, for runs from the least to the largest error."""
    chosen = _spread(results, most)
    # One run has velocity on the left and position on the right; several runs have one column each.
    single = len(chosen) == 1
    figure = make_subplots(
        rows=1 if single else 2,
        cols=2 if single else len(chosen),
        subplot_titles=[] if single else [f"{r.run.name}<br>NRMSE {per_cent(r.metrics.nrmse)}" for r in chosen],
        vertical_spacing=0.14,
        horizontal_spacing=0.08,
    )
    for index, result in enumerate(chosen):
        shown = _window(result)
        motion = result.motion
        for axis, (series, title) in enumerate(((motion.velocity, "velocity, mm/s"), (motion.position, "position, mm"))):
            row, column = (1, axis + 1) if single else (axis + 1, index + 1)
            for force, name, line in (
                (result.run.force, "measured", {"color": MEASURED, "width": 3.5}),
                (result.modelled, "model", {"color": MODELLED, "width": 1.2}),
            ):
                figure.add_scatter(
                    x=np.round(series[shown] * 1e3, 3),
                    y=np.round(force[shown], 3),
                    name=name,
                    legendgroup=name,
                    showlegend=index == axis == 0,
                    line=line,
                    row=row,
                    col=column,
                )
            figure.update_xaxes(title_text=title, row=row, col=column)
            figure.update_yaxes(title_text="force, N" if column == 1 else None, row=row, col=column)
    figure.update_layout(**LAYOUT, height=440 if single else 760)
    figure.update_layout(margin_t=50 if single else 90, legend_y=1.02 if single else 1.08)
    return figure


def force_over_time(result: RunResult, points: int = MOST_POINTS) -> go.Figure:
    """Draw force, error and coil current over time, for the seconds of a run in which they vary most, in some points."""
    shown = _window(result, points=points)
    time = np.round(result.run.time[shown], 4)
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, row_heights=[0.55, 0.25, 0.2], vertical_spacing=0.05)
    force, modelled = result.run.force[shown], result.modelled[shown]
    for row, series, name, colour, width in (
        (1, force, "measured", MEASURED, 3.5),
        (1, modelled, "model", MODELLED, 1.2),
        (2, modelled - force, "model − measured", ACCENT, 1.2),
        (3, result.run.current[shown], "coil current", "#edae49", 1.2),
    ):
        figure.add_scatter(x=time, y=np.round(series, 4), name=name, line={"color": colour, "width": width}, row=row, col=1)
    figure.update_yaxes(title_text="force, N", row=1, col=1)
    figure.update_yaxes(title_text="error, N", row=2, col=1)
    figure.update_yaxes(title_text="current, A", row=3, col=1)
    figure.update_xaxes(title_text="time, s", row=3, col=1)
    figure.update_layout(**LAYOUT, height=520, title_text=result.run.name, title_x=0.01)
    return figure


def residuals(results: Sequence[RunResult], seconds: float = 0.5) -> go.Figure:
    """Draw how the errors of all runs are distributed, beside a normal distribution, and their autocorrelation.

    Errors that are noise are normal and uncorrelated; a slow decay or a period shows physics that the model lacks.
    """
    errors = [result.modelled_counted - result.measured_counted for result in results]
    pooled = np.concatenate(errors)
    spread = float(pooled.std()) or 1.0
    edges = np.linspace(-4, 4, 41) * spread
    middles = 0.5 * (edges[1:] + edges[:-1])
    density = np.histogram(pooled - pooled.mean(), edges)[0] / (len(pooled) * (edges[1] - edges[0]))
    normal = np.exp(-0.5 * (middles / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
    longest = max(results, key=lambda result: len(result.modelled_counted))
    lags, correlation = _autocorrelation(longest.modelled_counted - longest.measured_counted, longest.run.rate, seconds)
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.1)
    figure.add_bar(x=_short(middles), y=_short(density), name="errors", marker={"color": MEASURED}, row=1, col=1)
    figure.add_scatter(x=_short(middles), y=_short(normal), name="normal distribution", line={"color": ACCENT}, row=1, col=1)
    figure.add_scatter(
        x=_short(lags),
        y=_short(correlation),
        name=f"autocorrelation, {longest.run.name}",
        line={"color": MODELLED},
        row=1,
        col=2,
    )
    figure.update_xaxes(title_text="model − measured, N", row=1, col=1)
    figure.update_yaxes(title_text="density, 1/N", row=1, col=1)
    figure.update_xaxes(title_text="lag, s", row=1, col=2)
    figure.update_yaxes(title_text="autocorrelation", range=[-1.05, 1.05], row=1, col=2)
    figure.update_layout(**LAYOUT, height=360, bargap=0.05)
    return figure


def _autocorrelation(errors: Array, rate: float, seconds: float) -> tuple[Array, Array]:
    """Return lags in s up to ``seconds``, and the autocorrelation of errors (n,) that were sampled at ``rate`` in Hz."""
    centred = errors - errors.mean()
    count = min(int(seconds * rate), len(centred) - 1) + 1
    spectrum = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    covariance = np.fft.irfft(spectrum)[:count]
    return np.arange(count) / rate, covariance / (covariance[0] or 1.0)


def _short(series: Array) -> list[float]:
    """Return numbers with the digits that a drawing can show."""
    return [float(f"{value:.4g}") for value in series]


def pareto_front(fit: Fit) -> go.Figure:
    """Draw the Pareto front of NSGA-II, its knee, and the result of least squares."""
    norms = fit.front.norms
    figure = go.Figure(
        go.Scatter(
            x=norms[:, 0],
            y=norms[:, 1],
            mode="lines+markers",
            name="Pareto front",
            line={"color": MEASURED, "width": 1},
            marker={"size": 7},
        )
    )
    points = [("knee", norms[fit.front.knee], {"size": 13, "symbol": "diamond", "color": ACCENT})]
    if fit.method.least_squares:
        final = np.array([fit.pooled_fitted.e2, fit.pooled_fitted.einf])
        points.append(("after least squares", final, {"size": 14, "symbol": "star", "color": MODELLED}))
    for name, point, marker in points:
        figure.add_scatter(x=point[:1], y=point[1:], mode="markers", name=name, marker=marker)
    figure.update_xaxes(title_text="e2 = √ΣE²/k, N")
    figure.update_yaxes(title_text="einf = max|E|/k, N")
    figure.update_layout(**LAYOUT, height=420)
    return figure


def has_intervals(fit: Fit) -> bool:
    """Whether any parameter has an interval that can be drawn."""
    return bool(_with_intervals(fit))


def _with_intervals(fit: Fit) -> list[Estimate]:
    return [e for e in fit.estimates if not e.fixed and np.isfinite(e.lower) and e.value != 0]


def parameters(fit: Fit) -> go.Figure:
    """Draw each free parameter with its 95 % interval, relative to its value."""
    shown = _with_intervals(fit)[::-1]
    relative = np.array([[e.lower / e.value, e.upper / e.value] for e in shown]).reshape(-1, 2)
    relative.sort(axis=1)
    figure = go.Figure(
        go.Scatter(
            x=np.ones(len(shown)),
            y=[e.parameter.name for e in shown],
            mode="markers",
            marker={"color": MODELLED, "size": 9},
            error_x=error_bars(1 - relative[:, 0], relative[:, 1] - 1),
            hovertext=[f"{e.value:.5g} {e.parameter.unit} [{e.lower:.5g}, {e.upper:.5g}]" for e in shown],
            hoverinfo="text",
            showlegend=False,
        )
    )
    figure.update_xaxes(title_text="95 % interval relative to the value")
    figure.update_yaxes(automargin=True)
    figure.update_layout(**LAYOUT, height=420)
    return figure


def correlation(fit: Fit) -> go.Figure:
    """Draw the correlation of the estimates of the free parameters."""
    names = [estimate.parameter.name for estimate in fit.estimates if not estimate.fixed]
    figure = go.Figure(
        go.Heatmap(
            z=np.round(fit.correlation, 3),
            x=names,
            y=names,
            zmin=-1,
            zmax=1,
            colorscale="RdBu",
            hoverongaps=False,
            colorbar={"title": "correlation", "thickness": 12},
        )
    )
    figure.update_yaxes(autorange="reversed", automargin=True)
    figure.update_xaxes(automargin=True, tickangle=90)
    figure.update_layout(**LAYOUT, height=460)
    return figure


def error_bars(below: Sequence[float] | Array, above: Sequence[float] | Array) -> dict[str, Any]:
    """Return the settings of error bars with these lengths below and above each point."""
    bars = {"array": above, "arrayminus": below, "color": MEASURED, "thickness": 2, "width": 6}
    return {"type": "data", "symmetric": False, **bars}


def _spread(results: Sequence[RunResult], most: int) -> list[RunResult]:
    """Choose at most ``most`` runs, evenly from the least to the largest error."""
    ordered = sorted(results, key=lambda r: r.metrics.nrmse)
    picks = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round().astype(int))
    return [ordered[i] for i in picks]


def _window(result: RunResult, seconds: float = 6.0, points: int = MOST_POINTS) -> NDArray[np.intp]:
    """Return the indices of the counted samples in which force and current vary most, not more than a line has points."""
    run, counted = result.run, result.counted
    length = min(int(seconds * run.rate), counted.stop - counted.start)
    starts = np.linspace(counted.start, counted.stop - length, 12).astype(int)

    def variation(start: int) -> float:
        part = slice(start, start + length)
        span = float(np.ptp(run.current)) or 1.0
        return float(np.std(run.force[part]) / np.std(run.force) + np.std(run.current[part]) / span)

    best = max(starts, key=variation)
    return np.arange(best, best + length, -(-length // points))
