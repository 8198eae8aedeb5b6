"""Figures of characterisations, any number laid over each other; the first has solid lines."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from mrd_base.figures import LAYOUT
from mrd_base.linked_plots import COLORS
from mrd_characterisation.characterisation import QUANTITIES, SAME_CURRENT, SAME_SPEED, Characterisation, Loop, Value
from mrd_characterisation.listing import shown
from mrd_characterisation.strokes import grouped
from mrd_characterisation.units import BENCH, View

Array = NDArray[np.float64]

DASHES = ("solid", "dash", "dot", "dashdot")
LOOP_POINTS = 300
MOST_LOOPS = len(COLORS)


def peak_over_speed(characterisations: Sequence[Characterisation], view: View = BENCH) -> go.Figure:
    """Draw peak force and mean force of the strokes over their peak speed (PVP)."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=["peak force", "mean force"], horizontal_spacing=0.1)
    for column, quantity in ((1, "peak_force"), (2, "mean_force")):
        _add_values(figure, characterisations, quantity, view, column)
    return _over_speed(figure, view, "force", "N")


def force_over_speed(characterisations: Sequence[Characterisation], view: View = BENCH) -> go.Figure:
    """Draw the force over the instantaneous speed (CVP): the mean of both branches, and the branches themselves."""
    figure = go.Figure()
    colors = _colors(characterisations)
    for number, one in enumerate(characterisations):
        named: set[float] = set()
        for curve in one.curves:
            speed, color = view.unit("m/s").factor * curve.speed, colors(curve.current)
            for branch, width in ((curve.mean, 2.2), (curve.accelerating, 0.7), (curve.decelerating, 0.7)):
                name = _name(characterisations, one, curve.current)
                known = np.isfinite(branch)  # few samples leave gaps, over which the line goes on
                figure.add_scatter(
                    x=_short(speed[known]),
                    y=_short(view.force * branch[known]),
                    mode="lines",
                    name=name,
                    legendgroup=name,
                    showlegend=curve.current not in named,
                    line={"color": color, "width": width, "dash": DASHES[number % len(DASHES)]},
                )
                named.add(curve.current)
    return _over_speed(figure, view, "force", "N")


def energy_over_speed(characterisations: Sequence[Characterisation], view: View = BENCH) -> go.Figure:
    """Draw energy per cycle and equivalent viscous damping over the peak speed."""
    figure = make_subplots(rows=1, cols=2, horizontal_spacing=0.12)
    for column, quantity in ((1, "energy_per_cycle"), (2, "equivalent_damping")):
        # The energy grows with the stroke: between strokes there is no line.
        _add_values(figure, characterisations, quantity, view, column, of_equal_strokes=quantity == "energy_per_cycle")
        kind = QUANTITIES[quantity]
        figure.update_yaxes(title_text=f"{kind.title}, {view.unit(kind.unit).symbol}", row=1, col=column)
    return _over_speed(figure, view)


def loops(characterisation: Characterisation, view: View = BENCH) -> go.Figure:
    """Draw measured cycles over position and speed: by speed at one current above, by current at one speed below."""
    largest = max((abs(loop.current) for loop in characterisation.loops), default=0.0)
    middle = max(_by(characterisation.loops, lambda loop: round(loop.current, 9)).values(), key=len)
    fastest = [
        max(of, key=lambda loop: loop.speed) for of in _by(characterisation.loops, lambda loop: loop.current).values()
    ]
    unit = view.unit("m/s")
    rows: list[tuple[str, list[Loop], Any]] = [
        (f"{middle[0].current:.3g} A", middle, lambda loop: f"above: {unit.shown(loop.speed):.3g} {unit.symbol}"),
        ("fastest cycles", fastest, lambda loop: f"below: {loop.current:.3g} A"),
    ]
    figure = make_subplots(rows=2, cols=2, horizontal_spacing=0.1, vertical_spacing=0.14)
    colors = _colors([characterisation], largest)
    for row, (title, chosen, name) in enumerate(rows, 1):
        for number, loop in enumerate(chosen[:MOST_LOOPS]):
            color = COLORS[number % len(COLORS)] if row == 1 else colors(loop.current)
            places = np.unique(np.linspace(0, len(loop.force) - 1, LOOP_POINTS).astype(int))
            series = ((view.position * loop.position, 1), (view.velocity * loop.velocity, 2))
            for horizontal, column in series:
                figure.add_scatter(
                    x=_short(horizontal[places]),
                    y=_short(view.force * loop.force[places]),
                    mode="lines",
                    name=name(loop),
                    legendgroup=f"{row} {number}",
                    showlegend=column == 1,
                    line={"color": color, "width": 1.3},
                    row=row,
                    col=column,
                )
        figure.update_yaxes(title_text=f"force, {view.unit('N').symbol} ({title})", row=row, col=1)
    figure.update_xaxes(title_text=f"position, {view.unit('m').symbol}", row=2, col=1)
    figure.update_xaxes(title_text=f"speed, {unit.symbol}", row=2, col=2)
    return figure.update_layout(**LAYOUT, height=640)


def responses(characterisations: Sequence[Characterisation]) -> go.Figure:
    """Draw the mean responses to current steps, a colour for each pair of levels; the current is thin."""
    figure = make_subplots(rows=1, cols=2, subplot_titles=["rising current", "falling current"], horizontal_spacing=0.1)
    pairs: list[str] = []
    named: set[str] = set()
    for number, one in enumerate(characterisations):
        for response in one.responses:
            column = 1 if abs(response.current) > abs(response.current_before) else 2
            lower, upper = sorted((response.current_before, response.current), key=abs)
            pair = f"between {lower:.3g} and {upper:.3g} A"
            name = f"{one.name}, {pair}" if len(characterisations) > 1 else pair
            pairs += [] if pair in pairs else [pair]
            for series, width in ((response.force, 1.8), (response.coil, 0.7)):
                figure.add_scatter(
                    x=_short(1e3 * response.time),
                    y=_short(series),
                    mode="lines",
                    name=name,
                    showlegend=name not in named,
                    legendgroup=name,
                    line={
                        "color": COLORS[pairs.index(pair) % len(COLORS)],
                        "width": width,
                        "dash": DASHES[number % len(DASHES)],
                    },
                    row=1,
                    col=column,
                )
                named.add(name)
    figure.update_xaxes(title_text="time since the step, ms")
    figure.update_yaxes(title_text="share of the change", row=1, col=1)
    return figure.update_layout(**LAYOUT, height=400)


def gas_over_position(characterisations: Sequence[Characterisation], view: View = BENCH) -> go.Figure:
    """Draw the gas force over the stroke."""
    figure = go.Figure()
    for number, one in enumerate(characterisations):
        if one.gas_curve is not None:
            figure.add_scatter(
                x=_short(view.position * one.gas_curve.position),
                y=_short(view.unit("N").factor * one.gas_curve.force),
                mode="lines",
                name=one.name,
                line={"color": COLORS[number % len(COLORS)], "dash": DASHES[number % len(DASHES)]},
            )
    figure.update_xaxes(title_text=f"position, {view.unit('m').symbol}")
    figure.update_yaxes(title_text=f"gas force, {view.unit('N').symbol}")
    return figure.update_layout(**LAYOUT, height=360)


def _add_values(
    figure: go.Figure,
    characterisations: Sequence[Characterisation],
    quantity: str,
    view: View,
    column: int,
    *,
    of_equal_strokes: bool = False,
) -> None:
    """Add the values of a quantity over speed: a line for each current, direction, characterisation (and stroke)."""
    colors = _colors(characterisations)
    for number, one in enumerate(characterisations):
        lines = [*_by(one.select(quantity), lambda value: (value.current, value.direction)).values()]
        if of_equal_strokes:
            lines = [equal for line in lines for equal in _by_stroke(line)]
        for values in lines:
            current, direction = values[0].current, values[0].direction
            numbers = [shown(value, view) for value in values]
            name = _name(characterisations, one, current)
            figure.add_scatter(
                x=_short([view.unit("m/s").shown(value.speed or 0.0) for value in values]),
                y=_short([value for value, *_ in numbers]),
                error_y={"array": _short([(upper - lower) / 2 for _, lower, upper, _ in numbers]), "thickness": 1},
                mode="lines+markers",
                name=name,
                legendgroup=name,
                showlegend=column == 1 and direction in (None, "rebound"),
                line={"color": colors(current), "width": 1.5, "dash": DASHES[number % len(DASHES)]},
                marker={"size": 6, "color": colors(current)},
                row=1,
                col=column,
            )


def _over_speed(figure: go.Figure, view: View, title: str = "", si: str = "") -> go.Figure:
    figure.update_xaxes(title_text=f"speed, {view.unit('m/s').symbol}")
    if title:
        axes = {"title_text": f"{title}, {view.unit(si).symbol}"}
        figure.update_layout(yaxis=axes) if len(list(figure.select_yaxes())) < 2 else figure.update_yaxes(
            **axes, row=1, col=1
        )
    return figure.update_layout(**LAYOUT, height=440)


def _colors(characterisations: Sequence[Characterisation], largest: float = 0.0) -> Any:
    """Return a function from a current in A to its colour, the same for currents that count as the same."""
    currents = sorted(current for one in characterisations for current in one.currents)
    largest = max([largest, *map(abs, currents)], default=0.0)
    distinct: list[float] = []
    for current in currents:
        if not distinct or current - distinct[-1] > SAME_CURRENT * largest:
            distinct.append(current)
    return lambda current: COLORS[int(np.argmin(np.abs(np.array(distinct) - current))) % len(COLORS)]


def _name(characterisations: Sequence[Characterisation], one: Characterisation, current: float) -> str:
    return f"{one.name}, {current:.3g} A" if len(characterisations) > 1 else f"{current:.3g} A"


def _by_stroke(values: Sequence[Value]) -> list[list[Value]]:
    groups = grouped(values, lambda value: value.stroke or 0.0, lambda stroke: SAME_SPEED * stroke)
    return [sorted(group, key=lambda value: value.speed or 0.0) for group in groups]


def _by(items: Sequence[Any], key: Any) -> dict[Any, list[Any]]:
    groups: dict[Any, list[Any]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def _short(series: Sequence[float] | Array) -> list[float | None]:
    """Return numbers with the digits that a drawing can show; None where there is none."""
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in series]
