"""Figures of the report on a diagnosis."""

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from mrd_base.figures import ACCENT, LAYOUT, MEASURED, MODELLED, MOST_POINTS
from mrd_diagnosis.diagnosis import Diagnosis, Gap, Interval, Region, RunResidual
from mrd_diagnosis.localisation.excess_maps import Map, maps
from mrd_diagnosis.report.candidate_text import describe_candidate, ordered_candidates, with_probabilities
from mrd_diagnosis.report.sentences import corrected_label
from mrd_diagnosis.wording.effect_names import candidate_title
from mrd_diagnosis.wording.quantities import format_error

Array = NDArray[np.float64]

NEUTRAL, HIGHLIGHT = "#cbd2d9", "#edae49"
HEAT = [[0.0, "#f0f4f8"], [0.25, "#f7dfb0"], [0.6, HIGHLIGHT], [1.0, MODELLED]]
SOFT_TEXT = {"size": 12, "color": "#616e7c"}

MOST_CANDIDATES = 8
"""Candidates in the chart, as many as the terminal shows."""

LEAST_SHARE = 0.01
"""Share of the gap below which a free correction removes nothing that is worth a bar or a note."""

MOST_SECONDS = 8.0
"""Longest segment of a run in a plot over time, in s; a longer one cannot be read."""

MOST_PERIODS = 30
"""Periods of an oscillation in a plot over time; more of them cannot be told from each other."""

LEAST_TICKS = 3
"""Of a logarithmic colour bar: one alone would tell no scale."""
NO_DATA = "#d5dbe1"
"""Background of maps, darker than the lowest colour of `HEAT`."""


def error_chart(diagnosis: Diagnosis, gap: Gap) -> go.Figure:
    """Draw the held-out error: as given, refitted, with the effects, with a freer form of the damper or a
    free correction, and of noise alone.

    With a partly explained gap, the freer form and the free correction stand beside the causes.
    """
    floor = gap.noise_floor.value
    partly = diagnosis.verdict == "partly_explained"
    fraction = gap.explainable_fraction if gap.explainable_fraction >= LEAST_SHARE else np.nan
    whole, described = (max(of.value**2 - floor**2, 0.0) for of in (gap.before, gap.after if partly else gap.before))
    flexible = np.sqrt(floor**2 + (1 - min(fraction, 1.0)) * described)
    freer = np.sqrt(floor**2 + np.maximum(described - gap.form_fraction * whole, 0.0))
    corrected = corrected_label(diagnosis)
    beside = f"{corrected}, and" if partly else "with"
    rows = [
        ("parameters as given", Interval(np.nan if gap.as_given is None else gap.as_given), MEASURED),
        (
            "with a function common to before and after" if diagnosis.reference else "parameters refitted",
            gap.before,
            MODELLED,
        ),
        (corrected, gap.after if corrected else Interval(np.nan), ACCENT),
        (f"{beside} a freer form", Interval(float(freer)), NEUTRAL),
        (f"{beside} a free correction", Interval(float(flexible)), NEUTRAL),
        ("noise alone", gap.noise_floor, NEUTRAL),
    ]
    shown = [row for row in rows if np.isfinite(row[1].value)][::-1]
    names, values, colours = zip(*shown, strict=True)
    longest = max(_upper_end(value) for value in values)
    # A label of two lines leaves more of a narrow screen to the bars.
    figure = go.Figure(_bars([_wrapped(name) for name in names], values, colours))
    for place, value in enumerate(values):
        figure.add_annotation(
            x=_upper_end(value) + 0.015 * longest,
            y=place,
            text=format_error(value.value),
            showarrow=False,
            xanchor="left",
            font={"size": 12},
        )
    figure.update_xaxes(title_text="held-out error", tickformat=".3~p", range=[0, 1.2 * max(longest, 1e-9)], nticks=5)
    return _bar_layout(figure, len(shown))


def region_chart(regions: Sequence[Region]) -> go.Figure:
    """Draw the share of the excess error in each region, and the share of the samples there."""
    shown = regions[::-1]
    names = [_wrapped(region.label) for region in shown]
    figure = go.Figure(_bars(names, [region.share for region in shown], [MODELLED] * len(shown)))
    figure.add_trace(
        go.Scatter(
            # Every band of frequencies counts as equally many samples, so that a mark there says nothing.
            x=[
                _rounded_share(region.share.value / region.lift) if region.lift > 0 and region.axis != "frequency" else None
                for region in shown
            ],
            y=names,
            mode="markers",
            name="share of the samples",
            marker={"symbol": "line-ns", "size": 16, "line": {"width": 2.5, "color": "#7b8794"}},
        )
    )
    figure.update_xaxes(title_text="share of the excess error", tickformat=".0%", range=[0, 1.02], nticks=6)
    figure.update_layout(showlegend=True)
    return _bar_layout(figure, len(shown), top=36)


def candidate_chart(diagnosis: Diagnosis) -> go.Figure:
    """Draw the share of the gap that the best candidates remove on held-out data, and their probabilities if shown."""
    shown = ordered_candidates(diagnosis)[:MOST_CANDIDATES][::-1]
    causes = {cause.effect for cause in diagnosis.causes}
    alternatives = {alternative.effect for alternative in diagnosis.alternatives}
    colours = [
        ACCENT
        if causes.issuperset(candidate.effects)
        else HIGHLIGHT
        if alternatives.intersection(candidate.effects)
        else NEUTRAL
        for candidate in shown
    ]
    names = [_wrapped(candidate_title(candidate)) for candidate in shown]
    figure = go.Figure(_bars(names, [candidate.closed_fraction for candidate in shown], colours))
    if with_probabilities(diagnosis):
        for name, candidate in zip(names, shown, strict=True):
            _right_column(figure, f"<b>{describe_candidate(diagnosis, candidate).probability}</b>", y=name)
        _right_column(figure, "probability", y=1.0, yref="paper", yanchor="bottom", font=SOFT_TEXT)
    lowest = min([0.0, *(candidate.closed_fraction.lower for candidate in shown if candidate.closed_fraction.lower < 0)])
    # The axis begins at a tick, so that bars and whiskers left of zero can be read.
    figure.update_xaxes(
        title_text="share of the gap removed",
        tickformat=".0%",
        range=[np.floor(lowest / 0.25) * 0.25 - 0.05 * (lowest < 0), 1.05],
        tickvals=[-1, -0.5, 0, 0.5, 1],
    )
    _bar_layout(figure, len(shown), top=28)
    return figure.update_layout(margin_r=84) if with_probabilities(diagnosis) else figure


def map_figures(diagnosis: Diagnosis) -> list[tuple[str, go.Figure]]:
    """Draw maps of the excess error, each with its title: before the correction and, below, after it.

    The spectrogram shows only the run with the greatest excess.
    """
    residuals = diagnosis.residuals
    before = _maps(residuals, [residual.before for residual in residuals])
    worst = max(residuals, key=lambda residual: float(np.sum(residual.before**2 - residual.noise.sigma**2)))
    after = [*_maps(residuals, [residual.after for residual in residuals])[:-1], _maps([worst], [worst.after])[-1]]
    noise = float(np.sqrt(np.mean(np.concatenate([residual.noise.sigma for residual in residuals]) ** 2)))
    # White noise has a flat one-sided spectral density.
    levels = {"N": noise, "N/√Hz": noise * float(np.sqrt(2.0 / worst.recording.rate))}
    corrected = corrected_label(diagnosis)
    return [
        (before_map.title, _map_figure(before_map, after_map, corrected, levels[before_map.unit]))
        for before_map, after_map in zip(before, after, strict=True)
    ]


def hysteresis_loops(residual: RunResidual, corrected: str) -> list[go.Figure]:
    """Draw force over velocity and over position in the most informative segment of a run.

    Parameters
    ----------
    residual : RunResidual
    corrected : str
        Name of the corrected model; empty where there is none.
    """
    shown = most_informative_segment(residual, _loop_seconds(residual))
    motion = residual.recording.motion
    measured = residual.recording.run.force
    lines = [
        ("measured", measured, MEASURED, 4.0),
        ("model, refitted", measured - _on_run(residual, residual.before), MODELLED, 1.3),
    ]
    if corrected:
        lines.append((f"model, {corrected}", measured - _on_run(residual, residual.after), ACCENT, 1.5))
    figures = []
    for series, title in ((motion.velocity, "velocity, mm/s"), (motion.position, "position, mm")):
        figure = go.Figure()
        for name, force, colour, width in lines:
            figure.add_trace(_line(1e3 * series[shown], force[shown], name, colour, width))
        low, high = 1e3 * float(series[shown].min()), 1e3 * float(series[shown].max())
        margin = 0.04 * (high - low)
        figure.update_xaxes(title_text=title, range=[low - margin, high + margin])
        figure.update_yaxes(title_text="force, N")
        figure.update_layout(**LAYOUT, height=420)
        figure.update_layout(margin_t=50, legend_x=0, legend_xanchor="left")
        figures.append(figure)
    return figures


def error_over_time(residual: RunResidual, corrected: str, oscillation: Region | None = None) -> go.Figure:
    """Draw measured minus modelled force over time with the band of the noise, and the current below.

    Parameters
    ----------
    residual : RunResidual
    corrected : str
        Name of the corrected model; empty where there is none.
    oscillation : Region, optional
        Oscillation that has most of the error; its periods can then be seen.
    """
    seconds = MOST_SECONDS if oscillation is None else min(MOST_SECONDS, MOST_PERIODS / oscillation.lower)
    shown = most_informative_segment(residual, seconds)
    run = residual.recording.run
    time, band = _rounded(run.time[shown], 4), 2 * _on_run(residual, residual.noise.sigma)[shown]
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, row_heights=[0.78, 0.22], vertical_spacing=0.05)
    edge: dict[str, Any] = {"x": time, "line": {"width": 0}, "hoverinfo": "skip", "legendgroup": "noise"}
    fill: dict[str, Any] = {"fill": "tonexty", "fillcolor": "rgba(97, 110, 124, 0.22)", "name": "noise, ± 2 σ"}
    figure.add_trace(go.Scatter(y=_rounded(-band), showlegend=False, **edge), 1, 1)
    figure.add_trace(go.Scatter(y=_rounded(band), **edge, **fill), 1, 1)
    lines = [("refitted", residual.before, MODELLED, 1.2)]
    if corrected:
        lines.append((corrected, residual.after, ACCENT, 1.4))
    for name, errors, colour, width in lines:
        figure.add_trace(_line(time, _on_run(residual, errors)[shown], name, colour, width), 1, 1)
    current = _line(time, run.current[shown], "coil current", HIGHLIGHT, 1.4)
    current.showlegend = False
    figure.add_trace(current, 2, 1)
    figure.update_yaxes(title_text="measured − modelled, N", row=1, col=1)
    figure.update_yaxes(title_text="current, A", rangemode="tozero", nticks=4, row=2, col=1)
    figure.update_xaxes(title_text="time, s", row=2, col=1)
    figure.update_layout(**LAYOUT, height=430)
    figure.update_layout(legend_x=0, legend_xanchor="left")
    return figure


def most_informative_run(residuals: Sequence[RunResidual]) -> RunResidual:
    """Return the run in which the effects remove most error; without effects, the one with the greatest excess."""
    removed = [float(np.sum(residual.before**2 - residual.after**2)) for residual in residuals]
    if not np.any(removed):
        removed = [float(np.sum(residual.before**2 - residual.noise.sigma**2)) for residual in residuals]
    return residuals[int(np.argmax(removed))]


def most_informative_segment(residual: RunResidual, seconds: float) -> NDArray[np.intp]:
    """Return the samples of the segment in which the effects remove most error, thinned to what a screen shows."""
    removed = residual.before**2 - residual.after**2
    total = np.append(0.0, np.cumsum(removed if removed.any() else residual.before**2))
    length = min(len(removed), max(2, round(seconds * residual.recording.rate)))
    first = int(np.argmax(total[length:] - total[:-length]))
    counted = residual.recording.counted
    places = np.arange(first, first + length, -(-length // MOST_POINTS))
    return np.asarray(counted.start + residual.recording.step * places)


def _loop_seconds(residual: RunResidual) -> float:
    """Return the duration in s of about two cycles; more loops hide each other."""
    position = residual.recording.motion.position
    travel = float(np.abs(np.diff(position)).sum())
    seconds = 4 * np.ptp(position) / travel * residual.recording.run.duration if travel else 1.0
    return float(np.clip(seconds, 0.5, MOST_SECONDS))


def _on_run(residual: RunResidual, counted: Array) -> Array:
    """Extend a series at the counted samples to all samples of the run, with straight lines between them."""
    recording = residual.recording
    samples = np.arange(len(recording.run))
    return np.interp(samples, samples[recording.counted], counted, left=np.nan)


def _maps(residuals: Sequence[RunResidual], errors: Sequence[Array]) -> tuple[Map, ...]:
    return maps([residual.recording for residual in residuals], [residual.noise for residual in residuals], errors)


def _map_figure(before: Map, after: Map, corrected: str, noise: float) -> go.Figure:
    """Draw a map, and below it the one after the correction on the same scale, if there is a correction."""
    shown = [before, after] if corrected else [before]
    # Colours start at the noise, so that a map of noise alone does not look alarming.
    spectrum = before.unit != "N"
    low, high = (noise if spectrum else 0.0), max(float(np.nanquantile(before.values, 0.995)), 4 * noise, 1e-9)
    figure = make_subplots(
        rows=len(shown),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.09,
        subplot_titles=["refitted", corrected] if corrected else [],
    )
    for row, drawn in enumerate(shown, 1):
        x, x_title = _in_mm(drawn.x_edges, drawn.x)
        y, y_title = _in_mm(drawn.y_edges, drawn.y)
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
        figure.update_yaxes(title_text=y_title, showgrid=False, row=row, col=1)
    figure.update_xaxes(title_text=x_title, row=len(shown), col=1)
    figure.update_xaxes(showgrid=False)
    figure.update_layout(
        **LAYOUT, plot_bgcolor=NO_DATA, height=150 + 220 * len(shown), coloraxis=_colour_axis(before.unit, low, high)
    )
    figure.update_layout(margin={"t": 28, "l": 58, "r": 10})
    figure.update_annotations(font_size=13, x=0, xanchor="left", font_color="#616e7c")
    return figure


def _colour_axis(unit: str, low: float, high: float) -> dict[str, Any]:
    """Return the colour scale of a map; it is logarithmic for a spectrum, where ``low`` is positive."""
    title = f"rms error, {unit}" if unit == "N" else f"error, {unit}, logarithmic"
    bar: dict[str, Any] = {"thickness": 10, "title": {"text": title, "side": "right"}, "xpad": 4, "outlinewidth": 0}
    if unit != "N":
        for steps in ([1], [1, 3], [1, 2, 5], range(1, 10)):
            ticks = np.outer(10.0 ** np.arange(-6, 7), steps).ravel()
            ticks = ticks[(ticks >= low) & (ticks <= high)]
            if len(ticks) >= LEAST_TICKS:
                break
        bar |= {"tickvals": np.log10(ticks), "ticktext": [f"{tick:g}" for tick in ticks]}
        low, high = np.log10([max(low, 1e-9), high])
    return {"colorscale": HEAT, "cmin": low, "cmax": high, "colorbar": bar}


def _bars(names: Sequence[str], values: Sequence[Interval], colours: Sequence[str]) -> go.Bar:
    """Return horizontal bars with 95 % intervals."""
    return go.Bar(
        x=[_rounded_share(value.value) for value in values],
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
            "array": [_rounded_share(value.upper - value.value) for value in values],
            "arrayminus": [_rounded_share(value.value - value.lower) for value in values],
        },
    )


def _right_column(figure: go.Figure, text: str, **options: Any) -> None:
    """Write a text to the right of a chart, where it covers no bar however narrow the chart is."""
    placed = {"x": 1.03, "xref": "paper", "xanchor": "left", "showarrow": False, "font": {"size": 12}}
    figure.add_annotation(text=text, **(placed | options))


def _bar_layout(figure: go.Figure, count: int, top: int = 10) -> go.Figure:
    """Lay out a chart of ``count`` horizontal bars, with a margin of ``top`` pixels above them."""
    figure.update_yaxes(automargin=True, ticks="outside", ticklen=6, tickcolor="rgba(0, 0, 0, 0)")
    figure.update_layout(**LAYOUT, height=top + 70 + 36 * count)
    figure.update_layout(margin={"t": top, "l": 10, "r": 14, "b": 50}, legend_y=1.0, bargap=0.3)
    return figure


def _line(x: Array, y: Array, name: str, colour: str, width: float) -> go.Scatter:
    return go.Scatter(x=_rounded(x), y=_rounded(y), mode="lines", name=name, line={"color": colour, "width": width})


def _upper_end(value: Interval) -> float:
    return value.upper if np.isfinite(value.upper) else value.value


def _in_mm(edges: Array, title: str) -> tuple[Array, str]:
    """Convert the edges of an axis of length or speed to mm, and its title with them."""
    for unit in (", m/s", ", m"):
        if title.endswith(unit):
            return 1e3 * edges, f"{title.removesuffix(unit)}{unit.replace('m', 'mm', 1)}"
    return edges, title


def _wrapped(text: str) -> str:
    """Wrap a long label into two lines of about the same length."""
    return "<br>".join(textwrap.wrap(text, 26 if len(text) <= 26 else len(text) // 2 + 4))


def _rounded_share(value: float) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def _rounded(series: Array, digits: int = 4) -> Array:
    return np.round(series, digits)
