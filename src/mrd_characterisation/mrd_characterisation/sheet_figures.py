"""Plots of a sheet: force over peak speed, and the loops of the fastest cycles over position and velocity."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mrd_base.drawing import COLORS
from mrd_characterisation.characterisation import SAME_CURRENT, Characterisation, Loop, by_size
from mrd_characterisation.units import BENCH, View

if TYPE_CHECKING:
    import plotly.graph_objects as go

Array = NDArray[np.float64]

_COLORS = (*COLORS, "#3d9be9", "#a0522d", "#d979c4", "#8a9a1f")
"""Of as many dampers as a sheet overlays."""

_DASHES = ("solid", "dash", "dot", "dashdot")

MOST_POINTS = 300
"""Points of a loop; a sheet shows no more."""

LONGEST_NAME = 22
"""Characters of a name in the legend; of a longer one the middle is left out, since serial numbers differ at their end."""

_GREY = "#7b8794"


def force_over_speed(characterisations: Sequence[Characterisation], view: View = BENCH) -> "go.Figure":
    """Return peak force over peak speed: rebound to the right, compression to the left, both as the bench signs them."""
    figure = _figure("peak speed", "m/s", "peak force", view, 240)
    for name, current, style, one in _lines(characterisations):
        found = one.select("peak_force", current=current)
        drawn = not name
        for direction, sign in (("rebound", 1.0), ("compression", -1.0)):
            points = sorted((sign * (v.speed or 0.0), v.value) for v in found if v.direction == direction)
            if points:
                speeds, forces = np.transpose(points)
                _add(figure, view.velocity * speeds, view.force * forces, name, style, drawn, "lines+markers")
                drawn = True
    for name, dash in _dashes_of_currents(characterisations):
        figure.add_scatter(x=[None], y=[None], mode="lines", name=name, line={"color": _GREY, "width": 1.5, "dash": dash})
    return figure


def force_over_position(characterisations: Sequence[Characterisation], view: View = BENCH) -> "go.Figure":
    """Return the force over the position in the fastest recorded cycle of each current."""
    figure = _figure("position", "m", "force", view, 200)
    for name, loop, style in _fastest(characterisations):
        _add(figure, view.position * loop.position, view.force * loop.force, name, style, True, "lines")
    return figure


def force_over_velocity(characterisations: Sequence[Characterisation], view: View = BENCH) -> "go.Figure":
    """Return the force over the velocity in the fastest recorded cycle of each current."""
    figure = _figure("velocity", "m/s", "force", view, 200)
    for name, loop, style in _fastest(characterisations):
        _add(figure, view.velocity * loop.velocity, view.force * loop.force, name, style, True, "lines")
    return figure


def _lines(characterisations: Sequence[Characterisation]) -> Iterator[tuple[str, float, dict[str, str], Characterisation]]:
    """Yield name in the legend, current, style and damper of each line; a name that is empty stands there already.

    Colours tell currents apart; of several dampers, colours tell these apart, and dashes the smallest and largest current.
    """
    several = len(characterisations) > 1
    for number, one in enumerate(characterisations):
        # More than two currents of several dampers could not be told apart.
        currents = _ends(one) if several and len(one.currents) > 1 else one.currents
        for place, current in enumerate(currents):
            color = _COLORS[(number if several else place) % len(_COLORS)]
            dash = _DASHES[(place if several else 0) % len(_DASHES)]
            name = "" if several and place else _short_name(one.name) if several else f"{current:.3g} A"
            yield name, current, {"color": color, "dash": dash}, one


def _ends(one: Characterisation) -> tuple[float, float]:
    """Return the smallest and the largest current in A."""
    currents = by_size(one.currents)
    return currents[0], currents[-1]


def _short_name(name: str) -> str:
    half = LONGEST_NAME // 2
    return name if len(name) <= LONGEST_NAME else f"{name[: half - 1]}…{name[-half:]}"


def _dashes_of_currents(characterisations: Sequence[Characterisation]) -> list[tuple[str, str]]:
    """Return name and dash of the smallest and the largest current of several dampers; none where each has a single one."""
    ends = [_ends(one) for one in characterisations if len(one.currents) > 1]
    if len(characterisations) < 2 or not ends:
        return []
    same = SAME_CURRENT * max(abs(largest) for _, largest in ends)
    names = []
    for values, word in zip(zip(*ends, strict=True), ("smallest current", "largest current"), strict=True):
        names.append(f"{values[0]:.3g} A" if max(values) - min(values) <= same else word)
    return [*zip(names, _DASHES, strict=False)]


def _fastest(characterisations: Sequence[Characterisation]) -> Iterator[tuple[str, Loop, dict[str, str]]]:
    for name, current, style, one in _lines(characterisations):
        # Loops and currents of a characterisation are of the same levels.
        loops = [loop for loop in one.loops if abs(loop.current - current) < 1e-9]
        if loops:
            yield name, max(loops, key=lambda loop: loop.speed), style


def _figure(over: str, over_unit: str, title: str, view: View, height: int) -> "go.Figure":
    # Plotly is slow to import, and only sheets that are asked for are drawn.
    import plotly.graph_objects as go

    from mrd_base.figures import LAYOUT

    figure = go.Figure(layout=LAYOUT)
    return figure.update_layout(
        height=height,
        margin={"l": 60, "r": 10, "t": 12, "b": 40},
        xaxis={"title": f"{over}, {view.unit(over_unit).symbol}"},
        yaxis={"title": f"{title}, {view.unit('N').symbol}"},
    )


def _add(figure: "go.Figure", over: Array, force: Array, name: str, style: dict[str, str], named: bool, mode: str) -> None:
    """Add a line in the units shown; one that is ``named`` already does not get into the legend again."""
    places = np.unique(np.linspace(0, len(over) - 1, MOST_POINTS).astype(int))
    figure.add_scatter(
        x=over[places],
        y=force[places],
        mode=mode,
        name=name,
        showlegend=not named,
        line={"width": 1.5, **style},
        marker={"size": 5, "color": style["color"]},
    )
