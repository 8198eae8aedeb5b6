"""Pictures of a diagnosis."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from mrd_diagnosis.diagnosis import Diagnosis, Interval, Region, RunResidual
from mrd_diagnosis.effect_names import candidate_title
from mrd_diagnosis.excess_maps import Map, maps
from mrd_diagnosis.quantities import format_error
from mrd_diagnosis.sentences import corrected_label
from mrd_diagnosis.thresholds import THRESHOLDS
from mrd_identification.figures import ACCENT, LAYOUT, MEASURED, MODELLED, MOST_POINTS

Array = NDArray[np.float64]

FLOOR, DOUBTFUL = "#cbd2d9", "#edae49"
HEAT = [[0.0, "#f0f4f8"], [0.25, "#f7dfb0"], [0.6, DOUBTFUL], [1.0, MODELLED]]
MOST_REGIONS, MOST_CANDIDATES = 10, 12
MOST_SECONDS = 8.0
"""of a run over time; more cannot be read."""


def steps(diagnosis: Diagnosis) -> go.Figure:
    """How far: held-out error as handed in, refitted, with the effects, and of noise alone."""
    floor, before = diagnosis.gap.noise_floor.value, diagnosis.gap.before.value
    flexible = np.sqrt(floor**2 + (1 - min(diagnosis.gap.explainable_fraction, 1.0)) * max(before**2 - floor**2, 0.0))
    rows = [
        ("parameters as given", Interval(np.nan if diagnosis.gap.as_given is None else diagnosis.gap.as_given), MEASURED),
        ("parameters refitted", diagnosis.gap.before, MODELLED),
        (corrected_label(diagnosis), diagnosis.gap.after if diagnosis.corrected.effects else Interval(np.nan), ACCENT),
        ("with a flexible function", Interval(float(flexible)), FLOOR),
        ("noise alone", diagnosis.gap.noise_floor, FLOOR),
    ]
    shown = [row for row in rows if np.isfinite(row[1].value)][::-1]
    figure = go.Figure(_bars([row[0] for row in shown], [row[1] for row in shown], [row[2] for row in shown]))
    longest = max(_reach(row[1]) for row in shown)
    _label(figure, [(row[1], format_error(row[1].value)) for row in shown], longest)
    figure.update_xaxes(title_text="held-out error", tickformat=".3~p", range=[0, 1.2 * longest], nticks=6)
    return _rows(figure, len(shown))


def regions(diagnosis: Diagnosis) -> go.Figure:
    """Where: share of the excess error in the most telling bins, and the share of the time spent there."""
    shown = most_telling(diagnosis)[::-1]
    names = [_wrapped(region.label) for region in shown]
    figure = go.Figure(_bars(names, [region.share for region in shown], [MODELLED] * len(shown)))
    figure.add_trace(
        go.Scatter(
            x=[_share(region.share.value / region.lift) if region.lift > 0 else None for region in shown],
            y=names,
            mode="markers",
            name="share of the samples there",
            marker={"symbol": "line-ns", "size": 16, "line": {"width": 2.5, "color": "#1f2933"}},
        )
    )
    figure.update_xaxes(title_text="share of the excess error", tickformat=".0%", range=[0, 1.02], nticks=6)
    figure.update_layout(showlegend=True)
    return _rows(figure, len(shown), top=36)


def most_telling(diagnosis: Diagnosis) -> list[Region]:
    """The regions that a person should look at: the most significant."""
    return [region for region in diagnosis.where if region.q_value < THRESHOLDS.q_value][:MOST_REGIONS]


def excess_maps(diagnosis: Diagnosis) -> list[tuple[str, go.Figure]]:
    """Title and picture of each map of the excess error, before above after; a spectrogram only of the run with most."""
    traces = diagnosis.residuals
    before = _maps(traces, [trace.before for trace in traces])
    worst = max(traces, key=lambda trace: float(np.sum(trace.before**2 - trace.noise.sigma**2)))
    after = [*_maps(traces, [trace.after for trace in traces])[:-1], _maps([worst], [worst.after])[-1]]
    pairs = zip(before, after, strict=True)
    noise = float(np.sqrt(np.mean(np.concatenate([trace.noise.sigma for trace in traces]) ** 2)))
    # Of white noise, one-sided.
    levels = {"N": noise, "N/√Hz": noise * float(np.sqrt(2.0 / worst.recording.run.rate))}
    second = corrected_label(diagnosis) if diagnosis.corrected.effects else ""
    return [(one.title, _map_figure(one, other, second, levels[one.unit])) for one, other in pairs]


def loops(trace: RunResidual, second: str) -> list[go.Figure]:
    """Force over velocity and over position where the effects tell most: measured, refitted, and the ``second``."""
    shown = window(trace, _loop_seconds(trace))
    moved = trace.recording.motion
    figures = []
    for series, title in ((moved.velocity, "velocity, mm/s"), (moved.position, "position, mm")):
        figure = go.Figure()
        for name, force, colour, width in _forces(trace, second):
            figure.add_trace(_line(1e3 * series[shown], force[shown], name, colour, width))
        figure.update_xaxes(title_text=title)
        figure.update_yaxes(title_text="force, N")
        figure.update_layout(**LAYOUT, height=420)
        figure.update_layout(margin_t=50, legend_x=0, legend_xanchor="left")
        figures.append(figure)
    return figures


def errors(trace: RunResidual, second: str) -> go.Figure:
    """Measured minus modelled force over time, refitted and the ``second``, within the noise's band; the current below."""
    shown = window(trace, MOST_SECONDS)
    run = trace.recording.run
    time, band = _rounded(run.time[shown], 4), 2 * _on_run(trace, trace.noise.sigma)[shown]
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.78, 0.22], vertical_spacing=0.05)
    figure.add_trace(
        go.Scatter(x=time, y=_rounded(-band), line={"width": 0}, hoverinfo="skip", showlegend=False, legendgroup="band"),
        1,
        1,
    )
    figure.add_trace(
        go.Scatter(
            x=time,
            y=_rounded(band),
            fill="tonexty",
            fillcolor="rgba(97, 110, 124, 0.22)",
            line={"width": 0},
            hoverinfo="skip",
            name="noise, ± 2 σ",
            legendgroup="band",
        ),
        1,
        1,
    )
    named = [("refitted", trace.before, MODELLED, 1.2)]
    if second:
        named.append((second, trace.after, ACCENT, 1.4))
    for name, residual, colour, width in named:
        figure.add_trace(_line(time, _on_run(trace, residual)[shown], name, colour, width), 1, 1)
    current = _line(time, run.current[shown], "coil current", DOUBTFUL, 1.4)
    current.showlegend = False
    figure.add_trace(current, 2, 1)
    figure.update_yaxes(title_text="error, N", row=1, col=1)
    figure.update_yaxes(title_text="current, A", rangemode="tozero", nticks=4, row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    figure.update_layout(**LAYOUT, height=430)
    figure.update_layout(legend_x=0, legend_xanchor="left")
    return figure


def candidates(diagnosis: Diagnosis) -> go.Figure:
    """Which: share of the explainable gap that each effect tried would close, held out, and its probability."""
    shown = diagnosis.candidates[:MOST_CANDIDATES][::-1]
    causes = {cause.effect for cause in diagnosis.causes}
    rivals = {alternative.effect for alternative in diagnosis.alternatives}
    colours = [
        ACCENT if causes.issuperset(c.effects) else DOUBTFUL if rivals.intersection(c.effects) else FLOOR for c in shown
    ]
    names = [_wrapped(candidate_title(candidate)) for candidate in shown]
    figure = go.Figure(_bars(names, [candidate.closed_fraction for candidate in shown], colours))
    for name, candidate in zip(names, shown, strict=True):
        figure.add_annotation(
            x=1.0,
            xref="paper",
            xanchor="right",
            y=name,
            showarrow=False,
            bgcolor="rgba(255, 255, 255, 0.75)",
            text=f"<b>{_probability(candidate.probability)}</b>",
            font={"size": 12},
        )
    lowest = min([0.0, *(c.closed_fraction.lower - 0.03 for c in shown if c.closed_fraction.lower < 0)])
    figure.update_xaxes(
        title_text="share of the gap it closes",
        tickformat=".0%",
        range=[max(lowest, -0.3), 1.33],
        tickvals=[0, 0.25, 0.5, 0.75, 1],
    )
    return _rows(figure, len(shown), top=28, title="probability")


def telling(traces: Sequence[RunResidual]) -> RunResidual:
    """The run in which the effects take away most error; without effects, that with the greatest excess."""
    gain = [float(np.sum(trace.before**2 - trace.after**2)) for trace in traces]
    if not np.any(gain):
        gain = [float(np.sum(trace.before**2 - trace.noise.sigma**2)) for trace in traces]
    return traces[int(np.argmax(gain))]


def window(trace: RunResidual, seconds: float) -> NDArray[np.intp]:
    """Samples of the stretch in which the effects take away most error, thinned to what a screen shows."""
    gain = trace.before**2 - trace.after**2
    total = np.append(0.0, np.cumsum(gain if gain.any() else trace.before**2))
    length = min(len(gain), max(2, round(seconds * trace.recording.run.rate)))
    first = trace.recording.counted.start + int(np.argmax(total[length:] - total[:-length]))
    return np.arange(first, first + length, -(-length // MOST_POINTS))


def _loop_seconds(trace: RunResidual) -> float:
    """About twice to and fro: more loops hide each other."""
    run = trace.recording.run
    moved = trace.recording.motion.position
    travel = float(np.abs(np.diff(moved)).sum())
    return float(np.clip(4 * np.ptp(moved) / travel * run.duration if travel else 1.0, 0.5, MOST_SECONDS))


def _forces(trace: RunResidual, second: str) -> list[tuple[str, Array, str, float]]:
    measured = trace.recording.run.force
    before, after = (measured - _on_run(trace, residual) for residual in (trace.before, trace.after))
    named = [("measured", measured, MEASURED, 4.0), ("model, refitted", before, MODELLED, 1.3)]
    return [*named, (second, after, ACCENT, 1.5)] if second else named


def _on_run(trace: RunResidual, counted: Array) -> Array:
    """A series at the counted samples, at all samples of the run."""
    whole = np.full(len(trace.recording.run), np.nan)
    whole[trace.recording.counted] = counted
    return whole


def _maps(traces: Sequence[RunResidual], residuals: Sequence[Array]) -> tuple[Map, ...]:
    return maps([trace.recording for trace in traces], [trace.noise for trace in traces], residuals)


def _map_figure(before: Map, after: Map, second: str, noise: float) -> go.Figure:
    """A map before, and below it the ``second`` on the same scale, if that has a name."""
    shown = [before, after] if second else [before]
    # Colours are for what stands out of the noise: no picture of noise alone shall look alarming.
    spectrum = before.unit != "N"
    low, high = (noise if spectrum else 0.0), max(float(np.nanquantile(before.values, 0.995)), 4 * noise, 1e-9)
    figure = make_subplots(
        rows=len(shown),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.09,
        subplot_titles=["refitted", second] if second else [],
    )
    for row, drawn in enumerate(shown, 1):
        x, x_title = _milli(drawn.x_edges, drawn.x)
        y, y_title = _milli(drawn.y_edges, drawn.y)
        hover = f"{x_title} %{{x:.3g}}<br>{y_title} %{{y:.3g}}<br>%{{customdata:.3g}} {drawn.unit}<extra></extra>"
        z = np.log10(np.maximum(drawn.values, low or 1e-9)) if spectrum else drawn.values
        figure.add_trace(
            go.Heatmap(
                x=_rounded(x),
                y=_rounded(y),
                z=_rounded(z),
                customdata=_rounded(drawn.values),
                coloraxis="coloraxis",
                hovertemplate=hover,
            ),
            row,
            1,
        )
        figure.update_yaxes(title_text=y_title, row=row, col=1)
    figure.update_xaxes(title_text=x_title, row=len(shown), col=1)
    bar: dict[str, Any] = {"thickness": 10, "title": {"text": before.unit, "side": "top"}, "xpad": 4, "outlinewidth": 0}
    if spectrum:
        ticks = np.outer(10.0 ** np.arange(-6, 7), [1, 2, 5] if high < 30 * low else [1]).ravel()
        ticks = ticks[(ticks >= low) & (ticks <= high)]
        bar |= {"tickvals": np.log10(ticks), "ticktext": [f"{tick:g}" for tick in ticks]}
        low, high = np.log10([max(low, 1e-9), high])
    colours = {"colorscale": HEAT, "cmin": low, "cmax": high, "colorbar": bar}
    figure.update_layout(**LAYOUT, height=150 + 220 * len(shown), coloraxis=colours)
    figure.update_layout(margin={"t": 28, "l": 58, "r": 10})
    figure.update_annotations(font_size=13, x=0, xanchor="left", font_color="#616e7c")
    return figure


def _bars(names: Sequence[str], values: Sequence[Interval], colours: Sequence[str]) -> go.Bar:
    """Horizontal bars with 95 % intervals."""
    return go.Bar(
        x=[_share(value.value) for value in values],
        y=list(names),
        orientation="h",
        marker={"color": list(colours)},
        showlegend=False,
        width=0.62,
        hovertemplate="%{x:.3g}<extra></extra>",
        error_x={
            "type": "data",
            "symmetric": False,
            "color": "#52606d",
            "thickness": 1.4,
            "width": 4,
            "array": [_share(value.upper - value.value) for value in values],
            "arrayminus": [_share(value.value - value.lower) for value in values],
        },
    )


def _label(figure: go.Figure, rows: Sequence[tuple[Interval, str]], longest: float) -> None:
    """Write each bar's value behind it and its interval."""
    for place, (value, text) in enumerate(rows):
        figure.add_annotation(
            x=_reach(value) + 0.015 * longest, y=place, text=text, showarrow=False, xanchor="left", font={"size": 12}
        )


def _rows(figure: go.Figure, count: int, top: int = 10, title: str = "") -> go.Figure:
    """Layout of a chart of horizontal bars."""
    figure.update_yaxes(automargin=True, ticksuffix=" ")
    figure.update_layout(**LAYOUT, height=top + 70 + 36 * count)
    figure.update_layout(margin={"t": top, "l": 10, "r": 14, "b": 50}, legend_y=1.0, bargap=0.3)
    if title:
        figure.add_annotation(
            x=1.0,
            xref="paper",
            xanchor="right",
            y=1.0,
            yref="paper",
            yanchor="bottom",
            text=title,
            showarrow=False,
            font={"size": 12, "color": "#616e7c"},
        )
    return figure


def _line(x: Array, y: Array, name: str, colour: str, width: float) -> go.Scatter:
    return go.Scatter(x=_rounded(x), y=_rounded(y), mode="lines", name=name, line={"color": colour, "width": width})


def _reach(value: Interval) -> float:
    return value.upper if np.isfinite(value.upper) else value.value


def _milli(edges: Array, title: str) -> tuple[Array, str]:
    """Lengths and speeds in mm."""
    for unit in (", m/s", ", m"):
        if title.endswith(unit):
            return 1e3 * edges, f"{title.removesuffix(unit)}{unit.replace('m', 'mm', 1)}"
    return edges, title


def _probability(value: float) -> str:
    return "" if not np.isfinite(value) else "< 1 %" if value < 0.01 else f"{100 * value:.0f} %"


def _wrapped(text: str) -> str:
    """Over two lines of about the same length, where one would be long."""
    return "<br>".join(textwrap.wrap(text, 26 if len(text) <= 26 else len(text) // 2 + 4))


def _share(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _rounded(series: Array, digits: int = 4) -> Array:
    return np.round(series, digits)
